"""Seeded fault schedules: what the network does, and what people and processes do, over a few seconds."""

import random
from dataclasses import dataclass
from enum import Enum

from sim_plc.relay.faults import Faults, Windows

ARMED_BY_S = 0.75  # HELLO, 25 good commands and ARM take this long in a healthy network
_LONG_LOSSES = (60, 150, 230, 270, 400, 900, 1300)  # ms: around every time limit of the link


class Act(Enum):
    """What people and processes do in a drill."""

    STOP = "stop"
    QUICK_STOP = "quick stop"
    HOLD = "hold command"
    DISARM = "disarm"
    OVERRIDE = "speed override"
    LEVER = "local lever"
    ENABLE_LOST = "enable released"
    ESTOP = "emergency stop"
    PC_RESTART = "PC restarts"
    PC_STALL = "PC stalls"
    PLC_RESTART = "PLC restarts"
    PLC_STALL = "PLC task stalls"
    INTRUDER = "second PC"
    OLD_START = "an ended trajectory is started again"
    LINE_DOWN = "no oil pressure"


@dataclass(frozen=True, slots=True)
class Action:
    """One act at a time of the drill; `value`: how long [s], or the override (0..1)."""

    t_s: float
    act: Act
    value: float


@dataclass(frozen=True, slots=True)
class FaultPhase:
    """From t_s on the two directions behave like this."""

    t_s: float
    to_plc: Faults
    to_pc: Faults


@dataclass(frozen=True, slots=True)
class FaultSchedule:
    """One drill. After `length_s` the PC falls silent for good and the drill ends once the PLC must have disarmed."""

    seed: int
    cycle_ms: int
    panel: bool  # the enable is a key at the machine, not automatic
    phases: tuple[FaultPhase, ...]
    actions: tuple[Action, ...]
    length_s: float


def draw_schedule(seed: int) -> FaultSchedule:
    """The schedule of that seed."""
    rng = random.Random(f"schedule {seed}")
    length_s = ARMED_BY_S + rng.uniform(1.0, 3.0)
    starts = [0.0] if rng.random() < 0.2 else [rng.uniform(0.6, 0.9)]
    starts += sorted(rng.uniform(starts[0], length_s) for _ in range(rng.choice((0, 0, 1, 2))))
    phases = [FaultPhase(t_s, *_draw_both(rng, t_s, length_s)) for t_s in starts]
    if starts[0] > 0.0:
        phases.insert(0, FaultPhase(0.0, Faults(), Faults()))
    actions = tuple(_draw_action(rng, length_s) for _ in range(rng.choice((0, 0, 1, 1, 2, 3, 4))))
    return FaultSchedule(
        seed=seed,
        cycle_ms=1 if rng.random() < 0.2 else 2,
        panel=rng.random() < 0.5,
        phases=tuple(phases),
        actions=tuple(sorted(actions, key=lambda action: action.t_s)),
        length_s=length_s,
    )


def _draw_both(rng: random.Random, t_s: float, until_s: float) -> tuple[Faults, Faults]:
    """Both directions; every third time only one of them is disturbed."""
    to_plc, to_pc = draw_faults(rng, t_s, until_s), draw_faults(rng, t_s, until_s)
    which = rng.random()
    if which < 1 / 6:
        return to_plc, Faults()
    return (Faults(), to_pc) if which < 1 / 3 else (to_plc, to_pc)


def draw_faults(rng: random.Random, t_s: float, until_s: float) -> Faults:
    """Some classes at random, seldom all of them."""

    def share(chance: float, *choices: float) -> float:
        return rng.choice(choices) if rng.random() < chance else 0.0

    return Faults(
        loss_frac=share(0.5, 0.02, 0.1, 0.3, 0.6),
        burst_frac=share(0.3, 0.01, 0.05, 0.3),
        burst_length=rng.choice((2, 5, 10, 10, 13, 20, 40)),
        duplicate_frac=share(0.3, 0.05, 0.3, 1.0),
        reorder_frac=share(0.3, 0.05, 0.3),
        reorder_ms=rng.choice((15.0, 30.0, 70.0, 300.0)),
        delay_ms=share(0.5, 0.3, 5.0, 20.0, 60.0, 110.0),
        jitter_ms=share(0.5, 1.0, 10.0, 40.0, 150.0),
        corrupt_frac=share(0.3, 0.02, 0.2),
        truncate_frac=share(0.2, 0.02, 0.2),
        replay_frac=share(0.3, 0.05, 0.5),
        cut_windows_s=_draw_windows(rng, t_s, until_s),
        freeze_windows_s=_draw_windows(rng, t_s, until_s),
    )


def _draw_windows(rng: random.Random, t_s: float, until_s: float) -> Windows:
    windows = []
    for _ in range(rng.choice((0, 0, 0, 1, 1, 2))):
        begin_s = rng.uniform(t_s, until_s)
        windows.append((begin_s, begin_s + rng.choice(_LONG_LOSSES) * 1e-3 * rng.uniform(0.9, 1.1)))
    return tuple(windows)


def _draw_action(rng: random.Random, until_s: float) -> Action:
    act = rng.choice(list(Act))
    t_s = rng.uniform(0.5, until_s)
    if act is Act.OVERRIDE:
        return Action(t_s, act, rng.choice((0.0, 0.1, 0.5, 0.9, 1.0)))
    if act is Act.PLC_STALL:
        return Action(t_s, act, rng.choice((0.003, 0.008, 0.02, 0.3, 1.2)))
    return Action(t_s, act, rng.choice((0.02, 0.1, 0.3, 0.6, 1.1)))
