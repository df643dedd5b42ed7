"""Seeded fault schedules through the real PC end and the real PLC program, and that the watch on them bites."""

import json
import random
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from link_virtual import MACHINE, MS, Q_START, TABLE, VirtualLink
from rich.console import Console

from benchmarks.link import schedules as bench_schedules
from benchmarks.link.drill.drill import drill_machine, run_schedule
from benchmarks.link.drill.drill_plant import TruePlant
from benchmarks.link.drill.motions import draw_motion, draw_tail, knots_between, reach, roughen
from benchmarks.link.drill.schedule import Act, FaultPhase, FaultSchedule, draw_schedule
from benchmarks.saved_lines import whole_lines
from protocol.client_link import ClientLink
from protocol.client_run import Run
from protocol.codes import PlcState
from protocol.framing import RawFraming
from protocol.messages import Knot, pad_to_eight_axes
from protocol.plc_link import PlcLink
from sim_plc.draw_world import draw_world
from sim_plc.plc.knot_checks import check_step
from sim_plc.plc.reference import Motion, Reference
from sim_plc.plc.status import JointControl
from sim_plc.relay.faults import Faults

SLICE = range(1, 121)
HIDDEN_START, HIDDEN_PEAK = 0.23426, (11.2484, -38.0305, 27.5477)  # cubic acceleration, shares of qdd_max
CYCLES = {1: drill_machine(1), 2: drill_machine(2)}


def drill(seed):
    schedule = draw_schedule(seed)
    return run_schedule(schedule, CYCLES[schedule.cycle_ms])


@pytest.fixture(scope="module")
def results():
    return [drill(seed) for seed in SLICE]


def test_no_schedule_of_the_slice_breaks_an_invariant(results):
    found = {(result.seed, breach.name, breach.text) for result in results for breach in result.breaches}
    assert found == set()


def test_the_slice_meets_every_fault_state_and_kind_of_motion(results):
    ways = Counter()
    for result in results:
        for counts in (result.to_plc, result.to_pc):
            ways.update({name: getattr(counts, name) for name in counts.__dataclass_fields__})
    assert min(ways.values()) > 100, ways
    seconds = Counter()
    for result in results:
        seconds.update(result.seconds_in)
    assert min(seconds[state.name] for state in PlcState if state is not PlcState.BOOT) > 2.0, seconds
    for motion in (Motion.PLAY, Motion.PATH_STOP, Motion.JOINT_STOP, Motion.SERVO):
        assert max(result.worst[motion.name][0] for result in results) > 0.5, motion
    assert sum(result.tails for result in results) > 10
    assert sum(result.underruns for result in results) > 3
    assert sum(result.reached for result in results) > 30
    assert {name for result in results for name in result.faults} >= {"ESTOP", "PRESSURE", "LOCAL_ENABLE_LOST"}


def test_the_slice_comes_close_to_the_limits(results):
    """A bound that nothing comes near is no test: full speed, full acceleration, watchdog run to its end."""
    worst = np.max([[result.worst[m.name] for m in (Motion.PLAY, Motion.JOINT_STOP)] for result in results], axis=0)
    assert worst[0, 0] > 0.95
    assert 0.99 < worst[0, 2] < 1.10
    assert 0.99 < worst[1, 2] < 1.0 + 1e-9
    assert 245.0 < max(result.longest.run_in_silence_ms for result in results) <= 250.0
    assert max(result.longest.rest_in_silence_ms for result in results) > 250.0
    assert 0.9 < max(result.longest.ramp_share for result in results) <= 1.0


def test_a_schedule_depends_on_its_seed_alone():
    assert draw_schedule(5) == draw_schedule(5) != draw_schedule(6)
    assert drill(5) == drill(5)


@pytest.mark.parametrize("seed", [2, 5, 9])
def test_the_true_plant_keeps_the_invariants_too(seed):
    schedule = draw_schedule(seed)
    machine = CYCLES[schedule.cycle_ms]
    result = run_schedule(schedule, machine, TruePlant(draw_world(machine, "realistic", seed)))
    assert result.breaches == []
    assert result.starts > 0


# --- the watch bites: the same drills with one part of the PLC or of the PC broken -----------------------------------


def first_breaches(seeds, names):
    """Breach names met until all wanted ones are among them."""
    met = set()
    for seed in seeds:
        met |= {breach.name for breach in drill(seed).breaches}
        if names <= met:
            break
    return met


def test_a_dead_watchdog_is_noticed(monkeypatch):
    monkeypatch.setattr(PlcLink, "poll", lambda self, t_plc_ns: [])
    wanted = {"silence does not stop", "silence does not disarm", "silence does not end the session"}
    assert wanted <= first_breaches(SLICE, wanted)


def test_a_plc_that_starts_ended_trajectories_again_is_noticed(monkeypatch):
    monkeypatch.setattr(PlcLink, "_is_spent", lambda self, command, mode: False)
    assert "motion resumes" in first_breaches(SLICE, {"motion resumes"})


def test_a_harder_brake_is_noticed(monkeypatch):
    whole = Reference._stop_straight

    def harder(self):
        whole(self)
        self._decel *= 1.5

    monkeypatch.setattr(Reference, "_stop_straight", harder)
    assert "too hard" in first_breaches(SLICE, {"too hard"})


def test_a_softer_brake_is_noticed(monkeypatch):
    whole = Reference._stop_straight

    def softer(self):
        whole(self)
        self._decel *= 0.5

    monkeypatch.setattr(Reference, "_stop_straight", softer)
    assert "ramp too long" in first_breaches(SLICE, {"ramp too long"})


def test_a_stop_that_drops_the_reference_is_noticed(monkeypatch):
    monkeypatch.setattr(Reference, "stop", Reference.settle)
    assert "too hard" in first_breaches(SLICE, {"too hard"})


def test_a_stop_that_goes_to_the_measured_joints_is_noticed(monkeypatch):
    whole = Reference.settle

    def jumpy(self):
        whole(self)
        self._out[0] += 1e-5

    monkeypatch.setattr(Reference, "settle", jumpy)
    assert "step in q_ref" in first_breaches(SLICE, {"step in q_ref"})


def test_valves_that_are_not_neutral_are_noticed(monkeypatch):
    def leaking(self):
        self.valves[:] = 1e-3
        return self.valves

    monkeypatch.setattr(JointControl, "neutral", leaking)
    assert "valves without control" in first_breaches(SLICE, {"valves without control"})


def test_a_pc_that_tells_a_false_end_is_noticed(monkeypatch):
    monkeypatch.setattr(Run, "is_over", lambda self, state, stop: (True, "reached") if self.started else None)
    assert "reached what is not the end" in first_breaches(SLICE, {"reached what is not the end"})


# --- minimal cases ---------------------------------------------------------------------------------------------------


def moving_link():
    """A link whose PLC plays a motion and is at speed."""
    link = VirtualLink(Faults(), Faults(), seed=1).arm()
    goal = pad_to_eight_axes(tuple(q + 0.27 for q in Q_START))
    knots = knots_between(pad_to_eight_axes(Q_START), goal, ((0.0, 2000.0),) * len(Q_START), list(range(0, 2001, 50)))
    refused = link.client.request_run(1, tuple(knots), link.t_ns)
    while not refused and link.plc.reference.t_play_ns < 1000 * MS:
        link.step()
    if np.abs(link.plc.qd_ref).max() < 0.2:
        raise RuntimeError(
            f"not at speed: {refused}"
        )  # not an AssertionError: that would count as the expected failure
    return link


def let_go_of_the_lever_at_once(link):
    link.plc.panel.lever_taken = True
    link.step()
    link.plc.panel.lever_taken = False


def stall_and_reset(link):
    link.t_ns += 10 * MS  # the PLC's task was starved: a fault that is over as soon as it is there
    link.step()
    assert link.plc.state is PlcState.FAULT
    link.client.request_reset()


@pytest.mark.parametrize("short_matter", [let_go_of_the_lever_at_once, stall_and_reset])
def test_the_plc_is_not_disarmed_before_its_ramp_is_over(short_matter):
    link = moving_link()
    short_matter(link)
    for _ in range(1000):
        link.step()
        if link.plc.state is PlcState.DISARMED:
            break
    assert link.plc.state is PlcState.DISARMED
    assert link.plc.reference.motion is Motion.FOLLOW


def test_a_hello_does_not_cut_a_ramp_off():
    """The PLC's task stands still for more than a second: fault, and no session any more, but still a ramp."""
    link = moving_link()
    link.t_ns += 1200 * MS
    link.client = ClientLink(TABLE, RawFraming(), session=99)
    link.step()
    assert link.plc.state is PlcState.FAULT
    assert link.plc.link.session == 0
    speeds = []
    while link.plc.reference.motion is not Motion.FOLLOW:
        speeds.append(np.abs(link.plc.qd_ref).max())
        link.step()
    assert link.plc.link.session == 99
    assert speeds[-1] < 0.01


def test_a_lost_tail_is_sent_again_and_not_taken_for_taken():
    link = moving_link()
    knots = link.client._run.motion.knots
    assert link.client.state is not None
    first, tail = draw_tail(TABLE, knots, link.client.state.t_play_ns + 400 * MS, random.Random(3))
    assert link.client.request_tail(1, first, tail, link.t_ns) == ()
    t_s = link.t_ns * 1e-9
    link.to_plc.faults = Faults(cut_windows_s=((t_s, t_s + 0.13),))
    link.to_pc.faults = Faults(cut_windows_s=((t_s - 0.001, t_s + 0.2),))
    while not link.ended:
        link.step()
    assert link.ended[0].reached, link.ended[0].reason
    assert link.plc.q_ref == pytest.approx(tail[-1].q[:6])


def test_a_peak_between_the_checked_points_is_refused():
    """The worst segment that passes the check, by linear programming over its four free coefficients."""
    axis, T = TABLE.axes[0], 0.1
    d0, d1, d2 = HIDDEN_PEAK
    p = [HIDDEN_START + x * (d0 + x * (d1 + x * d2)) for x in np.linspace(0.0, 1.0, 1001)]
    assert max(np.abs(p)) > 1.18
    A = axis.qdd_max
    qd1 = A * T * (HIDDEN_START + d0 / 2 + d1 / 3 + d2 / 4)
    q1 = A * T * T * (HIDDEN_START / 2 + d0 / 6 + d1 / 12 + d2 / 20)
    a = Knot(0, pad_to_eight_axes(()), pad_to_eight_axes(()), pad_to_eight_axes((A * HIDDEN_START,)))
    b = Knot(
        round(T * 1e9),
        pad_to_eight_axes((q1,)),
        pad_to_eight_axes((qd1,)),
        pad_to_eight_axes((A * (HIDDEN_START + d0 + d1 + d2),)),
    )
    assert check_step(a, b, 1, TABLE) is not None


# --- what the drills are made of -------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(40))
def test_drawn_motions_begin_at_the_reference_and_rise_in_time(seed):
    rng = random.Random(seed)
    knots = roughen(TABLE, draw_motion(TABLE, pad_to_eight_axes(Q_START), rng), rng)
    assert knots[0] == Knot(0, pad_to_eight_axes(Q_START), pad_to_eight_axes(()), pad_to_eight_axes(()))
    assert all(a.t_ns < b.t_ns for a, b in pairwise(knots))
    assert max(map(abs, (*knots[-1].qd, *knots[-1].qdd))) == 0.0
    for j, axis in enumerate(TABLE.axes):
        assert all(axis.q_min <= knot.q[j] <= axis.q_max for knot in knots)
        assert max(abs(knot.qd[j]) for knot in knots) <= axis.qd_max
        assert max(abs(knot.qdd[j]) for knot in knots) <= axis.qdd_max


def test_reach_is_where_speed_or_acceleration_end():
    knots = knots_between(
        pad_to_eight_axes(()),
        pad_to_eight_axes(tuple(reach(TABLE, j, 1.0) for j in range(6))),
        ((0.0, 1000.0),) * 6,
        list(range(0, 1001, 5)),
    )
    for j, axis in enumerate(TABLE.axes):
        shares = (
            max(abs(k.qd[j]) for k in knots) / axis.qd_max,
            max(abs(k.qdd[j]) for k in knots) / axis.qdd_max,
        )
        assert max(shares) == pytest.approx(1.0, abs=1e-3)


def test_schedules_hold_every_act_and_every_fault():
    schedules = [draw_schedule(seed) for seed in range(400)]
    acts = Counter(action.act for schedule in schedules for action in schedule.actions)
    assert set(acts) == set(Act)
    phases = [faults for s in schedules for phase in s.phases for faults in (phase.to_plc, phase.to_pc)]
    for name in Faults.__dataclass_fields__:
        assert any(getattr(faults, name) != getattr(Faults(), name) for faults in phases), name
    assert {schedule.cycle_ms for schedule in schedules} == {1, 2}


# --- the bench -------------------------------------------------------------------------------------------------------


def test_the_bench_saves_every_case_and_resumes(tmp_path: Path, monkeypatch):
    console = Console(quiet=True)
    run = []
    whole = bench_schedules.run_case
    monkeypatch.setattr(bench_schedules, "run_case", lambda seed: run.append(seed) or whole(seed))
    first = bench_schedules.bench(2, 31, tmp_path, console)
    path = tmp_path / bench_schedules.FILE
    path.write_text(path.read_text(encoding="utf-8") + '{"seed": 33, "bre', encoding="utf-8")  # a crash cut this one
    second = bench_schedules.bench(3, 31, tmp_path, console)
    assert run == [31, 32, 33]
    assert second[:2] == [json.loads(json.dumps(case)) for case in first]
    assert [case["seed"] for case in second] == [31, 32, 33]
    assert len(bench_schedules.tables_of(second)) == 4
    assert [case["seed"] for case in whole_lines(path)] == [31, 32, 33]


def test_an_exception_in_a_drill_is_a_breach(monkeypatch):
    def burst(self, out):
        raise ZeroDivisionError("here")

    monkeypatch.setattr("benchmarks.link.drill.drill.Watch.cycle", burst)
    case = bench_schedules.run_case(1)
    assert case["breaches"] == [{"name": "exception", "t_s": 0.0, "text": case["breaches"][0]["text"]}]


def test_a_quiet_schedule_runs_motions_to_their_ends():
    # not seed 7: it draws knots 5 ms apart at full speed, of which the PLC's ring holds too few to brake within
    quiet = FaultSchedule(8, 2, False, (FaultPhase(0.0, Faults(), Faults()),), (), 8.0)
    result = run_schedule(quiet)
    assert result.breaches == []
    assert result.reached >= 3
    assert result.ended_early + result.underruns <= 1  # the last one, when the PC falls silent
    assert MACHINE.plc_cycle_s == 1e-3
