"""Corrections of a running trajectory, quick stop, authentication and dry run, through both ends in virtual time."""

import numpy as np
import pytest
from virtual_plc import MS, Q_START, TABLE, VirtualPlc, quintic_knots

from protocol.client_events import RejectSeen, TailAnswered, TrajectoryEnded
from protocol.codes import HeaderFlag, PlcState
from protocol.errors import LocalProtocolError
from protocol.messages import Knot, pad_to_eight_axes
from sim_plc.plc.reference import Motion

STEP = np.deg2rad([8.0, 3.0, 4.0, 3.0, 2.0, 3.0])
Q_END = tuple((np.array(Q_START) + STEP).tolist())
QDD_MAX = np.array([axis.qdd_max for axis in TABLE.axes])


def running(duration_s=3.0, **options):
    virtual = VirtualPlc(**options)
    virtual.arm()
    knots = quintic_knots(virtual.plc.q_ref, Q_END, duration_s)
    assert virtual.run(knots) == ()
    virtual.step(300)
    return virtual, knots


def corrected(knots, first, shift):
    """The same path from `first` on, with a smooth step of `shift` (n,) [rad] added over the rest."""
    tail, T = [], (knots[-1].t_ns - knots[first - 1].t_ns) * 1e-9
    for knot in knots[first:]:
        u = (knot.t_ns - knots[first - 1].t_ns) * 1e-9 / T
        s = 10 * u**3 - 15 * u**4 + 6 * u**5
        sd, sdd = (30 * u**2 - 60 * u**3 + 30 * u**4) / T, (60 * u - 180 * u**2 + 120 * u**3) / T**2
        n = len(shift)
        q, qd, qdd = (np.array(x[:n]) + d * shift for x, d in ((knot.q, s), (knot.qd, sd), (knot.qdd, sdd)))
        tail.append(
            Knot(knot.t_ns, pad_to_eight_axes(tuple(q)), pad_to_eight_axes(tuple(qd)), pad_to_eight_axes(tuple(qdd)))
        )
    return tuple(tail)


def assert_no_step(virtual):
    qd = np.array([row[3] for row in virtual.trace])
    assert np.abs(np.diff(qd, axis=0) / 1e-3 / QDD_MAX).max() <= 1.10


def answers(virtual, kind):
    return [event for event in virtual.events if isinstance(event, kind)]


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_a_correction_is_spliced_onto_the_reference_and_reached(loss):
    virtual, knots = running()
    rng = np.random.default_rng(3)
    virtual.lose = lambda direction, t_ns: rng.random() < loss
    shift = np.deg2rad([0.4, -0.2, 0.3, 0.2, -0.2, 0.1])
    assert virtual.client.request_tail(1, 25, corrected(knots, 25, shift), virtual.t_ns) == ()
    virtual.step(4000)
    assert [answer.taken for answer in answers(virtual, TailAnswered)] == [True]
    assert [(e.reached, e.traj_id) for e in answers(virtual, TrajectoryEnded)] == [(True, 1)]
    assert virtual.plc.q_ref == pytest.approx(tuple(np.array(Q_END) + shift), abs=1e-9)
    assert virtual.plc.underruns == 0
    assert_no_step(virtual)


@pytest.mark.parametrize("loss", [0.0, 0.3])
@pytest.mark.parametrize("first", [13, 18, 24])
def test_a_correction_that_begins_like_the_old_tail_reaches_the_plc_all_the_same(first, loss):
    virtual, knots = running()
    rng = np.random.default_rng(3)
    virtual.lose = lambda direction, t_ns: rng.random() < loss
    shift = np.deg2rad([0.4, -0.2, 0.3, 0.2, -0.2, 0.1])
    tail = (*knots[first:25], *corrected(knots, 25, shift))
    assert virtual.client.request_tail(1, first, tail, virtual.t_ns) == ()
    virtual.step(4000)
    assert [answer.taken for answer in answers(virtual, TailAnswered)] == [True]
    assert [(e.reached, e.traj_id) for e in answers(virtual, TrajectoryEnded)] == [(True, 1)]
    assert virtual.plc.q_ref == pytest.approx(tuple(np.array(Q_END) + shift), abs=1e-9)
    assert_no_step(virtual)


def test_a_correction_that_changes_nothing_is_taken_at_once():
    virtual, knots = running()
    assert virtual.client.request_tail(1, 20, knots[20:], virtual.t_ns) == ()
    virtual.step(20)
    assert [answer.taken for answer in answers(virtual, TailAnswered)] == [True]
    shift = np.deg2rad([0.4, -0.2, 0.3, 0.2, -0.2, 0.1])
    assert virtual.client.request_tail(1, 25, corrected(knots, 25, shift), virtual.t_ns) == ()
    virtual.step(4000)
    assert [answer.taken for answer in answers(virtual, TailAnswered)] == [True, True]
    assert virtual.plc.q_ref == pytest.approx(tuple(np.array(Q_END) + shift), abs=1e-9)


@pytest.mark.parametrize("change", ["shorter", "longer"])
def test_a_correction_that_only_moves_the_end_is_answered_and_ends_at_rest(change):
    virtual, knots = running()
    at_rest = tuple(Knot(knots[-1].t_ns + i * 50 * MS, knots[-1].q) for i in range(1, 9))
    assert virtual.client.request_tail(1, 40, (*knots[40:], *at_rest), virtual.t_ns) == ()  # while the end is not there
    virtual.step(1400)
    if change == "shorter":
        short = (*knots[50:], *at_rest[:3])
        assert virtual.client.request_tail(1, 50, short, virtual.t_ns) == ()
    else:
        later = tuple(Knot(at_rest[-1].t_ns + i * 50 * MS, knots[-1].q) for i in range(1, 3))
        assert virtual.client.request_tail(1, 50, (*knots[50:], *at_rest, *later), virtual.t_ns) == ()
    virtual.step(4000)
    assert len(answers(virtual, TailAnswered)) == 2
    assert [e.reached for e in answers(virtual, TrajectoryEnded)] == [True]
    assert virtual.plc.q_ref == pytest.approx(Q_END, abs=1e-9)


def test_a_correction_before_the_first_motion_is_refused_and_the_trajectory_still_plays():
    virtual = VirtualPlc()
    virtual.arm()
    knots = quintic_knots(virtual.plc.q_ref, Q_END, 3.0)
    assert virtual.run(knots) == ()
    with pytest.raises(LocalProtocolError, match="has not begun to move"):
        virtual.client.request_tail(1, 25, corrected(knots, 25, np.zeros(6)), virtual.t_ns)
    virtual.step(4000)
    assert [(e.reached, e.traj_id) for e in answers(virtual, TrajectoryEnded)] == [(True, 1)]


def test_two_corrections_one_after_the_other():
    virtual, knots = running()
    shift = np.deg2rad([0.3, 0.1, -0.2, 0.1, 0.1, 0.1])
    first = corrected(knots, 20, shift)
    assert virtual.client.request_tail(1, 20, first, virtual.t_ns) == ()
    virtual.step(200)
    knots = (*knots[:20], *first)
    assert virtual.client.request_tail(1, 30, corrected(knots, 30, shift), virtual.t_ns) == ()
    virtual.step(3500)
    assert [answer.taken for answer in answers(virtual, TailAnswered)] == [True, True]
    assert virtual.plc.q_ref == pytest.approx(tuple(np.array(Q_END) + 2 * shift), abs=1e-9)


def test_a_correction_that_comes_too_late_is_refused_and_the_old_tail_goes_on():
    virtual, knots = running()
    shift = np.deg2rad([0.3, 0.1, -0.2, 0.1, 0.1, 0.1])
    virtual.lose = lambda direction, t_ns: direction == "command"
    assert virtual.client.request_tail(1, 10, corrected(knots, 10, shift), virtual.t_ns) == ()
    virtual.step(200)
    virtual.lose = lambda direction, t_ns: False
    virtual.step(4000)
    assert [answer.taken for answer in answers(virtual, TailAnswered)] == [False]
    (refused,) = answers(virtual, RejectSeen)[:1]
    assert "KNOT_CHANGED" in refused.text
    assert "knot[0].t_ns" in refused.text
    assert virtual.plc.q_ref == pytest.approx(Q_END, abs=1e-9)
    assert answers(virtual, TrajectoryEnded)[0].reached


def test_corrections_that_make_no_sense_are_told_at_once():
    virtual, knots = running()
    tail = corrected(knots, 25, np.zeros(6))
    with pytest.raises(LocalProtocolError, match="not running"):
        virtual.client.request_tail(2, 25, tail, virtual.t_ns)
    with pytest.raises(LocalProtocolError, match="cannot be replaced"):
        virtual.client.request_tail(1, 0, tail, virtual.t_ns)
    with pytest.raises(LocalProtocolError, match="at least 200 ms"):
        virtual.client.request_tail(1, 7, corrected(knots, 7, np.zeros(6)), virtual.t_ns)
    jump = tuple(Knot(k.t_ns, pad_to_eight_axes((k.q[0] + 0.05, *k.q[1:6])), k.qd, k.qdd) for k in tail)
    assert virtual.client.request_tail(1, 25, jump, virtual.t_ns) != ()
    virtual.step(4000)
    assert virtual.plc.q_ref == pytest.approx(Q_END, abs=1e-9)


def test_quick_stop_takes_every_joint_down_by_itself():
    virtual, _ = running()
    virtual.step(1000)
    before = np.abs(virtual.plc.qd_ref)
    virtual.client.request_stop("hands off", quick=True)
    virtual.step(30)
    assert virtual.plc.reference.motion is Motion.JOINT_STOP
    virtual.step(round(float((before / QDD_MAX).max()) * 1000) + 20)
    assert virtual.plc.state is PlcState.HOLD
    assert answers(virtual, TrajectoryEnded)[0].reason == "hands off"
    assert_no_step(virtual)


def test_with_one_key_on_both_ends_everything_works_and_without_it_nothing():
    virtual, _ = running(key=b"a key of 16 bytes, or more")
    virtual.step(3500)
    assert virtual.plc.q_ref == pytest.approx(Q_END, abs=1e-9)
    assert HeaderFlag.AUTH in virtual.client.state.flags
    stranger = VirtualPlc(key=b"a key of 16 bytes, or more")
    stranger.client.key = b""
    stranger.step(500)
    assert stranger.plc.state is PlcState.DISARMED
    assert stranger.plc.link.session == 0


def test_in_a_dry_run_the_reference_moves_and_the_machine_does_not():
    virtual, _ = running(dry_run=True)
    at = virtual.q.copy()
    virtual.step(3500)
    assert virtual.plc.q_ref == pytest.approx(Q_END, abs=1e-9)
    assert np.array_equal(virtual.q, at)
    assert HeaderFlag.DRY_RUN in virtual.client.state.flags
    assert virtual.client.state.fault_bits == 0


def test_an_arming_refused_for_want_of_the_enable_keeps_the_session():
    virtual = VirtualPlc()
    virtual.panel.enable_mode = "panel"
    virtual.client.request_arm()
    virtual.step(3000)
    assert virtual.plc.state is PlcState.LINKED
    assert virtual.client.linked
    assert "ENABLE" in virtual.client.last_reject
    virtual.panel.press_enable()
    virtual.step(200)
    assert virtual.plc.state is PlcState.HOLD


def test_the_emergency_stop_latches_and_leaves_the_valves_neutral():
    virtual, _ = running()
    virtual.step(500)
    virtual.panel.estop_pressed = True
    virtual.step(2)
    assert virtual.plc.state is PlcState.FAULT
    assert not np.any(virtual.plc.valves)
    virtual.client.request_reset()
    virtual.step(200)
    assert virtual.plc.state is PlcState.FAULT
    virtual.panel.estop_pressed = False
    virtual.step(400)
    assert virtual.plc.state is not PlcState.FAULT


def test_a_task_that_was_starved_is_a_fault_while_armed():
    virtual, _ = running()
    virtual.t_ns += 30 * MS
    virtual.step(1)
    assert virtual.plc.state is PlcState.FAULT
