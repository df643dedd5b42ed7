"""Solving the reduced system, and the points' steps from it."""

import math

from numba import njit

from server.vision.bundle_layout import BundleLayout, BundleWork
from server.vision.contracts import Array


@njit(cache=True, nogil=True)
def factor(matrix: Array) -> bool:
    """Cholesky of the lower triangle (c, c) in place; False where it is not positive definite."""
    for j in range(len(matrix)):
        row = matrix[j]
        for c in range(j):
            other = matrix[c]
            value = row[c]
            for q in range(c):
                value -= row[q] * other[q]
            row[c] = value / other[c]
        value = row[j]
        for q in range(j):
            value -= row[q] * row[q]
        if not value > 0.0:
            return False
        row[j] = math.sqrt(value)
    return True


@njit(cache=True, nogil=True)
def solve_factored(lower: Array, right: Array) -> None:
    """x of L L^T x = right, in place."""
    c = len(right)
    for j in range(c):
        value = right[j]
        for q in range(j):
            value -= lower[j, q] * right[q]
        right[j] = value / lower[j, j]
    for j in range(c - 1, -1, -1):
        right[j] /= lower[j, j]
        for q in range(j):
            right[q] -= lower[j, q] * right[j]


@njit(cache=True, nogil=True)
def back_substitute(layout: BundleLayout, work: BundleWork, bodies_step: Array) -> float:
    """Steps of the points in their charts into point_step, from the bodies' step; returns their share of the gain.

    The gain that a damped step promises is (g^T (H + dD)^-1 g + d step^T D step) / 2; elimination splits its first part
    into |L^-1 g|^2 of each point and the same of the reduced system.
    """
    frame, first, column, anchor = layout.frame, layout.first, layout.column, work.anchor
    weight, arm, chart, lower, damped, step = (
        work.weight,
        work.arm,
        work.chart,
        work.lower,
        work.damped,
        work.point_step,
    )
    gain = 0.0
    for p in range(len(anchor)):
        if anchor[p] < 0:
            continue
        q0 = q1 = q2 = 0.0
        for i in range(first[p], first[p + 1]):
            c = column[frame[i]]
            if c >= 0:
                x, y, z = _pulled(i, int(6 * c), weight, arm, bodies_step)
                q0 += x
                q1 += y
                q2 += z
        gain += _point_step(p, q0, q1, q2, chart, lower, damped, step)
    return gain


@njit(cache=True, nogil=True)
def _pulled(i: int, o: int, weight: Array, arm: Array, step: Array) -> tuple[float, float, float]:
    """S A^T step of one observation."""
    a0, a1, a2 = arm[i, 0], arm[i, 1], arm[i, 2]
    d0 = a1 * step[o + 2] - a2 * step[o + 1] - step[o + 3]
    d1 = a2 * step[o] - a0 * step[o + 2] - step[o + 4]
    d2 = a0 * step[o + 1] - a1 * step[o] - step[o + 5]
    return (
        weight[i, 0] * d0 + weight[i, 3] * d1 + weight[i, 5] * d2,
        weight[i, 3] * d0 + weight[i, 1] * d1 + weight[i, 4] * d2,
        weight[i, 5] * d0 + weight[i, 4] * d1 + weight[i, 2] * d2,
    )


@njit(cache=True, nogil=True)
def _point_step(
    p: int, q0: float, q1: float, q2: float, chart: Array, lower: Array, damped: Array, step: Array
) -> float:
    """step[p] <- -(L L^T)^-1 (g + M^T q), g being what stands there; returns the point's share of the gain."""
    M, L = chart[p], lower[p]
    g0, g1, g2 = step[p, 0], step[p, 1], step[p, 2]
    y0 = g0 / L[0, 0]
    y1 = (g1 - L[1, 0] * y0) / L[1, 1]
    y2 = (g2 - L[2, 0] * y0 - L[2, 1] * y1) / L[2, 2]
    x0 = -(g0 + M[0, 0] * q0 + M[1, 0] * q1 + M[2, 0] * q2) / L[0, 0]
    x1 = (-(g1 + M[0, 1] * q0 + M[1, 1] * q1 + M[2, 1] * q2) - L[1, 0] * x0) / L[1, 1]
    x2 = (-(g2 + M[0, 2] * q0 + M[1, 2] * q1 + M[2, 2] * q2) - L[2, 0] * x0 - L[2, 1] * x1) / L[2, 2]
    x2 /= L[2, 2]
    x1 = (x1 - L[2, 1] * x2) / L[1, 1]
    x0 = (x0 - L[1, 0] * x1 - L[2, 0] * x2) / L[0, 0]
    step[p, 0], step[p, 1], step[p, 2] = x0, x1, x2
    damping = damped[p, 0] * x0 * x0 + damped[p, 1] * x1 * x1 + damped[p, 2] * x2 * x2
    return 0.5 * (y0 * y0 + y1 * y1 + y2 * y2 + damping)
