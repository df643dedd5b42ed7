"""The PLC program in virtual time: playback, stops, silence, what it refuses, controllers."""

from dataclasses import replace

import numpy as np
import pytest
from plc_runs import (
    CYCLE_S,
    Q_END,
    QDD_MAX,
    STEP,
    armed,
    assert_no_step,
    end_of_ramp,
    last_command,
    started,
    stopping_s,
)
from virtual_plc import MACHINE, MS, Q_START, VirtualPlc, quintic_knots

from protocol.client_events import TrajectoryEnded
from protocol.codec import decode_state, encode_command
from protocol.codes import AxisBit, CommandFlag, HeaderFlag, Interp, Mode, PlcState, RejectCode, WarnBit
from protocol.errors import LocalProtocolError
from protocol.framing import RawFraming
from protocol.messages import Knot, pad_to_eight_axes
from protocol.playback import Playback
from sim_plc.plc.reference import Motion
from sim_plc.plc.settings import plc_settings
from sim_plc.plc.status import JointControl


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


class CutShort(Playback):
    """A PC that stops refilling: its last knot is not the end."""

    def window(self, state):
        return replace(super().window(state), command_flags=CommandFlag.START)

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
    assert Knot(0, pad_to_eight_axes(Q_START)) == knots[0]
