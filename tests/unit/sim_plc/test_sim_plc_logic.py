"""The PLC program: playback, ramps, watchdog, refusals; in virtual time."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from protocol.codec import encode_command
from protocol.codes import CommandFlag, FaultBit, Interp, Mode, PlcState, RejectCode
from protocol.errors import LocalProtocolError
from protocol.framing import RawFraming
from protocol.messages import Command, axes8
from sim_plc.plc.control import JointControllers
from sim_plc.plc.quintic import quintic_between
from sim_plc.plc.reference import ramp_from
from sim_plc.plc.ring import KnotRing

sys.path.insert(0, str(Path(__file__).parent))
from virtual_plc import MACHINE, MS, Q_START, TABLE, VirtualPlc, quintic_knots

STEP = np.deg2rad([6.0, -4.0, 5.0, 8.0, -6.0, 9.0])
Q_END = tuple((np.array(Q_START) + STEP).tolist())
LIMITS_QD = np.array([joint.qd_max_rad_s for joint in MACHINE.joints])
LIMITS_QDD = np.array([joint.qdd_max_rad_s2 for joint in MACHINE.joints])


def armed():
    virtual = VirtualPlc()
    virtual.arm()
    return virtual


def started(q_end=Q_END, duration_s=2.0):
    virtual = armed()
    virtual.refused = virtual.run(quintic_knots(virtual.plc.q_ref, q_end, duration_s))
    return virtual


def references(virtual, since_ns):
    rows = [row for row in virtual.trace if row[0] >= since_ns]
    return np.array([row[3] for row in rows])


def command(**fields):
    values = {"session": 7, "seq": 1, "t_send_ns": 0, "mode": Mode.TRAJECTORY, "interp": Interp.QUINTIC, "traj_id": 1}
    return Command(**(values | fields))


def test_playback_equals_the_quintic_of_the_trajectory():
    virtual = started()
    assert virtual.refused == ()
    knots = quintic_knots(virtual.plc.q_ref, Q_END, 2.0)
    virtual.step(2600)
    assert virtual.plc.state is PlcState.HOLD
    run = [row for row in virtual.trace if row[1] is PlcState.RUN]
    t0 = run[0][0]
    for t_ns, _, q_ref, _, _ in run[1:-1:37]:
        u = (t_ns - t0 + MS) * 1e-9 / 2.0
        s = 10 * u**3 - 15 * u**4 + 6 * u**5
        expected = np.array(knots[0].q[:6]) + s * (np.array(knots[-1].q[:6]) - np.array(knots[0].q[:6]))
        assert np.abs(np.array(q_ref) - expected).max() < 1e-9
    assert virtual.plc.q_ref == pytest.approx(knots[-1].q[:6], abs=1e-12)


def test_reference_never_steps_and_stays_inside_limits():
    virtual = started()
    since = virtual.t_ns
    virtual.step(2600)
    qd = references(virtual, since)
    assert (np.abs(qd).max(axis=0) <= LIMITS_QD).all()
    assert (np.abs(np.diff(qd, axis=0)).max(axis=0) <= 1.1 * LIMITS_QDD * 1e-3).all()


@pytest.mark.parametrize("silent_after_ms", [150, 400, 777, 1000, 1350, 1800])
def test_silence_at_any_moment_ramps_and_holds_within_its_bound(silent_after_ms):
    virtual = started()
    virtual.step(silent_after_ms)
    virtual.silent = True
    t_silent = virtual.t_ns
    virtual.step(900)
    stopping = [row for row in virtual.trace if row[0] > t_silent and row[1] is PlcState.STOPPING]
    if stopping:
        assert (stopping[0][0] - t_silent) <= 260 * MS
        speed = np.abs(stopping[0][3])
        bound_s = (speed / (0.7 * LIMITS_QDD)).max() + 0.003
        assert (stopping[-1][0] - stopping[0][0]) * 1e-9 <= bound_s
    qd = references(virtual, t_silent)
    assert (np.abs(np.diff(qd, axis=0)).max(axis=0) <= 1.1 * LIMITS_QDD * 1e-3).all()
    assert virtual.plc.state is PlcState.HOLD
    assert np.abs(qd[-1]).max() == 0.0
    virtual.step(400)
    assert virtual.plc.state is PlcState.DISARMED
    held = virtual.plc.q_ref
    virtual.silent = False
    virtual.step(1500)  # the PC is back, but nothing moves by itself
    assert virtual.plc.state in (PlcState.DISARMED, PlcState.LINKED)
    assert np.abs(np.array(virtual.plc.q_ref) - held).max() < 1e-3


def test_an_unarmed_plc_never_opens_a_valve():
    virtual = VirtualPlc()
    virtual.step(800)
    with pytest.raises(LocalProtocolError, match="must be armed"):
        virtual.run(quintic_knots(Q_START, Q_END, 2.0))
    for seq in range(100, 140):  # and what a wrong PC would send all the same
        forged = command(session=7, seq=seq, knots=KNOTS[:6], cmd_flags=CommandFlag.START, axis_mask=63)
        virtual.plc.receive(RawFraming().wrap(encode_command(forged), seq), virtual.t_ns, "pc")
        virtual.step(20)
    assert all(max(map(abs, row[4])) == 0.0 for row in virtual.trace)
    assert virtual.plc.state in (PlcState.DISARMED, PlcState.LINKED)


def test_without_the_key_at_the_machine_it_does_not_arm():
    virtual = VirtualPlc()
    virtual.plc.local_enable = False
    virtual.step(200)
    virtual.client.request_arm()
    virtual.step(1500)
    assert virtual.plc.state in (PlcState.LINKED, PlcState.DISARMED)  # refused commands do not feed the watchdog


def test_stop_ramps_and_a_new_trajectory_starts_from_the_reference():
    virtual = started()
    virtual.step(900)
    virtual.client.request_stop("test")
    virtual.step(900)
    assert virtual.plc.state is PlcState.HOLD
    halfway = virtual.plc.q_ref
    assert np.abs(np.array(halfway) - Q_END).max() > np.deg2rad(0.5)
    assert virtual.run(quintic_knots(halfway, Q_END, 2.0), traj_id=2) == ()
    virtual.step(2600)
    assert virtual.plc.q_ref == pytest.approx(Q_END, abs=1e-9)


def test_thirty_percent_loss_changes_nothing_in_the_path():
    clean, lossy = started(), started()
    rng = np.random.default_rng(5)
    lossy.lose = lambda direction, t_ns: rng.random() < 0.3
    for virtual in (clean, lossy):
        virtual.step(3200)
    paths = [[row[2] for row in v.trace if row[1] is PlcState.RUN] for v in (clean, lossy)]
    assert len(paths[0]) == len(paths[1])
    assert paths[0] == paths[1]


def test_a_joint_that_does_not_follow_latches_a_fault():
    virtual = started(q_end=tuple(np.array(Q_START) + np.deg2rad([55.0, 0, 0, 0, 0, 0])), duration_s=8.0)
    frozen = virtual.q.copy()
    for _ in range(9000):
        virtual.q = frozen.copy()
        virtual.step()
    assert virtual.plc.state is PlcState.FAULT
    assert max(map(abs, virtual.trace[-1][4])) == 0.0
    assert FaultBit.LAG in virtual.plc._faults


def test_local_lever_ignores_the_network():
    virtual = started()
    virtual.step(500)
    virtual.plc.set_local(True, virtual.t_ns)
    virtual.step(300)
    assert virtual.plc.state is PlcState.LOCAL
    assert max(map(abs, virtual.trace[-1][4])) == 0.0


KNOTS = quintic_knots(Q_START, Q_END, 2.0)


def changed(index, **fields):
    return tuple(replace(knot, **fields) if i == index else knot for i, knot in enumerate(KNOTS[:6]))


def with_axis(values, axis, value):
    return axes8(tuple(value if i == axis else v for i, v in enumerate(values[:6])))


@pytest.mark.parametrize(
    ("knots", "code"),
    [
        (KNOTS[:6], RejectCode.NONE),
        (changed(0, q=with_axis(KNOTS[0].q, 0, KNOTS[0].q[0] + 1e-3)), RejectCode.START),
        (changed(0, qd=with_axis(KNOTS[0].qd, 2, 0.01)), RejectCode.START),
        (changed(3, q=with_axis(KNOTS[3].q, 1, 5.0)), RejectCode.LIMIT_Q),
        (changed(3, qd=with_axis(KNOTS[3].qd, 1, 5.0)), RejectCode.LIMIT_QD),
        (changed(3, qdd=with_axis(KNOTS[3].qdd, 1, 50.0)), RejectCode.LIMIT_QDD),
        (changed(3, q=with_axis(KNOTS[3].q, 1, KNOTS[3].q[1] + 0.1)), RejectCode.IMPLIED_SPEED),
        (changed(3, t_ns=KNOTS[2].t_ns + 1 * MS), RejectCode.KNOT_SPACING),
        (changed(5, t_ns=KNOTS[4].t_ns + 300 * MS), RejectCode.KNOT_SPACING),
        ((), RejectCode.INTERP),
    ],
)
def test_bad_knots_are_refused_with_their_code(knots, code):
    ring = KnotRing(TABLE)
    assert ring.check(command(knots=knots), axes8(Q_START), 0) is code


def test_resent_knots_must_be_the_same_and_without_a_gap():
    ring = KnotRing(TABLE)
    ring.load(command(knots=KNOTS[:6]))
    assert ring.check(command(knot_first=3, knots=KNOTS[3:9]), axes8(Q_START), 0) is RejectCode.NONE
    assert ring.check(command(knot_first=7, knots=KNOTS[7:12]), axes8(Q_START), 0) is RejectCode.KNOT_GAP
    other = (replace(KNOTS[4], q=with_axis(KNOTS[4].q, 0, KNOTS[4].q[0] + 1e-6)),)
    assert ring.check(command(knot_first=4, knots=other), axes8(Q_START), 0) is RejectCode.KNOT_CHANGED
    ring.load(command(knot_first=3, knots=KNOTS[3:9]))
    assert ring.last == 8
    moving = command(knot_first=8, knots=KNOTS[8:12], cmd_flags=CommandFlag.LAST_IS_END)
    assert ring.check(moving, axes8(Q_START), 0) is RejectCode.END_NOT_AT_REST


def test_quintic_agrees_with_both_knots():
    a, b = KNOTS[10], KNOTS[11]
    quintic = quintic_between(a, b, 6)
    for knot, u in ((a, 0.0), (b, 0.05)):
        for got, wanted in zip(quintic.at(u), (knot.q, knot.qd, knot.qdd), strict=True):
            assert np.abs(np.array(got) - wanted[:6]).max() < 1e-9


def test_ramp_has_no_step_and_ends_at_rest():
    ramp = ramp_from([1.0, 2.0], [0.2, -0.1], 0, (0.4, 0.4))
    assert ramp.duration_s == pytest.approx(0.5)
    assert ramp.at(0) == (False, [1.0, 2.0], [0.2, -0.1])
    at_rest, q, qd = ramp.at(500 * MS)
    assert at_rest
    assert q == pytest.approx([1.05, 1.975])
    assert qd == [0.0, 0.0]


def test_pt1_lags_and_p_does_not():
    joints = tuple(
        replace(j, kp_frac_per_rad=2.0, pt1_tau_s=tau) for j, tau in zip(MACHINE.joints, [0, 0.15] * 3, strict=True)
    )
    controllers = JointControllers(joints, 0.001)
    first = controllers.valves([0.1] * 6, [0.0] * 6)
    assert first[0] == pytest.approx(0.2)
    assert first[1] == pytest.approx(0.2 / 151.0)
    for _ in range(149):
        last = controllers.valves([0.1] * 6, [0.0] * 6)
    assert last[1] == pytest.approx(0.2 * (1 - np.exp(-1.0)), rel=0.01)
    assert controllers.valves([9.0] * 6, [0.0] * 6)[0] == 1.0
