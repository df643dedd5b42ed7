"""What a session is made of: short scripts in random order, each a thing that a PC, a person or the machine may do."""

from collections.abc import Callable, Iterator

import numpy as np
from st_harness import Pair
from st_sessions import Pc

from protocol.codes import Mode, PlcState
from protocol.messages import Command

Script = Iterator[Command | None]
Chapter = Callable[[Pc, Pair], Script]


def play(pc: Pc, pair: Pair) -> Script:
    """A trajectory to its end, at some speed."""
    del pair
    pc.plan(float(pc.rng.uniform(0.5, 1.1)), int(pc.rng.choice([20, 40, 50])), 0.03)
    yield from pc.play(220, speed=float(pc.rng.choice([1.0, 1.0, 0.6])))


def prefill_and_play(pc: Pc, pair: Pair) -> Script:
    """More knots than the ring holds, before the start."""
    del pair
    pc.plan(1.8, 25, 0.05)
    yield from pc.prefill(int(pc.rng.integers(2, 16)))
    yield from pc.play(60)


def starve(pc: Pc, pair: Pair) -> Script:
    """The knots run out."""
    del pair
    pc.plan(1.2, 50, 0.04)
    yield from pc.starve(60)


def correct(pc: Pc, pair: Pair) -> Script:
    """The tail is replaced while it plays."""
    del pair
    pc.plan(1.2, 50, 0.04)
    yield from pc.correct()


def servo(pc: Pc, pair: Pair) -> Script:
    """A target is chased and reached, or its stream just ends."""
    del pair
    yield from pc.servo(int(pc.rng.integers(20, 90)), end=bool(pc.rng.random() < 0.6))
    yield from pc.beat(int(pc.rng.integers(0, 40)))


def interrupted(pc: Pc, pair: Pair) -> Script:
    """A motion, then a stop of some kind in the middle of it, asked for again and again."""
    del pair
    mode = Mode(int(pc.rng.choice([Mode.STOP, Mode.QUICK_STOP, Mode.HOLD, Mode.DISARM])))
    pc.plan(1.0, 50, 0.05)
    moving = pc.play(int(pc.rng.integers(20, 80))) if pc.rng.random() < 0.6 else pc.servo(int(pc.rng.integers(20, 60)))
    yield from moving
    yield from pc.beat(int(pc.rng.integers(1, 40)), mode)
    yield from pc.play(10)


def silence(pc: Pc, pair: Pair) -> Script:
    """A motion, then nothing: late, lost or void."""
    del pair
    pc.plan(1.2, 50, 0.05)
    yield from pc.play(int(pc.rng.integers(5, 60)))
    pc.timeout_us = int(pc.rng.choice([0, 120_000, 2**31]))
    yield from pc.silent(int(pc.rng.choice([8, 14, 30, 60, 120])))
    yield from pc.play(20)
    pc.timeout_us = 0


def wrong_modes(pc: Pc, pair: Pair) -> Script:
    """Every mode in whatever state this is."""
    del pair
    for mode in pc.rng.permutation(9):
        yield pc.command(Mode(int(mode)))
    yield from pc.connect()


def panel(pc: Pc, pair: Pair) -> Script:
    """Enable, lever and emergency stop, each for a while, also while it moves."""
    pc.plan(1.0, 50, 0.04)
    yield from pc.play(int(pc.rng.integers(1, 50)))
    what = int(pc.rng.integers(3))
    if what == 0:
        pair.panel.release_enable()
    pair.panel.lever_taken = what == 1
    pair.panel.estop_pressed = what == 2
    yield from pc.beat(int(pc.rng.integers(2, 25)))
    yield from pc.beat(3, Mode.RESET)
    if not pair.panel.enabled:
        pair.panel.press_enable()
    pair.panel.lever_taken = pair.panel.estop_pressed = False
    yield from pc.beat(3)
    yield from pc.beat(2, Mode.RESET)


def broken_machine(pc: Pc, pair: Pair) -> Script:
    """Encoders, pressure, oil, a stuck joint, one out of range, a starved task; then whole again."""
    plant, axis = pair.plant, int(pc.rng.integers(6))
    pc.plan(1.0, 50, 0.05)
    yield from pc.play(int(pc.rng.integers(1, 40)))
    kept, kept_qd = plant.q.copy(), plant.qd.copy()
    what = int(pc.rng.integers(8))
    broken = float(pc.rng.choice([np.nan, np.inf, -np.inf]))
    if what == 0:
        plant.q[axis] = broken
    elif what == 1:
        plant.qd[axis] = broken
    elif what == 2:
        plant.q[axis] += 9.0
    elif what == 3:
        plant.supply_pa = float(pc.rng.choice([1e6, 5e6, np.nan]))
    elif what == 4:
        plant.oil_c = float(pc.rng.choice([75.0, 90.0, np.inf]))
    elif what == 5:
        plant.stuck = True
    elif what == 6:
        pair.t_ns += 60_000_000
    else:
        plant.qd[axis] = 0.2
    yield from pc.play(int(pc.rng.integers(5, 40)))
    yield from pc.beat(2, Mode.RESET)
    yield from pc.arm(early=bool(pc.rng.random() < 0.5))
    plant.q, plant.qd, plant.stuck = np.where(np.abs(plant.q) < 4.0, plant.q, kept), kept_qd, False
    plant.supply_pa, plant.oil_c = 19e6, 40.0
    yield from pc.beat(2)


CHAPTERS: tuple[Chapter, ...] = (
    play,
    prefill_and_play,
    starve,
    correct,
    servo,
    servo,
    interrupted,
    silence,
    wrong_modes,
    panel,
    broken_machine,
)


def story(pc: Pc, pair: Pair, datagrams: int) -> Script:
    """Chapters at random until the pair has seen that many datagrams."""
    yield from pc.silent(2)
    while pair.tally.datagrams < datagrams:
        if pair.panel.enable_mode == "panel" and pc.rng.random() < 0.8 and not pc.is_in(PlcState.HOLD):
            pair.panel.release_enable()  # a key that stays on does not arm again
            yield from pc.beat(1)
            pair.panel.press_enable()
        yield from pc.ready()
        yield from CHAPTERS[int(pc.rng.integers(len(CHAPTERS)))](pc, pair)
