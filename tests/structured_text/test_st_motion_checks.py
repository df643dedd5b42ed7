"""FB_HmMotion refuses what the simulated PLC refuses, with the same code and the same field."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from st_motion_block import program_of
from st_motion_cases import (
    BEGIN,
    CYCLE_S,
    END,
    FLAT,
    KNOTS,
    SETTINGS,
    START,
    TAIL,
    changed,
    load_all,
    pair_at,
    run_out,
    servo,
    traj,
)
from st_motion_pair import MS, Q_START, MotionPair, bits

from protocol.codec import encode_command
from protocol.codes import CommandFlag, Interp, Mode, RejectCode
from protocol.messages import Command, Knot, pad_to_eight_axes
from sim_plc.plc.knot_checks import segment_peaks
from sim_plc.plc.reference import Motion


def refused(pair: MotionPair, command: Command, code: RejectCode, offset: int) -> None:
    """Both refuse (deliver compares them), and with what the page says."""
    before = pair.state()
    assert pair.deliver(command) is code
    assert pair.st.check(encode_command(command), command.mode is Mode.SERVO) == (code, offset)
    assert pair.state() == before


K = KNOTS[:6]
Q3 = K[1].q[3]
NEW_REFUSED = [
    (traj(interp=Interp.CUBIC), RejectCode.INTERP, 65),
    (traj(first=1), RejectCode.KNOT_GAP, 60),
    (traj(first=2**32 - 1), RejectCode.KNOT_GAP, 60),
    (traj(knots=K[:1]), RejectCode.VALUE, 64),
    (traj(knots=()), RejectCode.VALUE, 64),
    (traj(knots=changed(K, 0, t_ns=1)), RejectCode.START, 80),
    (traj(knots=changed(K, 0, q=(2, K[0].q[2] + 1.1e-5))), RejectCode.START, 104),
    (traj(knots=changed(K, 0, q=(6, 1.1e-5))), RejectCode.START, 136),
    (traj(knots=changed(K, 0, q=(6, 1e-6))), RejectCode.AXIS_MASK, 136),
    (traj(knots=changed(K, 0, qd=(1, -1.1e-6))), RejectCode.START, 160),
    (traj(knots=changed(K, 0, qdd=(5, 1.1e-6))), RejectCode.START, 256),
    (traj(knots=changed(K, 3, q=(6, 1e-300))), RejectCode.AXIS_MASK, 736),
    (traj(knots=changed(K, 3, qd=(7, -1.0))), RejectCode.AXIS_MASK, 808),
    (traj(knots=changed(K, 3, qdd=(6, 1e9))), RejectCode.AXIS_MASK, 864),
    (traj(knots=changed(K, 2, qd=(0, -1.0))), RejectCode.LIMIT_QD, 552),
    (traj(knots=changed(K, 2, qdd=(0, 9.0))), RejectCode.LIMIT_QDD, 616),
    (traj(knots=changed(K, 4, q=(1, 2.0))), RejectCode.LIMIT_Q, 896),
    (traj(knots=changed(K, 4, q=(1, -1e300))), RejectCode.LIMIT_Q, 896),
    (traj(knots=changed(K, 1, t_ns=5 * MS - 1)), RejectCode.KNOT_SPACING, 280),
    (traj(knots=changed(K, 1, t_ns=200 * MS + 1)), RejectCode.KNOT_SPACING, 280),
    (traj(knots=changed(K, 2, t_ns=K[1].t_ns - 1)), RejectCode.KNOT_SPACING, 480),
    (traj(knots=changed(K, 5, t_ns=2**64 - 1)), RejectCode.KNOT_SPACING, 1080),
    (traj(knots=changed(K, 1, q=(3, Q3 + 0.05))), RejectCode.IMPLIED_SPEED, 312),
    (traj(knots=changed(K, 1, q=(0, K[1].q[0] + 5e-3))), RejectCode.CONTINUITY, 288),
    (traj(cmd_flags=END), RejectCode.END_NOT_AT_REST, 1152),
    (traj(knots=changed(FLAT[:6], 5, qdd=(4, 1e-4)), cmd_flags=END), RejectCode.END_NOT_AT_REST, 1248),
]
MORE_REFUSED = [
    (traj(first=13, knots=KNOTS[13:19]), RejectCode.KNOT_GAP, 60),
    (traj(first=2**32 - 1, knots=KNOTS[13:19]), RejectCode.KNOT_GAP, 60),
    (traj(first=12, knots=()), RejectCode.VALUE, 64),
    (traj(first=6, knots=changed(KNOTS[6:12], 2, q=(5, 0.0))), RejectCode.KNOT_CHANGED, 480),
    (traj(first=6, knots=changed(KNOTS[6:12], 5, t_ns=1)), RejectCode.KNOT_CHANGED, 1080),
    (traj(first=0, knots=changed(K, 1, qdd=(0, 0.1)), cmd_flags=TAIL), RejectCode.KNOT_CHANGED, 280),
    (traj(first=6, knots=changed(KNOTS[6:12], 2, t_ns=99 * MS), cmd_flags=TAIL), RejectCode.KNOT_CHANGED, 480),
    (traj(first=6, knots=changed(KNOTS[6:12], 2, qd=(0, 3.0)), cmd_flags=TAIL), RejectCode.LIMIT_QD, 552),
    (traj(first=6, knots=KNOTS[6:10], cmd_flags=END), RejectCode.KNOT_CHANGED, 680),
    (traj(first=12, knots=changed(KNOTS[12:18], 0, q=(0, KNOTS[12].q[0] + 5e-3))), RejectCode.CONTINUITY, 88),
    (traj(first=11, knots=KNOTS[11:17], cmd_flags=END), RejectCode.END_NOT_AT_REST, 1152),
]


@pytest.mark.parametrize(("command", "code", "offset"), NEW_REFUSED)
def test_a_new_trajectory_is_refused_with_the_field(command: Command, code: RejectCode, offset: int) -> None:
    pair = pair_at()
    refused(pair, command, code, offset)
    assert pair.motion is Motion.HOLD


@pytest.mark.parametrize(("command", "code", "offset"), MORE_REFUSED)
def test_knots_to_a_running_trajectory_are_refused_with_the_field(
    command: Command, code: RejectCode, offset: int
) -> None:
    pair = pair_at()
    load_all(pair, KNOTS[:12])
    refused(pair, command, code, offset)
    assert pair.ring.last == 11


def test_servo_targets_are_refused_with_the_field() -> None:
    pair, target = pair_at(), servo(Q_START)
    near_end = SETTINGS.q_max - 1e-3
    refused(pair, replace(target, interp=Interp.QUINTIC), RejectCode.INTERP, 65)
    refused(pair, replace(target, knots=target.knots * 2), RejectCode.VALUE, 64)
    refused(pair, replace(target, knots=()), RejectCode.VALUE, 64)
    refused(pair, replace(target, knots=changed(target.knots, 0, qdd=(7, 1.0))), RejectCode.AXIS_MASK, 272)
    refused(pair, replace(target, knots=changed(target.knots, 0, qd=(1, -1.0))), RejectCode.LIMIT_QD, 160)
    refused(
        pair, replace(target, knots=changed(target.knots, 0, q=(5, Q_START[5] + 0.4))), RejectCode.IMPLIED_SPEED, 128
    )
    pair.hold(near_end)
    refused(pair, servo(near_end + 2e-3 * np.eye(6)[4]), RejectCode.LIMIT_Q, 120)
    assert pair.motion is Motion.HOLD


def test_the_ring_refuses_what_it_has_no_room_for_and_wraps_around() -> None:
    pair = pair_at()
    load_all(pair, FLAT[:60])
    assert pair.deliver(traj(58, FLAT[58:64])) is RejectCode.NONE
    refused(pair, traj(60, FLAT[60:66]), RejectCode.RING_FULL, 60)
    for _ in range(25):  # a quarter of a second: five segments
        pair.cycle()
    assert pair.deliver(traj(62, FLAT[62:68])) is RejectCode.NONE
    refused(pair, traj(64, FLAT[64:70]), RejectCode.RING_FULL, 60)
    refused(pair, traj(64, changed(FLAT[64:68], 1, q=(0, 0.0))), RejectCode.KNOT_CHANGED, 280)
    assert pair.deliver(traj(0, changed(FLAT[:3], 1, q=(0, 0.0)))) is RejectCode.NONE  # played: not held any more
    assert pair.ring.last == 67


def test_the_end_neither_moves_nor_vanishes() -> None:
    pair = pair_at()
    load_all(pair, FLAT[:9], BEGIN | END)
    refused(pair, traj(5, FLAT[5:9]), RejectCode.KNOT_CHANGED, 680)
    refused(pair, traj(5, FLAT[5:11], cmd_flags=END), RejectCode.KNOT_CHANGED, 1080)
    refused(pair, traj(3, FLAT[3:7], cmd_flags=END), RejectCode.KNOT_CHANGED, 680)
    assert pair.deliver(traj(5, FLAT[5:9], cmd_flags=END)) is RejectCode.NONE


def test_the_end_may_be_told_late_but_not_before_the_last_knot() -> None:
    pair = pair_at()
    load_all(pair, FLAT[:12])
    refused(pair, traj(6, FLAT[6:11], cmd_flags=END), RejectCode.KNOT_CHANGED, 880)
    assert pair.deliver(traj(6, FLAT[6:12], cmd_flags=END)) is RejectCode.NONE
    assert pair.ring.complete


def test_two_knots_are_a_trajectory() -> None:
    pair = pair_at()
    assert pair.deliver(traj(0, FLAT[:2], cmd_flags=BEGIN | END)) is RejectCode.NONE
    assert run_out(pair) == 5


def test_the_frozen_horizon_is_exact() -> None:
    pair = pair_at()
    load_all(pair, FLAT[:12])
    other = traj(6, changed(FLAT[6:12], 0, qdd=(0, 1e-7)), cmd_flags=TAIL)
    for _ in range(20):
        pair.cycle()
    payload = encode_command(other)
    assert pair.reference.t_play_ns == FLAT[6].t_ns - 100 * MS
    assert pair.st.check(payload, False) == (RejectCode.NONE, 0)
    early = replace(other, knots=changed(other.knots, 0, t_ns=FLAT[6].t_ns - 1))
    refused(pair, early, RejectCode.KNOT_CHANGED, 80)
    pair.cycle()
    refused(pair, other, RejectCode.KNOT_CHANGED, 80)


@pytest.mark.parametrize("j", [0, 3, 5])
def test_limits_are_the_same_to_the_last_bit(j: int) -> None:
    pair, axis = pair_at(), SETTINGS.limit_table.axes[j]
    rounding, numbers = 1.0 + 1e-9, itertools.count(1)
    for top, field in ((axis.qd_max * rounding, "qd"), (axis.qdd_max * rounding, "qdd"), (axis.q_max + 1e-9, "q")):
        for value, inside in ((top, True), (np.nextafter(top, 9.0), False)):
            knots = changed(FLAT[:6], 3, **{field: (j, float(value))})
            command = traj(knots=knots, traj_id=next(numbers), cmd_flags=CommandFlag(0))
            limits = (RejectCode.LIMIT_QD, RejectCode.LIMIT_QDD, RejectCode.LIMIT_Q)
            assert (pair.deliver(command) in limits) is not inside
    room = 0.25 * axis.qd_max**2 / (2.0 * axis.qdd_max * 1.1)  # to stop from half the speed
    for beyond in (-1e-9, 0.5e-9, 0.999e-9, 1.001e-9, 2e-9):
        near = changed(FLAT[:6], 3, q=(j, axis.q_min + room - beyond), qd=(j, -0.5 * axis.qd_max))
        command = traj(knots=near, traj_id=next(numbers), cmd_flags=CommandFlag(0))
        assert (pair.deliver(command) is RejectCode.LIMIT_Q) is (beyond > 1e-9)


def test_peaks_between_knots_have_the_same_bits() -> None:
    program, rng = program_of(CYCLE_S), np.random.default_rng(6)
    checks, a, b = program.new("FB_HmKnotChecks"), program.new_struct("ST_HmKnot"), program.new_struct("ST_HmKnot")
    for i in range(600):
        t_ns = int(rng.integers(5 * MS, 200 * MS))
        T, (q, qd, qdd) = t_ns * 1e-9, rng.normal(size=3)
        # r: what the acceleration adds to that at the start: at the end, on average, and on average twice over
        r = rng.normal(size=3) * rng.choice([0.0, 1e-9, 1.0], 3, p=[0.1, 0.1, 0.8])
        end = (q + qd * T + (r[2] + 0.5 * qdd) * T * T, qd + (r[1] + qdd) * T, qdd + r[0])
        first = Knot(
            0, pad_to_eight_axes((float(q),)), pad_to_eight_axes((float(qd),)), pad_to_eight_axes((float(qdd),))
        )
        second = Knot(
            t_ns,
            pad_to_eight_axes((float(end[0]),)),
            pad_to_eight_axes((float(end[1]),)),
            pad_to_eight_axes((float(end[2]),)),
        )
        for made, knot in ((a, first), (b, second)):
            made.q[0], made.qd[0], made.qdd[0] = knot.q[0], knot.qd[0], knot.qdd[0]
        checks.method("FindPeaks", a, b, j=0, fSpan=T)
        assert bits((checks.fPeakQd, checks.fPeakQdd)) == bits(segment_peaks(first, second, 0)), i


def test_the_segment_being_played_and_its_end_are_frozen_however_long_they_are() -> None:
    slow = tuple(replace(START, t_ns=i * 200 * MS) for i in range(6))
    pair = pair_at()
    load_all(pair, slow)
    refused(pair, traj(1, changed(slow[1:], 0, qdd=(0, 1e-7)), cmd_flags=TAIL), RejectCode.KNOT_CHANGED, 80)
    assert pair.deliver(traj(2, changed(slow[2:], 0, qdd=(0, 1e-7)), cmd_flags=TAIL)) is RejectCode.NONE


def test_minus_zero_sent_again_is_the_same_knot() -> None:
    pair = pair_at()
    load_all(pair, FLAT[:12])
    assert pair.deliver(traj(6, changed(FLAT[6:12], 2, qd=(1, -0.0), qdd=(7, -0.0)))) is RejectCode.NONE
