"""What the PLC's ring takes and what it refuses, with the code."""

from dataclasses import replace

import numpy as np
import pytest
from virtual_plc import MS, Q_START, TABLE, quintic_knots

from protocol.codes import CommandFlag, Interp, Mode, RejectCode
from protocol.messages import Command, Knot, pad_to_eight_axes
from protocol.timeouts import KNOT_RING_CAPACITY
from sim_plc.plc.knot_ring import KnotRing, PlaybackView
from sim_plc.plc.path import RING_SIZE_KNOTS

Q_END = tuple((np.array(Q_START) + np.deg2rad([6.0, -4.0, 5.0, 8.0, -6.0, 9.0])).tolist())
KNOTS = quintic_knots(Q_START, Q_END, 6.0)
AT_START = PlaybackView(pad_to_eight_axes(Q_START))
FLAT = tuple(Knot(i * 50 * MS, pad_to_eight_axes(Q_START)) for i in range(400))


def code_of(objection):
    return RejectCode.NONE if objection is None else objection.code


def command(**fields):
    values = {"session": 7, "seq": 1, "t_send_ns": 0, "mode": Mode.TRAJECTORY, "interp": Interp.QUINTIC, "traj_id": 1}
    return Command(**(values | fields))


def with_axis(values, axis, value):
    return pad_to_eight_axes(tuple(value if i == axis else v for i, v in enumerate(values[:6])))


def changed(index, **fields):
    return tuple(replace(knot, **fields) if i == index else knot for i, knot in enumerate(KNOTS[:6]))


def loaded(count=6):
    ring = KnotRing(TABLE)
    for first in range(0, count, 6):
        ring.load_knots(command(knot_first=first, knots=KNOTS[first : min(first + 6, count)]), AT_START)
    return ring


@pytest.mark.parametrize(
    ("knots", "code"),
    [
        (KNOTS[:6], RejectCode.NONE),
        (KNOTS[:2], RejectCode.NONE),
        (KNOTS[:1], RejectCode.VALUE),
        ((), RejectCode.VALUE),
        (changed(0, q=with_axis(KNOTS[0].q, 0, KNOTS[0].q[0] + 2e-5)), RejectCode.START),
        (changed(0, q=with_axis(KNOTS[0].q, 5, KNOTS[0].q[5] - 2e-5)), RejectCode.START),
        (changed(0, qd=with_axis(KNOTS[0].qd, 2, 0.01)), RejectCode.START),
        (changed(0, qdd=with_axis(KNOTS[0].qdd, 2, 0.01)), RejectCode.START),
        (changed(0, t_ns=1), RejectCode.START),
        (changed(3, q=with_axis(KNOTS[3].q, 1, 5.0)), RejectCode.LIMIT_Q),
        (changed(3, qd=with_axis(KNOTS[3].qd, 1, 5.0)), RejectCode.LIMIT_QD),
        (changed(3, qdd=with_axis(KNOTS[3].qdd, 1, -50.0)), RejectCode.LIMIT_QDD),
        (changed(3, q=with_axis(KNOTS[3].q, 1, KNOTS[3].q[1] + 0.1)), RejectCode.IMPLIED_SPEED),
        (changed(3, q=with_axis(KNOTS[3].q, 1, KNOTS[3].q[1] + 0.01)), RejectCode.CONTINUITY),
        (changed(3, qd=with_axis(KNOTS[3].qd, 1, 0.1)), RejectCode.CONTINUITY),
        (changed(3, t_ns=KNOTS[2].t_ns + 4 * MS), RejectCode.KNOT_SPACING),
        (changed(3, t_ns=KNOTS[2].t_ns), RejectCode.KNOT_SPACING),
        (changed(5, t_ns=KNOTS[4].t_ns + 201 * MS), RejectCode.KNOT_SPACING),
        (changed(3, q=(*KNOTS[3].q[:6], 0.1, 0.0)), RejectCode.AXIS_MASK),
    ],
)
def test_first_knots_are_refused_with_their_code(knots, code):
    ring = KnotRing(TABLE)
    assert code_of(ring.check(command(knots=knots), AT_START)) is code
    assert ring.last == -1  # a check changes nothing


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_limits_of_every_axis_hold_on_both_sides(axis, sign):
    limits = TABLE.axes[axis]
    edge = limits.q_max if sign > 0 else limits.q_min
    for q, code in ((edge - sign * 1e-6, RejectCode.NONE), (edge + sign * 1e-6, RejectCode.LIMIT_Q)):
        start = pad_to_eight_axes(with_axis(Q_START, axis, q)[:6])
        knots = tuple(Knot(i * 50 * MS, start) for i in range(3))
        assert code_of(KnotRing(TABLE).check(command(knots=knots), PlaybackView(start))) is code


def test_a_knot_too_fast_to_stop_inside_the_range_is_refused():
    limits = TABLE.axes[0]
    qd = limits.qd_max
    room = qd * qd / (2 * limits.qdd_max)
    for q, code in ((limits.q_max - room, RejectCode.NONE), (limits.q_max - 0.7 * room, RejectCode.LIMIT_Q)):
        ring = loaded(2)  # beyond the start, where a knot may move
        ring.load_knots(command(traj_id=2, knots=KNOTS[:2]), AT_START)
        before = Knot(0, pad_to_eight_axes((q - qd * 0.1, *Q_START[1:])), pad_to_eight_axes((qd,)))
        ring._kept[1], ring.times[1] = before, 0.0
        knot = Knot(100 * MS, pad_to_eight_axes((q, *Q_START[1:])), pad_to_eight_axes((qd,)))
        assert code_of(ring.check(command(traj_id=2, knot_first=2, knots=(knot,)), AT_START)) is code


def test_resent_knots_must_be_identical_and_without_a_gap():
    ring = loaded(6)
    assert code_of(ring.check(command(knot_first=3, knots=KNOTS[3:9]), AT_START)) is RejectCode.NONE
    assert code_of(ring.check(command(knot_first=7, knots=KNOTS[7:12]), AT_START)) is RejectCode.KNOT_GAP
    other = (replace(KNOTS[4], q=with_axis(KNOTS[4].q, 0, KNOTS[4].q[0] + 1e-15)),)
    assert code_of(ring.check(command(knot_first=4, knots=other), AT_START)) is RejectCode.KNOT_CHANGED
    ring.load_knots(command(knot_first=3, knots=KNOTS[3:9]), AT_START)
    assert ring.last == 8
    ring.load_knots(command(knot_first=3, knots=KNOTS[3:9]), AT_START)
    assert ring.last == 8
    moving = command(knot_first=8, knots=KNOTS[8:12], cmd_flags=CommandFlag.LAST_IS_END)
    assert code_of(ring.check(moving, AT_START)) is RejectCode.END_NOT_AT_REST


def test_the_ring_holds_64_knots_and_no_more():
    ring = KnotRing(TABLE)
    ring.load_knots(command(knots=FLAT[:6]), AT_START)
    for first in range(6, 60, 6):
        ring.load_knots(command(knot_first=first, knots=FLAT[first : first + 6]), AT_START)
    assert code_of(ring.check(command(knot_first=60, knots=FLAT[60:64]), AT_START)) is RejectCode.NONE
    assert code_of(ring.check(command(knot_first=60, knots=FLAT[60:65]), AT_START)) is RejectCode.RING_FULL
    later = PlaybackView(pad_to_eight_axes(Q_START), knot_playing=1, t_play_ns=60 * MS)
    assert code_of(ring.check(command(knot_first=60, knots=FLAT[60:65]), later)) is RejectCode.NONE
    ring.load_knots(command(knot_first=60, knots=FLAT[60:65]), later)
    assert ring.last == 64
    assert ring.knot(0) is None  # its slot is taken
    assert ring.knot(1) == FLAT[1]
    assert RING_SIZE_KNOTS == KNOT_RING_CAPACITY == 64


def test_a_long_trajectory_passes_through_the_ring():
    ring = KnotRing(TABLE)
    for first in range(0, 394):
        view = PlaybackView(
            pad_to_eight_axes(Q_START), knot_playing=max(first - 2, 0), t_play_ns=max(first - 2, 0) * 50 * MS
        )
        sent = command(knot_first=first, knots=FLAT[first : first + 6])
        assert code_of(ring.check(sent, view)) is RejectCode.NONE
        ring.load_knots(sent, view)
        assert ring.last == first + 5
        assert ring.times[ring.last % RING_SIZE_KNOTS] == pytest.approx(FLAT[first + 5].t_ns * 1e-9)


def test_nothing_comes_after_the_end_and_the_end_does_not_move():
    ring = KnotRing(TABLE)
    ring.load_knots(command(knots=FLAT[:6], cmd_flags=CommandFlag.LAST_IS_END), AT_START)
    assert ring.complete
    assert code_of(ring.check(command(knot_first=4, knots=FLAT[4:8]), AT_START)) is RejectCode.KNOT_CHANGED
    assert code_of(ring.check(command(knot_first=2, knots=FLAT[2:6]), AT_START)) is RejectCode.KNOT_CHANGED  # flag gone
    same = command(knot_first=2, knots=FLAT[2:6], cmd_flags=CommandFlag.LAST_IS_END)
    assert code_of(ring.check(same, AT_START)) is RejectCode.NONE
    assert code_of(ring.check(command(knot_first=0, knots=FLAT[:3]), AT_START)) is RejectCode.NONE


def test_only_a_tail_beyond_the_frozen_horizon_is_replaced():
    ring = loaded(12)
    q_other = (np.array(KNOTS[9].q) + 1e-4 * np.array([1, 0, 0, 0, 0, 0, 0, 0])).tolist()
    tail = (KNOTS[8], replace(KNOTS[9], q=tuple(q_other)), KNOTS[10])
    plain = command(knot_first=8, knots=tail)
    flagged = command(knot_first=8, knots=tail, cmd_flags=CommandFlag.TAIL_REPLACES)
    near = PlaybackView(pad_to_eight_axes(Q_START), knot_playing=7, t_play_ns=KNOTS[9].t_ns - 99 * MS)
    far = PlaybackView(pad_to_eight_axes(Q_START), knot_playing=7, t_play_ns=KNOTS[9].t_ns - 100 * MS)
    assert code_of(ring.check(plain, far)) is RejectCode.KNOT_CHANGED
    assert code_of(ring.check(flagged, near)) is RejectCode.KNOT_CHANGED
    assert code_of(ring.check(flagged, far)) is RejectCode.NONE
    ring.load_knots(flagged, far)
    assert ring.last == 10  # what came after the replaced knot belonged to the old tail
    assert ring.knot(9) == tail[1]
    assert ring.knot(8) == KNOTS[8]


def test_a_replaced_tail_must_join_smoothly():
    ring = loaded(12)
    far = PlaybackView(pad_to_eight_axes(Q_START), knot_playing=2, t_play_ns=KNOTS[2].t_ns)
    broken = replace(KNOTS[9], q=with_axis(KNOTS[9].q, 0, KNOTS[9].q[0] + 0.01))
    sent = command(knot_first=8, knots=(KNOTS[8], broken), cmd_flags=CommandFlag.TAIL_REPLACES)
    assert code_of(ring.check(sent, far)) is RejectCode.CONTINUITY


def test_a_cleared_ring_takes_the_same_number_as_new():
    ring = loaded(12)
    ring.clear()
    assert ring.traj_id == 0
    assert code_of(ring.check(command(knot_first=6, knots=KNOTS[6:9]), AT_START)) is RejectCode.KNOT_GAP
    assert code_of(ring.check(command(knots=KNOTS[:6]), AT_START)) is RejectCode.NONE
