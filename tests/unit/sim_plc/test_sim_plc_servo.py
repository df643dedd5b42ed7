"""Servo mode through both ends of the link: limits hold, old targets stop, nothing goes on by itself."""

import numpy as np
import pytest
from virtual_plc import MS, Q_START, TABLE, VirtualPlc

from protocol.client_events import TrajectoryEnded
from protocol.codes import Mode, PlcState
from protocol.messages import ZEROS, pad_to_eight_axes
from protocol.timeouts import COMMAND_LOST_TIMEOUT, SERVO_STALE_TIMEOUT
from sim_plc.plc.reference import Motion

N = len(Q_START)
QD_MAX = np.array([axis.qd_max for axis in TABLE.axes])
QDD_MAX = np.array([axis.qdd_max for axis in TABLE.axes])


def servoing() -> VirtualPlc:
    virtual = VirtualPlc()
    virtual.arm()
    virtual.client.request_servo(1, virtual.t_ns)
    virtual.step(60)
    assert virtual.plc.reference.motion is Motion.SERVO
    return virtual


def steer(virtual, ms, target_of):
    """Every 20 ms the target of that time; times count from the call."""
    for t_ms in range(0, ms, 20):
        q, qd = target_of(t_ms / 1000.0)
        virtual.client.set_servo_target(pad_to_eight_axes(tuple(q)), pad_to_eight_axes(tuple(qd)), virtual.t_ns)
        virtual.step(20)


def assert_limits(virtual):
    qd = np.array([row[3] for row in virtual.trace])
    assert np.abs(qd / QD_MAX).max() <= 1.0 + 1e-9
    assert np.abs(np.diff(qd, axis=0) / 1e-3 / QDD_MAX).max() <= 1.0 + 1e-6


def ended(virtual):
    return [event for event in virtual.events if isinstance(event, TrajectoryEnded)]


def test_a_slow_target_is_followed_and_the_end_is_at_rest_on_it():
    virtual = servoing()
    rate = 0.3 * QD_MAX * np.where(np.array(Q_START) < 0.0, 1.0, -1.0)
    steer(virtual, 1000, lambda t: (np.array(Q_START) + rate * t, rate))
    assert np.abs(np.array(virtual.plc.q_ref) - (np.array(Q_START) + rate)).max() < 0.002  # rad: half a command of way
    final = np.array(Q_START) + rate
    virtual.client.set_servo_target(pad_to_eight_axes(tuple(final)), ZEROS, virtual.t_ns)
    virtual.client.finish_servo()
    virtual.step(1000)
    assert virtual.plc.state is PlcState.HOLD
    assert [(e.reached, e.traj_id) for e in ended(virtual)] == [(True, 1)]
    assert np.abs(np.array(virtual.plc.q_ref) - final).max() < 1e-6
    assert_limits(virtual)


@pytest.mark.parametrize("seed", range(5))
def test_a_wild_target_never_drives_the_reference_past_its_limits(seed):
    virtual = servoing()
    rng = np.random.default_rng(seed)

    def wild(t):
        del t
        reach = 0.2 * QD_MAX * rng.uniform(-1, 1, N)
        q = np.clip(np.array(virtual.plc.q_ref) + reach, [a.q_min for a in TABLE.axes], [a.q_max for a in TABLE.axes])
        return q, QD_MAX * rng.uniform(-1, 1, N)

    steer(virtual, 3000, wild)
    virtual.step(2000)
    assert_limits(virtual)
    q = np.array([row[2] for row in virtual.trace])
    assert (q >= [a.q_min - 1e-9 for a in TABLE.axes]).all()
    assert (q <= [a.q_max + 1e-9 for a in TABLE.axes]).all()


def test_the_caller_who_falls_silent_is_stopped_and_nothing_goes_on_by_itself():
    virtual = servoing()
    rate = 0.5 * QD_MAX * np.where(np.array(Q_START) < 0.0, 1.0, -1.0)
    steer(virtual, 400, lambda t: (np.array(Q_START) + rate * t, rate))
    virtual.step(1500)
    assert virtual.plc.state is PlcState.HOLD
    (end,) = ended(virtual)
    assert not end.reached
    assert "no servo target" in end.reason
    way_s = (np.array(virtual.plc.q_ref) - np.array(Q_START)) / rate
    assert (
        way_s <= 0.38 + 0.06 + 2.0 * np.abs(rate) / QDD_MAX
    ).all()  # last target, 60 ms of its way, a ramp from twice the rate
    assert virtual.plc.reference.motion is Motion.HOLD


def test_a_link_that_falls_silent_stops_the_target_after_60_ms_and_the_state_after_250_ms():
    virtual = servoing()
    rate = 0.5 * QD_MAX * np.where(np.array(Q_START) < 0.0, 1.0, -1.0)
    steer(virtual, 400, lambda t: (np.array(Q_START) + rate * t, rate))
    virtual.silent = True
    cut_ns = virtual.t_ns
    virtual.step(600)
    moving = [row for row in virtual.trace if row[0] > cut_ns + SERVO_STALE_TIMEOUT.duration_ns + 20 * MS]
    first = np.abs([row[3] for row in moving[:2]])
    assert (first[1] <= first[0] + 1e-12).all()  # slower from the moment that the target is old
    states = [(row[0], row[1]) for row in virtual.trace if row[0] > cut_ns]
    left = next(t for t, state in states if state is not PlcState.RUN)
    assert left - cut_ns <= COMMAND_LOST_TIMEOUT.duration_ns + 2 * MS
    assert virtual.plc.state is PlcState.HOLD


def test_a_target_that_is_too_far_is_refused_by_the_gate_and_the_motion_is_stopped():
    virtual = servoing()
    far = np.array(Q_START)
    far[0] += 0.3 * QD_MAX[0]
    virtual.client.set_servo_target(pad_to_eight_axes(tuple(far)), ZEROS, virtual.t_ns)
    virtual.step(500)
    (end,) = ended(virtual)
    assert "target minus q_ref" in end.reason
    assert virtual.plc.q_ref == pytest.approx(Q_START, abs=1e-9)


def test_a_trajectory_with_the_servo_motions_number_is_refused():
    virtual = servoing()
    assert virtual.client.state.mode_active is Mode.SERVO
    virtual.client.request_stop("enough")
    virtual.step(400)
    assert virtual.client.state.plc_state is PlcState.HOLD
