"""The rules on knots and servo targets, judged with mathematics of its own: quintics by their control points."""

import math
from collections.abc import Iterator, Sequence

from benchmarks.link.fuzz.oracle_fields import KnotFields
from benchmarks.link.fuzz.verdict import Breach
from protocol.codes import RejectCode
from protocol.limits import AxisLimits, LimitTable

_REST = 1e-6  # rad/s, rad/s^2: "at rest"
_DIRECT = 2e-9  # relative, and absolute for positions: a number that stands in the datagram
_DERIVED = 1e-6  # relative: a number that both sides compute in their own way
_REACH_S = 0.25
_AT_Q, _AT_QD, _AT_QDD = 8, 72, 136


def _grade(value: float, limit: float, slack: float, code: RejectCode, offset: int) -> Iterator[Breach]:
    """A breach if |value| passes the limit; sure if by more than the slack. What is no number is a breach."""
    if not abs(value) <= limit - slack:
        yield Breach(code, offset, sure=not abs(value) <= limit + slack)


def place(k: int, part: int = 0, axis: int = 0) -> int:
    """The byte of the k-th knot's number in its command."""
    return 80 + 200 * k + part + 8 * axis


def unused_axes(knot: KnotFields, k: int, n: int) -> Iterator[Breach]:
    """Axes that the machine does not have must be zero."""
    for part, values in ((_AT_Q, knot[1]), (_AT_QD, knot[2]), (_AT_QDD, knot[3])):
        for j in range(n, 8):
            if values[j] != 0.0:
                yield Breach(RejectCode.AXIS_MASK, place(k, part, j))


def one_knot(knot: KnotFields, k: int, table: LimitTable, between: float) -> Iterator[Breach]:
    """Speed, acceleration, range with room to stop; `between`: how much harder than qdd_max the stop may be."""
    yield from unused_axes(knot, k, len(table.axes))
    for j, axis in enumerate(table.axes):
        q, qd, qdd = knot[1][j], knot[2][j], knot[3][j]
        yield from _grade(qd, axis.qd_max, _DIRECT * axis.qd_max, RejectCode.LIMIT_QD, place(k, _AT_QD, j))
        yield from _grade(qdd, axis.qdd_max, _DIRECT * axis.qdd_max, RejectCode.LIMIT_QDD, place(k, _AT_QDD, j))
        yield from _in_range(q, axis, _DIRECT, place(k, _AT_Q, j))
        if between > 0.0:
            rest = q + qd * abs(qd) / (2.0 * between * axis.qdd_max)
            yield from _in_range(rest, axis, 5.0 * _DIRECT, place(k, _AT_Q, j))


def _in_range(q: float, axis: AxisLimits, slack: float, offset: int) -> Iterator[Breach]:
    middle, half = 0.5 * (axis.q_min + axis.q_max), 0.5 * (axis.q_max - axis.q_min)
    yield from _grade(q - middle, half, slack, RejectCode.LIMIT_Q, offset)


def step(a: KnotFields, b: KnotFields, k: int, table: LimitTable, between: float) -> Iterator[Breach]:
    """Two neighbours, b the command's k-th: spacing, implied speed, the quintic between them."""
    dt_ns = b[0] - a[0]
    if not 5_000_000 <= dt_ns <= 200_000_000:
        yield Breach(RejectCode.KNOT_SPACING, place(k))
        return
    dt_s = dt_ns / 1e9
    for j, axis in enumerate(table.axes):
        mean = (b[1][j] - a[1][j]) / dt_s
        yield from _grade(mean, axis.qd_max, _DERIVED * axis.qd_max, RejectCode.IMPLIED_SPEED, place(k, _AT_Q, j))
        qd, qdd = peaks(a, b, j, dt_s)
        for value, limit in ((qd, between * axis.qd_max), (qdd, between * axis.qdd_max)):
            yield from _grade(value, limit, _DERIVED * limit, RejectCode.CONTINUITY, place(k, _AT_Q, j))


def peaks(a: KnotFields, b: KnotFields, j: int, dt_s: float) -> tuple[float, float]:
    """Largest |qd| of axis j at seven points inside the segment, and largest |qdd| anywhere inside.

    Model: control points of the quintic Bezier that meets q, qd, qdd at both ends; its derivatives are Bezier curves
    of the scaled differences. Source: Farin, Curves and Surfaces for CAGD, section 5.3.
    """
    q0, v0, a0 = a[1][j], a[2][j] * dt_s, a[3][j] * dt_s * dt_s
    q1, v1, a1 = b[1][j], b[2][j] * dt_s, b[3][j] * dt_s * dt_s
    # relative to q0, so that no digits are lost in the differences
    p = (0.0, v0 / 5.0, 0.4 * v0 + 0.05 * a0, (q1 - q0) - 0.4 * v1 + 0.05 * a1, (q1 - q0) - v1 / 5.0, q1 - q0)
    first = [5.0 * (p[i + 1] - p[i]) for i in range(5)]
    second = [4.0 * (first[i + 1] - first[i]) for i in range(4)]
    qd = max(abs(_bezier(first, i / 8.0)) for i in range(1, 8)) / dt_s
    qdd = max([abs(_bezier(second, x)) for x in _extremes(second)], default=0.0) / (dt_s * dt_s)
    return qd, qdd


def _extremes(cubic: Sequence[float]) -> list[float]:
    """Where a cubic Bezier function turns round inside 0..1: roots of its derivative in Bernstein's form."""
    d0, d1, d2 = (cubic[i + 1] - cubic[i] for i in range(3))
    curve, middle = d0 - 2.0 * d1 + d2, d0 - d1
    square = d1 * d1 - d0 * d2
    if not square >= 0.0:
        return []
    if abs(curve) <= 1e-12 * (abs(d0) + abs(d1) + abs(d2)):
        roots = [0.5 * d0 / middle] if middle else []
    else:
        roots = [(middle + sign * math.sqrt(square)) / curve for sign in (-1.0, 1.0)]
    return [x for x in roots if 0.0 < x < 1.0]


def _bezier(points: Sequence[float], x: float) -> float:
    """De Casteljau."""
    while len(points) > 1:
        points = [(1.0 - x) * points[i] + x * points[i + 1] for i in range(len(points) - 1)]
    return points[0]


def start(knot: KnotFields, q_ref: Sequence[float], tolerance: float) -> Iterator[Breach]:
    """A trajectory begins at time zero, at the reference, at rest."""
    if knot[0] != 0:
        yield Breach(RejectCode.START, place(0))
    for j in range(8):
        yield from _grade(knot[1][j] - q_ref[j], tolerance, 1e-12, RejectCode.START, place(0, _AT_Q, j))
    yield from at_rest(knot, 0, RejectCode.START)


def at_rest(knot: KnotFields, k: int, code: RejectCode) -> Iterator[Breach]:
    """No speed and no acceleration."""
    for part, values in ((_AT_QD, knot[2]), (_AT_QDD, knot[3])):
        for j in range(8):
            yield from _grade(values[j], _REST, 1e-15, code, place(k, part, j))


def servo_target(knot: KnotFields, q_ref: Sequence[float], table: LimitTable) -> Iterator[Breach]:
    """In range, not too fast, within 0.25 s of full speed of the reference."""
    yield from unused_axes(knot, 0, len(table.axes))
    for j, axis in enumerate(table.axes):
        q, qd = knot[1][j], knot[2][j]
        yield from _grade(qd, axis.qd_max, _DIRECT * axis.qd_max, RejectCode.LIMIT_QD, place(0, _AT_QD, j))
        yield from _in_range(q, axis, _DIRECT, place(0, _AT_Q, j))
        reach = _REACH_S * axis.qd_max
        yield from _grade(q - q_ref[j], reach, _DIRECT, RejectCode.IMPLIED_SPEED, place(0, _AT_Q, j))
