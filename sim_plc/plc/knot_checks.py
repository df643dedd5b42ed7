"""What a knot must keep to before the PLC plays it. Written apart from the PC's motion gate, a little wider than it."""

from collections.abc import Iterable

from protocol.codes import RejectCode
from protocol.limits import LimitTable
from protocol.messages import Axes, Knot

_ROUNDING = 1e-9  # relative
_REST = 1e-6  # rad/s, rad/s^2
_BETWEEN = 1.10  # between knots the quintic may pass the limits by this: the PC holds itself to less
_INSIDE = tuple(i / 8.0 for i in range(1, 8))


def first_of(codes: Iterable[RejectCode]) -> RejectCode:
    """The first code that refuses, or NONE."""
    return next((code for code in codes if code is not RejectCode.NONE), RejectCode.NONE)


def check_knot(knot: Knot, table: LimitTable) -> RejectCode:
    """One knot by itself: unused axes zero, q, qd, qdd inside the limits, room to stop before the range ends."""
    n = len(table.axes)
    if any(knot.q[n:]) or any(knot.qd[n:]) or any(knot.qdd[n:]):
        return RejectCode.AXIS_MASK
    for axis, q, qd, qdd in zip(table.axes, knot.q, knot.qd, knot.qdd, strict=False):
        if not abs(qd) <= axis.qd_max * (1.0 + _ROUNDING):
            return RejectCode.LIMIT_QD
        if not abs(qdd) <= axis.qdd_max * (1.0 + _ROUNDING):
            return RejectCode.LIMIT_QDD
        stop = q + qd * abs(qd) / (2.0 * axis.qdd_max * _BETWEEN)
        if not axis.q_min - _ROUNDING <= min(q, stop) or not max(q, stop) <= axis.q_max + _ROUNDING:
            return RejectCode.LIMIT_Q
    return RejectCode.NONE


def check_step(a: Knot, b: Knot, table: LimitTable) -> RejectCode:
    """Two neighbours: spacing, the speed that their distance implies, and the quintic between them."""
    dt_ns = b.t_ns - a.t_ns
    if not table.spacing_min_ns <= dt_ns <= table.spacing_max_ns:
        return RejectCode.KNOT_SPACING
    dt_s = dt_ns * 1e-9
    for j, axis in enumerate(table.axes):
        if not abs(b.q[j] - a.q[j]) <= axis.qd_max * dt_s * (1.0 + _ROUNDING):
            return RejectCode.IMPLIED_SPEED
        qd, qdd = segment_peaks(a, b, j)
        if not (qd <= axis.qd_max * _BETWEEN and qdd <= axis.qdd_max * _BETWEEN):
            return RejectCode.CONTINUITY
    return RejectCode.NONE


def segment_peaks(a: Knot, b: Knot, j: int) -> tuple[float, float]:
    """Largest |qd| [rad/s] and |qdd| [rad/s2] of axis j at seven points inside the segment from a to b.

    Model:   the acceleration of the quintic is the cubic p(x) = A0 + x (d0 + x (d1 + x d2)) that meets both
             accelerations, and whose first and second integral meet the steps of speed and position.
    """
    T = (b.t_ns - a.t_ns) * 1e-9
    a0, a1 = a.qdd[j], b.qdd[j]
    m1 = (b.qd[j] - a.qd[j]) / T  # integral of p over x
    m2 = (b.q[j] - a.q[j] - a.qd[j] * T) / (T * T)  # double integral of p
    # p = a0 + d0 x + d1 x^2 + d2 x^3: sum at 1, first and second integral at 1
    r0, r1, r2 = a1 - a0, m1 - a0, m2 - 0.5 * a0
    d0 = 3.0 * r0 - 24.0 * r1 + 60.0 * r2
    d1 = -12.0 * r0 + 84.0 * r1 - 180.0 * r2
    d2 = 10.0 * r0 - 60.0 * r1 + 120.0 * r2
    peak_qd = peak_qdd = 0.0
    for x in _INSIDE:
        peak_qdd = max(peak_qdd, abs(a0 + x * (d0 + x * (d1 + x * d2))))
        peak_qd = max(peak_qd, abs(a.qd[j] + T * x * (a0 + x * (d0 / 2.0 + x * (d1 / 3.0 + x * d2 / 4.0)))))
    return peak_qd, peak_qdd


def check_start(knot: Knot, q_ref: Axes, table: LimitTable) -> RejectCode:
    """The first knot of a trajectory is the present reference, at rest, at time zero."""
    away = max(abs(q - ref) for q, ref in zip(knot.q, q_ref, strict=False))
    sound = knot.t_ns == 0 and away <= table.start_tolerance_rad and at_rest(knot)
    return RejectCode.NONE if sound else RejectCode.START


def at_rest(knot: Knot) -> bool:
    """Whether speed and acceleration of a knot are zero up to rounding."""
    return max(map(abs, (*knot.qd, *knot.qdd))) <= _REST
