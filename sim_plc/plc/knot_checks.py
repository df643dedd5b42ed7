"""What a knot must keep to before the PLC plays it. Written apart from the PC's motion gate, a little wider than it.

Every check names the field that is to blame: `k` is the knot's place in its command.
"""

import math

from protocol.codes import RejectCode
from protocol.limits import LimitTable
from protocol.messages import Axes, Knot
from protocol.objection import Objection, object_to_knot

_ROUNDING = 1e-9  # relative
_REST = 1e-6  # rad/s, rad/s^2
_BETWEEN = 1.10  # between knots the quintic may pass the limits by this: the PC holds itself to less
_INSIDE = tuple(i / 8.0 for i in range(1, 8))


def check_unused(knot: Knot, k: int, table: LimitTable) -> Objection | None:
    """Axes that the machine does not have are zero."""
    n = len(table.axes)
    for j in range(n, len(knot.q)):
        for field, values in (("q", knot.q), ("qd", knot.qd), ("qdd", knot.qdd)):
            if values[j] != 0.0:
                return object_to_knot(RejectCode.AXIS_MASK, k, field, j)
    return None


def check_knot(knot: Knot, k: int, table: LimitTable) -> Objection | None:
    """One knot by itself: unused axes zero, q, qd, qdd inside the limits, room to stop before the range ends."""
    unused = check_unused(knot, k, table)
    if unused is not None:
        return unused
    for j, axis in enumerate(table.axes):
        q, qd = knot.q[j], knot.qd[j]
        if not abs(qd) <= axis.qd_max * (1.0 + _ROUNDING):
            return object_to_knot(RejectCode.LIMIT_QD, k, "qd", j)
        if not abs(knot.qdd[j]) <= axis.qdd_max * (1.0 + _ROUNDING):
            return object_to_knot(RejectCode.LIMIT_QDD, k, "qdd", j)
        stop = q + qd * abs(qd) / (2.0 * axis.qdd_max * _BETWEEN)
        if not axis.q_min - _ROUNDING <= min(q, stop) or not max(q, stop) <= axis.q_max + _ROUNDING:
            return object_to_knot(RejectCode.LIMIT_Q, k, "q", j)
    return None


def check_step(a: Knot, b: Knot, k: int, table: LimitTable) -> Objection | None:
    """Two neighbours, b being the command's k-th knot: spacing, implied speed, and the quintic between them."""
    dt_ns = b.t_ns - a.t_ns
    if not table.spacing_min_ns <= dt_ns <= table.spacing_max_ns:
        return object_to_knot(RejectCode.KNOT_SPACING, k, "t_ns")
    dt_s = dt_ns * 1e-9
    for j, axis in enumerate(table.axes):
        if not abs(b.q[j] - a.q[j]) <= axis.qd_max * dt_s * (1.0 + _ROUNDING):
            return object_to_knot(RejectCode.IMPLIED_SPEED, k, "q", j)
        qd, qdd = segment_peaks(a, b, j)
        if not (qd <= axis.qd_max * _BETWEEN and qdd <= axis.qdd_max * _BETWEEN):
            return object_to_knot(RejectCode.CONTINUITY, k, "q", j)
    return None


def segment_peaks(a: Knot, b: Knot, j: int) -> tuple[float, float]:
    """Largest |qd| [rad/s] at seven points inside the segment from a to b of axis j, and largest |qdd| [rad/s2] in it.

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
    for x in _turning_points(d0, 2.0 * d1, 3.0 * d2):
        peak_qdd = max(peak_qdd, abs(a0 + x * (d0 + x * (d1 + x * d2))))
    for x in _INSIDE:
        peak_qd = max(peak_qd, abs(a.qd[j] + T * x * (a0 + x * (d0 / 2.0 + x * (d1 / 3.0 + x * d2 / 4.0)))))
    return peak_qd, peak_qdd


def _turning_points(c: float, b: float, a: float) -> list[float]:
    """Roots of c + b x + a x^2 between 0 and 1, without cancellation."""
    square = b * b - 4.0 * a * c
    if square < 0.0:
        return []
    root = math.sqrt(square)
    m = -0.5 * (b - root) if b < 0.0 else -0.5 * (b + root)
    found = []
    if m != 0.0:
        found.append(c / m)
    if a != 0.0:
        found.append(m / a)
    return [x for x in found if 0.0 < x < 1.0]


def check_start(knot: Knot, q_ref: Axes, table: LimitTable) -> Objection | None:
    """The first knot of a trajectory is the present reference, at rest, at time zero."""
    if knot.t_ns != 0:
        return object_to_knot(RejectCode.START, 0, "t_ns")
    for j, ref in enumerate(q_ref):
        if not abs(knot.q[j] - ref) <= table.start_tolerance_rad:
            return object_to_knot(RejectCode.START, 0, "q", j)
    return check_rest(knot, 0, RejectCode.START)


def check_rest(knot: Knot, k: int, code: RejectCode) -> Objection | None:
    """Speed and acceleration of the knot are zero up to rounding."""
    for j in range(len(knot.q)):
        if not abs(knot.qd[j]) <= _REST:
            return object_to_knot(code, k, "qd", j)
        if not abs(knot.qdd[j]) <= _REST:
            return object_to_knot(code, k, "qdd", j)
    return None
