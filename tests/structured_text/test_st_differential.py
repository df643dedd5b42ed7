"""The delivered PLC program beside the simulated PLC: every state datagram and valve command is the same to the bit."""

import json
import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from st_chapters import Script, story
from st_harness import TABLE, Drill, Pair, Tally
from st_plc import DeliveredPlc
from st_sessions import Pc
from st_tour import tour, while_linked

from protocol.codes import AxisBit, CommandFlag, FaultBit, Mode, PlcState, RejectCode

KEY = bytes(range(32))
NEAR_THE_WRAP = 2**32 - 60  # sequence numbers pass 2^32 in every session


@dataclass(frozen=True, slots=True)
class Setup:
    """One session's circumstances."""

    seed: int
    key: bytes = b""
    auto: bool = True
    dry_run: bool = False
    eap: bool = False
    fault_frac: float = 0.12


class Stage:
    """Both PLCs and a PC, made for one setup."""

    def __init__(self, setup: Setup) -> None:
        self.rng = np.random.default_rng(setup.seed)
        self.st = DeliveredPlc(setup.key, setup.auto, setup.dry_run)
        self.pair = Pair(
            self.st, setup.seed, key=setup.key, auto=setup.auto, dry_run=setup.dry_run, eap=setup.eap
        )  # fmt: skip
        self.pc = Pc(self.rng, TABLE, session=7, seq=NEAR_THE_WRAP, key=setup.key)
        self.drill = Drill(self.pair, self.pc, self.rng, setup.fault_frac)

    def play(self, script: Script) -> Tally:
        self.drill.run(script)
        assert self.st.illegal_events() == 0
        return self.pair.tally


def until_hold(pc: Pc) -> Script:
    """Linked, armed and at rest."""
    yield from pc.silent(1)
    yield from pc.ready()
    assert pc.is_in(PlcState.HOLD)


def story_of(setup: Setup, datagrams: int) -> Tally:
    stage = Stage(setup)
    return stage.play(story(stage.pc, stage.pair, datagrams))


def tour_of(setup: Setup) -> Tally:
    stage = Stage(setup)
    stage.pair.panel.press_enable()
    return stage.play(tour(stage.pc, stage.pair, stage.drill))


def linked_tour_of(setup: Setup) -> Tally:
    stage = Stage(setup)
    return stage.play(while_linked(stage.pc, stage.drill))


def merged(tallies: list[Tally]) -> Tally:
    whole = Tally()
    for tally in tallies:
        whole.ticks += tally.ticks
        whole.datagrams += tally.datagrams
        whole.mismatches += tally.mismatches
        for mine, theirs in (
            (whole.rejects, tally.rejects),
            (whole.states, tally.states),
            (whole.motions, tally.motions),
            (whole.faults, tally.faults),
        ):
            mine.update(Counter(theirs))
    return whole


def report(name: str, tally: Tally) -> None:
    """Print the figures, and keep them where LONGREACH_EVIDENCE names a folder."""
    text = json.dumps(tally.summary(), indent=1)
    print(f"{name}: {text}")
    folder = os.environ.get("LONGREACH_EVIDENCE")
    if folder:
        Path(folder).mkdir(parents=True, exist_ok=True)
        (Path(folder) / f"{name}.json").write_text(text + "\n", encoding="utf-8")


def assert_same(tally: Tally) -> None:
    assert not tally.mismatches, f"{len(tally.mismatches)} mismatches\n" + "\n".join(tally.mismatches[:5])


def assert_everything_happened(tally: Tally) -> None:
    assert {code.name for code in RejectCode} - set(tally.rejects) == {"NONE"}
    assert {state.name for state in PlcState} - set(tally.states) == {"BOOT"}
    assert set(tally.motions) == {"FOLLOW", "HOLD", "PLAY", "PATH_STOP", "JOINT_STOP", "SERVO"}


def test_a_slice_of_sessions_gives_the_same_states_and_valves():
    tallies = [tour_of(Setup(seed, auto=False, eap=eap, fault_frac=0.0)) for seed, eap in ((1, False), (2, True))]
    tallies.append(linked_tour_of(Setup(3, key=KEY, fault_frac=0.0)))
    tallies += [story_of(Setup(seed, auto=seed % 2 == 0, dry_run=seed == 6), 150) for seed in (4, 5, 6, 7)]
    tally = merged(tallies)
    report("structured_text_slice", tally)
    assert_same(tally)
    assert_everything_happened(tally)
    assert tally.datagrams >= 1500


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_ten_thousand_datagrams_give_the_same_states_and_valves():
    tallies = [tour_of(Setup(seed, auto=False, eap=seed % 2 == 0, fault_frac=0.0)) for seed in range(100, 104)]
    tallies.append(tour_of(Setup(104, key=KEY, auto=False, fault_frac=0.0)))
    seed = 105
    while sum(tally.datagrams for tally in tallies) < 12_000:
        key = KEY if seed % 7 == 2 else b""
        setup = Setup(seed, key, auto=seed % 3 != 1, dry_run=seed % 6 == 4, eap=seed % 5 == 3)
        tallies.append(story_of(setup, 400))
        seed += 1
    tally = merged(tallies)
    report("structured_text_differential", tally)
    assert_same(tally)
    assert_everything_happened(tally)
    assert tally.datagrams >= 10_000


@pytest.mark.parametrize("broken", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize("reading", ["q", "qd"])
def test_an_encoder_lost_while_it_holds_or_moves(broken, reading):
    for ticks in (0, 25):  # holding, moving
        stage = Stage(Setup(11, fault_frac=0.0))
        pc, plant = stage.pc, stage.pair.plant

        def script(pc=pc, plant=plant, ticks=ticks):
            yield from until_hold(pc)
            if ticks:
                pc.plan(1.0, 50, 0.05)
                yield from pc.play(ticks)
            kept = getattr(plant, reading).copy()
            getattr(plant, reading)[2] = broken
            yield from pc.beat(5)
            assert pc.is_in(PlcState.FAULT)
            assert pc.state is not None
            assert pc.state.valve_cmd == (0.0,) * 8
            yield pc.command(Mode.RESET)
            setattr(plant, reading, kept)
            yield from pc.beat(3, Mode.RESET)

        assert_same(stage.play(script()))


@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.STOP, Mode.QUICK_STOP])
def test_a_trajectory_that_waited_for_its_start_when_a_stop_came_never_starts(mode):
    stage = Stage(Setup(15, fault_frac=0.0))
    pc = stage.pc

    def script():
        yield from pc.silent(1)
        yield from pc.ready()
        pc.plan(1.0, 50, 0.05)
        yield from pc.prefill(3)
        yield from pc.beat(1, mode)
        for _ in range(5):
            yield pc.window(CommandFlag.START)
            assert pc.is_in(PlcState.HOLD)
        pc.plan(1.0, 50, 0.05)
        yield from pc.play(5)
        assert pc.is_in(PlcState.RUN)

    assert_same(stage.play(script()))


def test_a_joint_without_a_speed_is_a_sensor_fault_and_nothing_else_however_far_it_lags():
    stage = Stage(Setup(14, fault_frac=0.0))
    pc, plant = stage.pc, stage.pair.plant

    def script():
        yield from until_hold(pc)
        plant.q[0] += 1.0  # rad: many times the lag that is a fault
        plant.qd[0] = np.nan
        yield from pc.beat(3)
        assert pc.state is not None
        assert (pc.state.fault_bits, pc.state.warn_bits) == (FaultBit.SENSOR, 0)

    assert_same(stage.play(script()))


@pytest.mark.parametrize(("jump_rad", "is_fault"), [(0.05, True), (-0.05, True), (0.015, False)])
def test_both_take_an_encoder_that_jumps_for_a_fault_of_its_axis_until_reset(jump_rad, is_fault):
    stage = Stage(Setup(17, fault_frac=0.0))
    pc, plant = stage.pc, stage.pair.plant

    def script():
        yield from until_hold(pc)
        plant.q[1] += jump_rad  # in a cycle of 10 ms
        yield from pc.beat(3)
        assert pc.state is not None
        assert (pc.state.fault_bits == FaultBit.SENSOR) is is_fault
        assert bool(pc.state.axis_status[1] & AxisBit.ENCODER_FAULT) is is_fault

    assert_same(stage.play(script()))


@pytest.mark.parametrize("glitch_rad_s", [-300.0, 600.0])
def test_an_encoder_that_jumps_as_the_fault_comes_does_not_keep_the_valves_open(glitch_rad_s):
    stage = Stage(Setup(13, fault_frac=0.0))
    pc, plant = stage.pc, stage.pair.plant

    def script():
        yield from pc.silent(1)
        yield from pc.ready()
        pc.plan(1.0, 50, 0.05)
        yield from pc.play(25)
        plant.oil_c, plant.qd[2] = 90.0, glitch_rad_s
        yield pc.command()
        plant.qd[2] = 0.0
        yield from pc.beat(2)
        assert pc.is_in(PlcState.FAULT)
        assert pc.state is not None
        assert pc.state.valve_cmd != (0.0,) * 8
        yield from pc.beat(75)  # of 10 ms: 1.5 qd_max / qdd_max of the slowest joint
        assert pc.state.valve_cmd == (0.0,) * 8
        plant.oil_c = 40.0

    assert_same(stage.play(script()))


def test_a_repeated_hello_is_a_heartbeat_whatever_its_mode_says():
    stage = Stage(Setup(12, auto=False, fault_frac=0.0))

    def script():
        yield from stage.pc.silent(1)
        yield from stage.pc.connect()
        yield from stage.pc.beat(26)
        for mode in Mode:
            yield stage.pc.command(mode, hello=True)

    tally = stage.play(script())
    assert_same(tally)
    assert not tally.rejects
