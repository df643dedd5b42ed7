"""The PLC program in virtual time: playback, stops, silence, arming, faults, local panel."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from virtual_plc import MACHINE, MS, Q_START, VirtualPlc, quintic_knots

from protocol.client_events import TrajectoryEnded
from protocol.codec import decode_state, encode_command
from protocol.codes import AxisBit, CommandFlag, FaultBit, HeaderFlag, Interp, Mode, PlcState, RejectCode, WarnBit
from protocol.errors import LocalProtocolError
from protocol.framing import RawFraming
from protocol.messages import Command, Knot, axes8
from protocol.playback import Playback
from sim_plc.plc.joint_control import JointControl
from sim_plc.plc.local_panel import LocalPanel
from sim_plc.plc.reference import Motion
from sim_plc.plc.settings import plc_settings

STEP = np.deg2rad([6.0, -4.0, 5.0, 8.0, -6.0, 9.0])
Q_END = tuple((np.array(Q_START) + STEP).tolist())
QD_MAX = np.array([joint.qd_max_rad_s for joint in MACHINE.joints])
QDD_MAX = np.array([joint.qdd_max_rad_s2 for joint in MACHINE.joints])
CYCLE_S = 1e-3
BENDING = 1.002  # of the limit: where the path bends, the guess of where a cycle ends is a little off


def armed(**kwargs):
    virtual = VirtualPlc(**kwargs)
    virtual.arm()
    return virtual


def started(q_end=Q_END, duration_s=2.0, **kwargs):
    virtual = armed(**kwargs)
    assert virtual.run(quintic_knots(virtual.plc.q_ref, q_end, duration_s)) == ()
    return virtual


def references(virtual, since_ns=0):
    rows = [row for row in virtual.trace if row[0] >= since_ns]
    return np.array([row[2] for row in rows]), np.array([row[3] for row in rows])


def assert_no_step(virtual):
    q, qd = references(virtual)
    first = next(i for i, row in enumerate(virtual.trace) if row[1] is PlcState.HOLD)
    q, qd = q[first:], qd[first:]
    assert (np.abs(qd) <= QD_MAX).all()
    assert (np.abs(np.diff(qd, axis=0)) <= BENDING * QDD_MAX * CYCLE_S).all()
    # q_ref is the integral of qd_ref: trapezoid, to third order in the cycle; but for the end of a ramp, where it is
    # set to where the joints have come to rest
    states = [row[1] for row in virtual.trace[first:]]
    ramp_ends = [a is not PlcState.HOLD and b is PlcState.HOLD for a, b in pairwise(states)]
    off = np.abs(np.diff(q, axis=0) - 0.5 * (qd[1:] + qd[:-1]) * CYCLE_S)
    assert off[~np.array(ramp_ends)].max() < 1e-7


def end_of_ramp(virtual):
    """q_ref of the last cycle of the newest ramp."""
    return np.array([row for row in virtual.trace if row[1] is PlcState.STOPPING][-1][2])


def stopping_s(virtual, since_ns):
    """Delay from `since_ns` to the ramp's first cycle, and its length [s]."""
    rows = [row for row in virtual.trace if row[0] > since_ns and row[1] is PlcState.STOPPING]
    return (rows[0][0] - since_ns) * 1e-9, (rows[-1][0] - rows[0][0] + MS) * 1e-9, np.abs(rows[0][3])


def test_playback_is_the_quintic_of_the_trajectory_to_1e_12():
    virtual = started()
    q0 = np.array(virtual.plc.q_ref)
    virtual.step(2600)
    run = [row for row in virtual.trace if row[1] is PlcState.RUN]
    t_start = run[0][0] - MS
    for t_ns, _, q_ref, qd_ref, _ in run:
        u = (t_ns - t_start) * 1e-9 / 2.0
        s, sd = 10 * u**3 - 15 * u**4 + 6 * u**5, (30 * u**2 - 60 * u**3 + 30 * u**4) / 2.0
        assert np.abs(np.array(q_ref) - q0 - s * (np.array(Q_END) - q0)).max() < 1e-12
        assert np.abs(np.array(qd_ref) - sd * (np.array(Q_END) - q0)).max() < 1e-12
    assert virtual.plc.state is PlcState.HOLD
    assert virtual.plc.q_ref == Q_END
    assert_no_step(virtual)
    ended = [event for event in virtual.events if isinstance(event, TrajectoryEnded)]
    assert [event.reached for event in ended] == [True]


def test_what_the_state_says_of_playback():
    virtual = started()
    virtual.step(1500)
    state = virtual.client.state
    assert state.plc_state is PlcState.RUN
    assert state.mode_active is Mode.TRAJECTORY
    assert state.knot_playing == state.t_play_ns // (50 * MS)
    assert state.knot_last == 40
    assert state.buffer_us == pytest.approx((2_000_000_000 - state.t_play_ns) / 1000, abs=1)
    assert HeaderFlag.SIMULATION in state.flags
    virtual.step(1500)
    state = virtual.client.state
    assert (state.traj_id, state.knot_playing, state.t_play_ns, state.buffer_us) == (1, 40, 2_000_000_000, 0)
    assert state.axis_status[:7] == (AxisBit.IN_USE,) * 6 + (0,)


@pytest.mark.parametrize("silent_after_ms", [130, 200, 400, 777, 1000, 1350, 1800, 1950])
def test_silence_at_any_moment_ends_in_hold_within_its_bound_and_never_resumes(silent_after_ms):
    virtual = started()
    virtual.step(silent_after_ms)
    virtual.silent = True
    t_silent = virtual.t_ns
    virtual.step(900)
    ran_out = all(row[1] is not PlcState.STOPPING for row in virtual.trace)  # the end was reached before the watchdog
    assert ran_out is (silent_after_ms >= 1800)
    if not ran_out:
        delay_s, length_s, speed = stopping_s(virtual, t_silent)
        assert delay_s <= 0.260
        assert length_s <= (speed / QDD_MAX).max() + 0.003
    assert virtual.plc.state is PlcState.HOLD
    assert virtual.plc.qd_ref == (0.0,) * 6
    assert_no_step(virtual)
    virtual.step(400)
    assert virtual.plc.state is PlcState.DISARMED
    assert max(map(abs, virtual.trace[-1][4])) == 0.0
    t_back, held = virtual.t_ns, virtual.q.copy()
    virtual.silent = False
    virtual.step(300)
    virtual.reconnect(session=8)
    virtual.step(1500)  # the PC is back, but nothing moves by itself
    assert virtual.plc.state is PlcState.LINKED
    assert np.abs(virtual.q - held).max() == 0.0
    assert all(max(map(abs, row[4])) == 0.0 for row in virtual.trace if row[0] > t_back)


def test_a_short_silence_stops_and_the_same_trajectory_does_not_go_on():
    virtual = started(duration_s=4.0)
    virtual.step(1500)
    virtual.silent = True
    virtual.step(300)
    virtual.silent = False
    virtual.step(800)
    assert virtual.plc.state is PlcState.HOLD
    stopped = virtual.plc.q_ref
    virtual.step(2000)
    assert virtual.plc.q_ref == stopped
    assert virtual.client.state.wd_trips == 1
    assert virtual.run(quintic_knots(stopped, Q_END, 2.0), traj_id=2) == ()
    virtual.step(2600)
    assert virtual.plc.q_ref == Q_END


def test_stop_keeps_to_the_path_and_a_new_trajectory_starts_from_the_reference():
    virtual = started()
    q0 = np.array(virtual.plc.q_ref)
    virtual.step(900)
    t_stop = virtual.t_ns
    virtual.client.request_stop("test")
    virtual.step(900)
    _, length_s, speed = stopping_s(virtual, t_stop)
    assert length_s <= (speed / QDD_MAX).max() + 0.003
    assert virtual.plc.state is PlcState.HOLD
    assert_no_step(virtual)
    halfway = end_of_ramp(virtual)
    shares = (halfway - q0) / (np.array(Q_END) - q0)
    assert np.ptp(shares) < 1e-9  # on the straight joint path
    assert 0.1 < shares[0] < 0.9
    assert virtual.run(quintic_knots(virtual.plc.q_ref, Q_END, 2.0), traj_id=2) == ()
    virtual.step(2600)
    assert virtual.plc.q_ref == Q_END


def test_quick_stop_brakes_every_joint_by_its_own_limit():
    virtual = started()
    virtual.step(900)
    sent = replace(last_command(virtual), mode=Mode.QUICK_STOP, knots=(), interp=Interp.NONE, cmd_flags=CommandFlag(0))
    virtual.silent = True
    virtual.plc.receive(RawFraming().wrap(encode_command(sent), sent.seq), virtual.t_ns, "pc")
    assert virtual.plc.reference.motion is Motion.JOINT_STOP
    speed = np.abs(virtual.plc.qd_ref)
    cycles = np.zeros(6)
    while virtual.plc.state is PlcState.STOPPING:
        virtual.step()
        cycles += np.abs(virtual.plc.qd_ref) > 0.0
    assert cycles * CYCLE_S == pytest.approx(speed / QDD_MAX, abs=1.1e-3)
    assert_no_step(virtual)


def last_command(virtual):
    """A heartbeat that the PLC would accept next."""
    client = virtual.client
    return Command(
        session=7,
        seq=client._seq + 1,
        t_send_ns=virtual.t_ns,
        ack_plc_seq=client.state.seq,
        t_plc_echo_ns=client.state.t_send_ns,
        axis_mask=63,
        cfg_id=client.state.cfg_id,
        arm_nonce=client.state.nonce,
    )


class CutShort(Playback):
    """A PC that stops refilling: its last knot is not the end."""

    def window(self, state):
        return replace(super().window(state), flags=CommandFlag.START)

    def reached(self, state):
        return False


def test_running_out_of_knots_brakes_on_the_path_before_the_last_knot():
    virtual = armed()
    knots = quintic_knots(virtual.plc.q_ref, Q_END, 4.0)
    assert virtual.run(knots) == ()
    virtual.client._run.motion = CutShort(1, knots[:41])  # flat out at knot 40, and nothing after it
    virtual.step(3500)
    assert virtual.plc.state is PlcState.HOLD
    assert virtual.plc.underruns == 1
    assert virtual.client.state.underruns == 1
    assert WarnBit.UNDERRUN in WarnBit(virtual.client.state.warn_bits)
    assert_no_step(virtual)
    u = virtual.client.state.t_play_ns * 1e-9 / 4.0
    assert 0.47 < u <= 0.5  # as late as it could, and not past knot 40
    s = 10 * u**3 - 15 * u**4 + 6 * u**5
    expected = np.array(Q_START) + s * STEP
    assert np.abs(end_of_ramp(virtual) - expected).max() < 1e-4  # the last cycle of the ramp is not yet its end


def test_an_unarmed_plc_never_opens_a_valve():
    virtual = VirtualPlc()
    virtual.step(800)
    with pytest.raises(LocalProtocolError, match="must be armed"):
        virtual.run(quintic_knots(Q_START, Q_END, 2.0))
    knots = quintic_knots(Q_START, Q_END, 2.0)[:6]
    for _ in range(40):  # and what a wrong PC would send all the same
        forged = replace(
            last_command(virtual), mode=Mode.TRAJECTORY, knots=knots, traj_id=1, interp=Interp.QUINTIC,
            cmd_flags=CommandFlag.START,
        )  # fmt: skip
        virtual.plc.receive(RawFraming().wrap(encode_command(forged), forged.seq), virtual.t_ns, "pc")
        virtual.step(20)
    assert all(max(map(abs, row[4])) == 0.0 for row in virtual.trace)
    assert virtual.client.state.reject_code == RejectCode.MODE_ILLEGAL
    assert virtual.plc.state is PlcState.LINKED


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"axis_mask": 31}, RejectCode.AXIS_MASK),
        ({"interp": Interp.CUBIC}, RejectCode.INTERP),
        ({"speed_override": 1.01}, RejectCode.OVERRIDE),
        ({"speed_override": -0.01}, RejectCode.OVERRIDE),
        ({"knot_first": 1}, RejectCode.KNOT_GAP),
        ({"knots": ()}, RejectCode.VALUE),
        ({"cfg_id": 1}, RejectCode.CFG),
        ({"mode": Mode.SERVO}, RejectCode.INTERP),
        ({"mode": Mode.SERVO, "interp": Interp.LINEAR}, RejectCode.VALUE),
        ({}, RejectCode.NONE),
    ],
)
def test_a_bad_trajectory_command_is_refused_with_its_code_and_nothing_moves(fields, code):
    virtual = armed()
    knots = quintic_knots(virtual.plc.q_ref, Q_END, 2.0)[:6]
    base = {"mode": Mode.TRAJECTORY, "knots": knots, "traj_id": 1, "interp": Interp.QUINTIC}
    sent = replace(last_command(virtual), **(base | {"cmd_flags": CommandFlag.START} | fields))
    virtual.plc.receive(RawFraming().wrap(encode_command(sent), sent.seq), virtual.t_ns, "pc")
    state = decode_state(virtual.plc.send(virtual.t_ns))
    assert state.reject_code == code
    assert virtual.plc.state is (PlcState.HOLD if code else PlcState.RUN)
    assert virtual.plc.reference.motion is (Motion.HOLD if code else Motion.PLAY)


def test_thirty_percent_loss_changes_nothing_in_the_path():
    clean, lossy = started(), started()
    rng = np.random.default_rng(5)
    lossy.lose = lambda direction, t_ns: rng.random() < 0.3
    for virtual in (clean, lossy):
        virtual.step(3200)
    paths = [[row[2] for row in v.trace if row[1] is PlcState.RUN] for v in (clean, lossy)]
    assert len(paths[0]) == len(paths[1])
    assert paths[0] == paths[1]


@pytest.mark.parametrize("seed", range(6))
def test_no_mix_of_loss_makes_the_reference_step(seed):
    virtual = started(duration_s=3.0)
    rng = np.random.default_rng(seed)
    bursts = {(i, d): rng.random() < 0.35 for i in range(40) for d in ("state", "command")}
    t0 = virtual.t_ns
    virtual.lose = lambda direction, t_ns: bursts[(t_ns - t0) // (120 * MS) % 40, direction] or rng.random() < 0.2
    virtual.step(4000)
    assert_no_step(virtual)
    assert virtual.plc.state is not PlcState.RUN


def test_lower_speed_override_plays_the_same_path_slower():
    virtual = armed()
    virtual.client.speed_override = 0.5
    assert virtual.run(quintic_knots(virtual.plc.q_ref, Q_END, 2.0)) == ()
    virtual.step(3000)
    assert virtual.plc.state is PlcState.RUN
    assert virtual.client.state.speed_scale == pytest.approx(0.5)
    virtual.step(1500)
    assert virtual.plc.q_ref == Q_END
    assert len([row for row in virtual.trace if row[1] is PlcState.RUN]) == pytest.approx(4000, abs=2)
    assert_no_step(virtual)


def test_a_new_session_may_number_its_trajectories_from_one_again():
    virtual = started()
    virtual.step(2600)
    virtual.silent = True
    virtual.step(1200)
    virtual.reconnect(session=8)
    virtual.arm()
    assert virtual.client.state.traj_id == 0  # nothing of the old session can be taken for reached
    assert virtual.run(quintic_knots(virtual.plc.q_ref, Q_START, 2.0), traj_id=1) == ()
    virtual.step(2600)
    assert virtual.plc.q_ref == pytest.approx(Q_START, abs=1e-12)


# --- faults and the panel ---------------------------------------------------------------------------------------------


def test_a_joint_that_does_not_follow_latches_a_fault():
    virtual = started(q_end=tuple(np.array(Q_START) + np.deg2rad([55.0, 0, 0, 0, 0, 0])), duration_s=8.0)
    frozen = virtual.q.copy()
    for _ in range(9000):
        virtual.q = frozen.copy()
        virtual.step()
    assert virtual.plc.state is PlcState.FAULT
    assert max(map(abs, virtual.trace[-1][4])) == 0.0
    assert FaultBit(virtual.client.state.fault_bits) == FaultBit.LAG
    assert_no_step_until_fault(virtual)
    virtual.client.request_reset()
    virtual.step(200)
    assert virtual.plc.state is PlcState.DISARMED
    assert virtual.plc.monitor.latched == FaultBit(0)


def assert_no_step_until_fault(virtual):
    rows = [row for row in virtual.trace if row[1] in (PlcState.RUN, PlcState.FAULT)]
    qd = np.array([row[3] for row in rows])
    assert (np.abs(np.diff(qd, axis=0)) <= BENDING * QDD_MAX * CYCLE_S).all()


def test_hot_oil_ramps_down_and_cannot_be_reset_while_it_is_hot():
    virtual = started()
    virtual.step(900)
    virtual.t_oil_c = 90.0
    virtual.step(700)
    assert virtual.plc.state is PlcState.FAULT
    assert_no_step_until_fault(virtual)
    assert FaultBit(virtual.client.state.fault_bits) == FaultBit.OIL_TEMPERATURE
    virtual.client.request_reset()
    virtual.step(200)
    assert virtual.plc.state is PlcState.FAULT
    assert virtual.client.state.reject_code == RejectCode.FAULT_PRESENT
    virtual.t_oil_c = 60.0
    virtual.step(400)
    assert virtual.plc.state is PlcState.DISARMED


def test_an_encoder_that_reads_nan_closes_the_valves_at_once_and_still_tells():
    virtual = started()
    virtual.step(900)
    virtual.q[2] = np.nan
    virtual.step(1)
    assert virtual.plc.state is PlcState.FAULT
    assert max(map(abs, virtual.trace[-1][4])) == 0.0
    virtual.step(50)
    state = virtual.client.state
    assert FaultBit.SENSOR in FaultBit(state.fault_bits)
    assert AxisBit.ENCODER_FAULT in AxisBit(state.axis_status[2])
    assert np.isfinite(state.q).all()


def test_panel_enable_must_be_pressed_after_each_disarming():
    panel = LocalPanel("panel")
    virtual = VirtualPlc(panel=panel)
    panel.press_enable()  # before the PLC is up: an enable left on
    virtual.step(200)
    virtual.client.request_arm()
    virtual.step(900)
    assert virtual.plc.state in (PlcState.LINKED, PlcState.DISARMED)
    assert virtual.client.last_reject.startswith("ENABLE")
    virtual.silent = True
    virtual.step(1100)  # the session is void
    panel.press_enable()
    virtual.reconnect(9)
    virtual.arm()
    assert virtual.run(quintic_knots(virtual.plc.q_ref, Q_END, 2.0)) == ()
    virtual.step(900)
    panel.release_enable()
    virtual.step(500)
    assert virtual.plc.state is PlcState.FAULT
    assert FaultBit(virtual.client.state.fault_bits) == FaultBit.LOCAL_ENABLE_LOST
    assert_no_step_until_fault(virtual)


def test_local_lever_ramps_down_and_ignores_the_network():
    virtual = started()
    virtual.step(900)
    virtual.panel.lever_taken = True
    virtual.step(1)
    assert virtual.plc.state is PlcState.LOCAL
    assert max(map(abs, virtual.plc.qd_ref)) > 0.0  # not snapped shut
    virtual.step(600)
    assert max(map(abs, virtual.trace[-1][4])) == 0.0
    virtual.panel.lever_taken = False
    virtual.step(10)
    assert virtual.plc.state is PlcState.DISARMED


def test_arming_beyond_the_joint_range_or_while_moving_is_refused():
    for change, code in ((np.deg2rad([0, 45, 0, 0, 0, 0]), "LIMIT_Q"), (None, "LAG")):
        virtual = VirtualPlc()
        if change is not None:
            virtual.q = virtual.q + change
        virtual.qd = np.full(6, 0.1) if change is None else np.zeros(6)
        virtual.step(200)
        virtual.client.request_arm()
        virtual.step(700)
        assert virtual.plc.state is PlcState.LINKED
        assert virtual.client.last_reject.startswith(code)


# --- controllers ------------------------------------------------------------------------------------------------------


def test_pt1_lags_and_p_does_not():
    joints = tuple(
        replace(j, kp_frac_per_rad=2.0, pt1_tau_s=tau) for j, tau in zip(MACHINE.joints, [0, 0.15] * 3, strict=True)
    )
    control = JointControl(plc_settings(replace(MACHINE, joints=joints)))
    q_ref, q = np.full(6, 0.1), np.zeros(6)
    first = control.control(q_ref, q, 1.0).copy()
    assert first[0] == pytest.approx(0.2)
    assert first[1] == pytest.approx(0.2 * (1 - np.exp(-0.001 / 0.15)))
    for _ in range(149):
        last = control.control(q_ref, q, 1.0)
    assert last[1] == pytest.approx(0.2 * (1 - np.exp(-1.0)), rel=1e-9)
    assert control.control(np.full(6, 9.0), q, 1.0)[0] == 1.0
    assert control.control(np.full(6, -9.0), q, 0.25)[2] == -0.25
    assert (control.neutral() == 0.0).all()


def test_hold_is_where_the_joints_were_when_armed():
    virtual = armed()
    assert virtual.plc.q_ref == Q_START
    assert virtual.plc.reference.motion is Motion.HOLD


def test_prefilled_knots_wait_for_the_start_flag():
    virtual = armed()
    knots = quintic_knots(virtual.plc.q_ref, Q_END, 2.0)[:6]
    sent = replace(last_command(virtual), mode=Mode.TRAJECTORY, knots=knots, traj_id=1, interp=Interp.QUINTIC)
    virtual.plc.receive(RawFraming().wrap(encode_command(sent), sent.seq), virtual.t_ns, "pc")
    assert virtual.plc.ring.last == 5
    virtual.silent = True
    virtual.step(100)
    assert virtual.plc.state is PlcState.HOLD
    assert virtual.plc.q_ref == Q_START
    assert Knot(0, axes8(Q_START)) == knots[0]
