"""Every limit of the motion gate swept past both sides, with the exact refusal that it gives."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import pytest
from gate_probe_modes import envelope_probes, mode_probes, trust_probes
from gate_probe_quintics import any_quintic_probes, quintic_probes
from gate_probes import (
    AXES,
    HOLDING,
    LIFT,
    MS,
    PASSED,
    REST,
    ROUNDING,
    RUNNING,
    SLEW,
    START,
    STOPPED,
    TABLE,
    Answer,
    Probe,
    R,
    asked,
    at,
    holds,
    implied,
    knot_count,
    limit_q,
    limit_qd,
    limit_qdd,
    listed,
    moving_at,
    off_start,
    out_of_reach,
    passes,
    past,
    peak,
    refused,
    servo,
    spacing,
    speeding,
    trajectory,
    unused,
)

from protocol import gate as the_gate
from protocol.codes import CommandFlag, RejectCode
from protocol.limits import AxisLimits, LimitTable
from protocol.messages import ZEROS, Axes, Command, Knot

# --- one knot ---------------------------------------------------------------------------------------------------------


def resting_at(axis: int, q: float, times_ms: Sequence[int] = (100, 150)) -> tuple[Command, dict[str, Any]]:
    """Knots at rest at one place, with the knot before them there too."""
    knots = tuple(Knot(t * MS, at(axis, q)) for t in times_ms)
    return trajectory(knots), RUNNING | {"knot_before": Knot(50 * MS, at(axis, q))}


def range_probes() -> Iterator[Probe]:
    """Position, on every axis, at both ends of its range: trajectory and servo."""
    for j, axis in AXES:
        for limit, outwards in ((axis.q_min, -1.0), (axis.q_max, 1.0)):
            edge = limit + outwards * ROUNDING
            for value in (0.98 * limit, limit, edge, past(edge, -outwards)):
                yield passes(f"{axis.name} at {value}", *resting_at(j, value))
                yield passes(f"{axis.name} target {value}", servo(at(j, value)), RUNNING | {"q_ref": at(j, value)})
            for value in (past(edge, outwards * math.inf), limit * 1.001, limit * 1.03):
                command, view = resting_at(j, value)
                wrong = [limit_q(axis, t, value, limit) for t in (100, 150)]
                yield refused(f"{axis.name} at {value}", command, view, *wrong)
                view = RUNNING | {"q_ref": at(j, value)}
                yield refused(f"{axis.name} target {value}", servo(at(j, value)), view, limit_q(axis, 0, value, limit))


def speed_probes() -> Iterator[Probe]:
    """Speed and acceleration, on every axis, both ways."""
    for j, axis in AXES:
        for sign in (1.0, -1.0):
            top, hard = sign * axis.qd_max, sign * 0.5 * axis.qdd_max
            edge = top * (1.0 + ROUNDING)
            for value in (0.98 * top, top, edge):
                yield passes(f"{axis.name} qd {value}", *speeding(j, value, hard))
                yield passes(f"{axis.name} servo qd {value}", servo(qd=at(j, value)))
            for value in (past(edge, sign * math.inf), top * 1.002):
                yield refused(f"{axis.name} qd {value}", *speeding(j, value, hard), limit_qd(axis, 55, value))
                yield refused(f"{axis.name} servo {value}", servo(qd=at(j, value)), RUNNING, limit_qd(axis, 0, value))
            top = sign * axis.qdd_max
            edge = top * (1.0 + ROUNDING)
            for value in (0.98 * top, top, edge):
                yield passes(f"{axis.name} qdd {value}", *speeding(j, 0.0, value))
            for value in (past(edge, sign * math.inf), top * 1.002):
                yield refused(f"{axis.name} qdd {value}", *speeding(j, 0.0, value), limit_qdd(axis, 55, value))


def not_a_number_probes() -> Iterator[Probe]:
    """NaN passes no check: here only the codes count, for NaN spreads to many."""
    for field in ("q", "qd", "qdd"):
        for j in range(8):
            knots = (REST[0], replace(REST[1], **{field: at(j, math.nan)}), REST[2])
            ask = asked(trajectory(knots), RUNNING)
            code = R.AXIS_MASK if j > 1 else {"q": R.LIMIT_Q, "qd": R.LIMIT_QD, "qdd": R.LIMIT_QDD}[field]
            yield Probe(f"NaN in {field}[{j}]", ask, ((code,),), codes_only=True)
    view = HOLDING | {"q_ref": at(1, math.nan)}
    yield refused("NaN in q_ref", trajectory(START, 0), view, off_start(LIFT, math.nan))
    yield refused("NaN in q_ref, servo", servo(), view, out_of_reach(LIFT, math.nan))


def unused_axis_probes() -> Iterator[Probe]:
    """Axes that the machine does not have: any value but zero."""
    for j in range(2, 8):
        for field in ("q", "qd", "qdd"):
            for value in (5e-324, -1.0):
                knots = (REST[0], replace(REST[1], **{field: at(j, value)}), REST[2])
                wrong = unused(j, value if field == "q" else 0.0)
                yield refused(f"{field}[{j}] = {value}", trajectory(knots), RUNNING, wrong)
        yield refused(f"servo q[{j}]", servo(at(j, 1e-9)), RUNNING, unused(j, 1e-9))
        yield passes(f"-0.0 in q[{j}]", trajectory((replace(REST[0], q=at(j, -0.0)),)))


# --- between knots ----------------------------------------------------------------------------------------------------


def spacing_probes() -> Iterator[Probe]:
    """Times between knots, before the first and inside."""
    before = Knot(50 * MS)
    for dt_ns in (5 * MS, 5 * MS + 1, 50 * MS, 200 * MS):
        yield passes(f"{dt_ns} ns after the knot before", trajectory((Knot(50 * MS + dt_ns),)))
        yield passes(f"{dt_ns} ns inside", trajectory((REST[0], Knot(100 * MS + dt_ns))))
    for dt_ns, limit_ms in ((5 * MS - 1, 5.0), (0, 5.0), (-50 * MS, 5.0), (200 * MS + 1, 200.0), (10**12, 200.0)):
        command = trajectory((Knot(before.t_ns + dt_ns),))
        b_ms = round((before.t_ns + dt_ns) / MS)
        yield refused(f"{dt_ns} ns after the knot before", command, RUNNING, spacing(b_ms, dt_ns, limit_ms))
        command = trajectory((REST[0], Knot(REST[0].t_ns + dt_ns)))
        yield refused(f"{dt_ns} ns inside", command, RUNNING, spacing(b_ms + 50, dt_ns, limit_ms))


def other_table_probes() -> Iterator[Probe]:
    """The numbers come from the table: other spacings, a range that begins above zero, a joint slower than any."""
    narrow = LimitTable(TABLE.axes, spacing_min_ns=40 * MS, spacing_max_ns=40_500_000)
    for dt_ns, limit_ms in ((39_999_999, 40.0), (40_500_001, 40.5), (40_700_000, 40.5), (5 * MS, 40.0)):
        told = round((50 * MS + dt_ns) / MS)
        ask = asked(trajectory((Knot(50 * MS + dt_ns),)), RUNNING, narrow)
        yield Probe(f"{dt_ns} ns, other table", ask, (spacing(told, dt_ns, limit_ms), STOPPED))
    for dt_ns in (40 * MS, 40_500_000):
        ask = asked(trajectory((Knot(50 * MS + dt_ns),)), RUNNING, narrow)
        yield Probe(f"{dt_ns} ns, other table", ask, PASSED)
    above = AxisLimits("above", 0.5, 1.5, 0.01, 0.01)
    table = LimitTable((above,), start_tolerance_rad=0.125)
    for q, limit in ((0.5, 0.0), (1.5, 0.0), (0.499, 0.5), (1.501, 1.5)):
        knots, before = (Knot(100 * MS, at(0, q)),), Knot(50 * MS, at(0, q))
        ask = asked(trajectory(knots, axis_mask=1), RUNNING | {"knot_before": before}, table)
        answer = (limit_q(above, 100, q, limit), STOPPED) if limit else PASSED
        yield Probe(f"at {q} of 0.5..1.5", ask, answer)
    loose = LimitTable(TABLE.axes, start_tolerance_rad=0.125)
    for step, inside in ((0.125, True), (past(0.125), False)):
        start = trajectory(tuple(replace(knot, q=at(0, step)) for knot in START), 0)
        wrong = (R.START, "slew: first knot minus q_ref", step, 0.125, "rad", "plan from q_ref")
        yield Probe(f"{step} off, other table", asked(start, HOLDING, loose), PASSED if inside else (wrong, STOPPED))


def implied_speed_probes() -> Iterator[Probe]:
    """The mean speed between knots; 125 ms and a start at 0 make it exact in binary."""
    for j, axis in AXES:
        for sign in (1.0, -1.0):
            top = sign * axis.qd_max
            edge = top * (1.0 + ROUNDING)

            def between(mean: float, j: int = j, top: float = top) -> tuple[Command, dict[str, Any]]:
                after = Knot(175 * MS, at(j, mean / 8.0), at(j, top))
                return trajectory((after,)), RUNNING | {"knot_before": Knot(50 * MS, ZEROS, at(j, top))}

            for mean in (top * 0.99, top, edge):
                yield passes(f"{axis.name} mean {mean}", *between(mean))
            for mean in (past(edge, sign * math.inf), top * 1.01):
                yield refused(f"{axis.name} mean {mean}", *between(mean), implied(axis, 50, 175, mean))
    jump = trajectory((REST[0], replace(REST[1], q=at(1, 0.0126))))
    wrong = [implied(LIFT, 100, 150, 0.0126 / 0.05), peak(LIFT, 100, 150, 1.875 * 0.0126 / 0.05, 0.25, "rad/s")]
    yield refused("a jump inside", jump, RUNNING, *wrong)


# --- beginning and end ------------------------------------------------------------------------------------------------


def start_probes() -> Iterator[Probe]:
    """The first knot: at zero, at q_ref, at rest; only before it runs, and only for knot 0."""
    yield passes("start", trajectory(START, 0), HOLDING)
    yield passes("start, while there is another knot before", trajectory(START, 0), HOLDING | {"knot_before": None})
    far = HOLDING | {"knot_before": Knot(0, at(0, 2.0))}
    yield passes("the knot before knot 0 does not count", trajectory(START, 0), far)
    yield passes("knot 0 again while it runs", trajectory(START, 0), RUNNING | {"q_ref": at(0, 1.0)})
    later = tuple(replace(knot, t_ns=knot.t_ns + 1) for knot in START)
    wrong = (R.START, "time of the first knot", 1 / MS, 0, "ms", "begin at 0")
    yield refused("start 1 ns late", trajectory(later, 0), HOLDING, wrong)
    yield passes("knot 1 on may begin at any time", trajectory(later[1:]), HOLDING | {"knot_before": later[0]})
    unknown = (R.KNOT_GAP, "first knot", 7, 0, "", "the knot before it is not known")
    yield refused("no knot before", trajectory(REST, 7), RUNNING | {"knot_before": None}, unknown)
    for j, axis in AXES:
        for sign in (1.0, -1.0):
            for step, inside in ((1e-5, True), (past(1e-5), False), (1.01e-5, False)):
                there = tuple(replace(knot, q=at(j, sign * step)) for knot in START)
                name = f"start {sign * step} off on {axis.name}"
                command = trajectory(there, 0)
                yield (
                    passes(name, command, HOLDING) if inside else refused(name, command, HOLDING, off_start(axis, step))
                )
    yield from rest_probes("first", R.START)


def rest_probes(which: str, code: RejectCode) -> Iterator[Probe]:
    """Rest at the beginning or at the end, up to rounding, on every axis in use."""
    for j, axis in AXES:
        for field, what in (("qd", "speed"), ("qdd", "acceleration")):
            for value in (1e-6, -1e-6):
                command, view, loose = at_edge(which, {field: at(j, value)})
                yield passes(f"{which} {field} {value} on {axis.name}", command, view)
                yield passes(f"{which} {field} {value} in the middle", loose, RUNNING)
            for value in (past(1e-6), -past(1e-6), 1.01e-6):
                command, view, loose = at_edge(which, {field: at(j, value)})
                wrong = moving_at(code, which, what, abs(value))
                yield refused(f"{which} {field} {value} on {axis.name}", command, view, wrong)
                yield passes(f"{which} {field} {value} in the middle", loose, RUNNING)


def at_edge(which: str, change: dict[str, Axes]) -> tuple[Command, dict[str, Any], Command]:
    """A changed first knot of a start, or last knot of an end; and the same knots in the middle of a trajectory."""
    if which == "first":
        knots = (replace(START[0], **change), *START[1:])
        middle = tuple(replace(knot, t_ns=knot.t_ns + 100 * MS) for knot in knots)
        return trajectory(knots, 0), HOLDING, trajectory(middle)
    knots = (*REST[:-1], replace(REST[-1], **change))
    return trajectory(knots, flags=CommandFlag.START | CommandFlag.LAST_IS_END), RUNNING, trajectory(knots)


def end_probes() -> Iterator[Probe]:
    """The end flag asks for rest; the other flags do not."""
    yield passes("end", trajectory(REST, flags=CommandFlag.LAST_IS_END))
    moving = trajectory((*REST[:-1], replace(REST[-1], qd=at(0, 2e-6))), flags=0)
    yield passes("moving, no end", moving)
    yield passes("moving, new tail", replace(moving, cmd_flags=CommandFlag.TAIL_REPLACES | CommandFlag.START))
    wrong = moving_at(R.END_NOT_AT_REST, "last", "speed", 2e-6)
    yield refused("moving end", replace(moving, cmd_flags=CommandFlag.LAST_IS_END), RUNNING, wrong)
    yield from rest_probes("last", R.END_NOT_AT_REST)


def reach_probes() -> Iterator[Probe]:
    """A servo target: at most 0.25 s of full speed from the reference; both numbers are exact in binary."""
    for j, axis in AXES:
        reach = 0.25 * axis.qd_max
        for sign in (1.0, -1.0):
            for step, inside in ((0.98 * reach, True), (reach, True), (past(reach), False), (1.01 * reach, False)):
                name, command = f"{axis.name} target {sign * step} away", servo(at(j, sign * step))
                yield passes(name, command) if inside else refused(name, command, RUNNING, out_of_reach(axis, step))
                back = servo(ZEROS), RUNNING | {"q_ref": at(j, sign * step)}
                yield passes(name, *back) if inside else refused(f"{name}, back", *back, out_of_reach(axis, step))


# --- whole trajectories and tails -------------------------------------------------------------------------------------


def whole_probes() -> Iterator[Probe]:
    """check_trajectory and check_tail: the same rules before anything is sent."""

    def whole(knots: Sequence[Knot], q_ref: Axes = ZEROS) -> Callable[[Any], Answer]:
        return lambda g: listed(g.check_trajectory(knots, q_ref, TABLE))

    def tail(knots: Sequence[Knot], before: Knot = RUNNING["knot_before"]) -> Callable[[Any], Answer]:
        return lambda g: listed(g.check_tail(knots, before, TABLE))

    for n in (0, 1):
        wrong = knot_count(n, 2, remedy="a trajectory needs a start and an end")
        yield Probe(f"whole of {n}", whole(START[:n]), (wrong,))
    yield Probe("whole of 2", whole(START[:2]), ())
    yield Probe("whole of 3", whole(START), ())
    yield Probe("whole from elsewhere", whole(START, at(1, 0.1)), (off_start(LIFT, 0.1),))
    beyond = tuple(replace(knot, q=at(0, 2.6)) for knot in START)
    wrong = tuple(limit_q(SLEW, t, 2.6, 2.5) for t in (0, 50, 100))
    yield Probe("whole out of range", whole(beyond, at(0, 2.6)), wrong)
    moving = (*START[:-1], replace(START[-1], qd=at(0, 2e-6)))
    yield Probe("whole without end", whole(moving), (moving_at(R.END_NOT_AT_REST, "last", "speed", 2e-6),))
    yield Probe("whole too far apart", whole((Knot(0), Knot(201 * MS))), (spacing(201, 201 * MS, 200.0),))
    yield Probe("no tail", tail(()), (knot_count(0, 1, remedy="a tail needs an end"),))
    yield Probe("tail of 1", tail(REST[:1]), ())
    yield Probe("tail", tail(REST), ())
    yield Probe("tail too late", tail(REST, Knot(0)), ())
    yield Probe("tail far away", tail(REST, Knot(-101 * MS)), (spacing(100, 201 * MS, 200.0),))
    yield Probe("tail without end", tail(moving[1:], Knot(0)), (moving_at(R.END_NOT_AT_REST, "last", "speed", 2e-6),))
    shifted = tuple(replace(knot, q=at(0, 2.6)) for knot in REST)
    wrong = tuple(limit_q(SLEW, t, 2.6, 2.5) for t in (100, 150, 200))
    yield Probe("tail out of range", tail(shifted, Knot(50 * MS, at(0, 2.6))), wrong)


GROUPS: dict[str, tuple[Probe, ...]] = {
    group.__name__: tuple(group())
    for group in (
        mode_probes, trust_probes, envelope_probes, range_probes, speed_probes, not_a_number_probes,
        unused_axis_probes, spacing_probes, other_table_probes, implied_speed_probes, quintic_probes,
        any_quintic_probes, start_probes, end_probes, reach_probes, whole_probes,
    )
}  # fmt: skip
PROBES = tuple(probe for group in GROUPS.values() for probe in group)


# --- judging ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("group", GROUPS)
def test_the_gate_gives_the_right_answers(group: str) -> None:
    assert GROUPS[group]
    wrong = [(probe.name, probe.ask(the_gate), probe.answer) for probe in GROUPS[group] if not holds(probe, the_gate)]
    assert wrong == []


def test_there_are_probes_for_every_refusal() -> None:
    refusals = {row[0] for probe in PROBES for row in probe.answer if isinstance(row, tuple) and len(row) == 6}
    expected = {
        R.VALUE, R.ECHO_STALE, R.SESSION, R.MODE_ILLEGAL, R.NONCE, R.INTERP, R.AXIS_MASK, R.OVERRIDE, R.TRAJ_ID,
        R.START, R.KNOT_GAP, R.END_NOT_AT_REST, R.LIMIT_Q, R.LIMIT_QD, R.LIMIT_QDD, R.KNOT_SPACING, R.IMPLIED_SPEED,
        R.CONTINUITY,
    }  # fmt: skip
    assert refusals == expected
