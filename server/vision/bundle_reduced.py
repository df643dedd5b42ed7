"""The reduced camera system: points are eliminated one by one (Schur complement), frames are solved for together."""

import math

from numba import njit

from server.vision.bundle_contracts import POINT_PRIOR_INFORMATION, BundleLayout, BundleState, BundleWork, Indices
from server.vision.contracts import Array


@njit(cache=True, nogil=True)
def cholesky_in_place(matrix: Array) -> bool:
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
def back_substitute(layout: BundleLayout, work: BundleWork, frames_step: Array) -> float:
    """Steps of the points in their charts into point_step, from the frames' step; returns their share of the gain.

    The gain that a damped step promises is (g^T (H + dD)^-1 g + d step^T D step) / 2; elimination splits its first part
    into |L^-1 g|^2 of each point and the same of the reduced system.
    """
    frame, first, column, anchor = (
        layout.frame_indices,
        layout.first_observation,
        layout.frame_columns,
        work.anchor_frames,
    )
    weight, arm, chart, lower, damped, step = (
        work.observation_information,
        work.eye_to_point,
        work.point_chart,
        work.point_cholesky,
        work.point_damping,
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
                x, y, z = _weighted_displacement(i, int(6 * c), weight, arm, frames_step)
                q0 += x
                q1 += y
                q2 += z
        gain += _point_step(p, q0, q1, q2, chart, lower, damped, step)
    return gain


@njit(cache=True, nogil=True)
def _weighted_displacement(i: int, o: int, weight: Array, arm: Array, step: Array) -> tuple[float, float, float]:
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


@njit(cache=True, nogil=True)
def choose_charts(layout: BundleLayout, state: BundleState, work: BundleWork) -> None:
    """Anchor of every point (the nearest eye that sees it; -1: none) and its chart there.

    In an anchor's axes X = (alpha, beta, 1) / rho. A step is taken in alpha, beta and relative rho, in which stereo
    measurements are nearly linear at any distance; the point itself stays Euclidean in vo, so that the frames' system
    is the ordinary one and an anchor that moves costs nothing.
    """
    rotation, arm, chart, anchor = state.rotation, work.eye_to_point, work.point_chart, work.anchor_frames
    for p in range(len(anchor)):
        anchor[p] = -1
        nearest = math.inf
        for i in range(layout.first_observation[p], layout.first_observation[p + 1]):
            f = layout.frame_indices[i]
            z = rotation[f, 0, 2] * arm[i, 0] + rotation[f, 1, 2] * arm[i, 1] + rotation[f, 2, 2] * arm[i, 2]
            if layout.in_front[i] and z < nearest:
                nearest, anchor[p] = z, f
                for j in range(3):
                    chart[p, j, 0] = z * rotation[f, j, 0]
                    chart[p, j, 1] = z * rotation[f, j, 1]
                    chart[p, j, 2] = -arm[i, j]


@njit(cache=True, nogil=True)
def assemble(layout: BundleLayout, work: BundleWork, damping: float) -> None:
    """Reduced system and right side for J^T W J + damping * its diagonal."""
    frame, first, column, alive = layout.frame_indices, layout.first_observation, layout.frame_columns, layout.in_front
    weight, pull, arm, rows, columns = (
        work.observation_information,
        work.observation_gradient,
        work.eye_to_point,
        work.point_frame_blocks,
        work.point_frame_columns,
    )
    reduced, right, diagonal = work.reduced_matrix, work.reduced_rhs, work.reduced_diagonal
    reduced[:], right[:], diagonal[:] = 0.0, 0.0, 0.0
    for p in range(len(work.anchor_frames)):
        begin, end = first[p], first[p + 1]
        for i in range(begin, end):
            c = column[frame[i]]
            if c >= 0:
                _add_block(int(6 * c), i, weight, pull, arm, reduced, right, diagonal)
        if work.anchor_frames[p] >= 0:
            _factor_point(
                p,
                begin,
                end,
                damping,
                weight,
                pull,
                work.point_chart,
                work.point_cholesky,
                work.point_damping,
                work.point_step,
            )
            count = 0
            for i in range(begin, end):
                if alive[i] and column[frame[i]] >= 0:
                    columns[count] = 6 * column[frame[i]]
                    _project_rows(p, i, count, work.point_chart, work.point_cholesky, weight, arm, rows)
                    count += 1
            _eliminate_point(p, count, work.point_step, work.point_cholesky, columns, rows, reduced, right)
    for j in range(len(diagonal)):
        reduced[j, j] += damping * diagonal[j]


@njit(cache=True, nogil=True)
def _add_block(
    o: int, i: int, weight: Array, pull: Array, arms: Array, H: Array, right: Array, diagonal: Array
) -> None:
    """Add A S A^T (lower triangle) and A g for A = -([a]x; 1) to a frame's own block at row `o`."""
    xx, yy, zz, xy, yz, zx = weight[i, 0], weight[i, 1], weight[i, 2], weight[i, 3], weight[i, 4], weight[i, 5]
    a0, a1, a2 = arms[i, 0], arms[i, 1], arms[i, 2]
    # Q = [a]x S
    q00, q01, q02 = a1 * zx - a2 * xy, a1 * yz - a2 * yy, a1 * zz - a2 * yz
    q10, q11, q12 = a2 * xx - a0 * zx, a2 * xy - a0 * yz, a2 * zx - a0 * zz
    q20, q21, q22 = a0 * xy - a1 * xx, a0 * yy - a1 * xy, a0 * yz - a1 * zx
    # Q [a]x^T
    n00, n11, n22 = q02 * a1 - q01 * a2, q10 * a2 - q12 * a0, q21 * a0 - q20 * a1
    H[o, o] += n00
    H[o + 1, o] += q12 * a1 - q11 * a2
    H[o + 1, o + 1] += n11
    H[o + 2, o] += q22 * a1 - q21 * a2
    H[o + 2, o + 1] += q20 * a2 - q22 * a0
    H[o + 2, o + 2] += n22
    H[o + 3, o] += q00
    H[o + 3, o + 1] += q10
    H[o + 3, o + 2] += q20
    H[o + 3, o + 3] += xx
    H[o + 4, o] += q01
    H[o + 4, o + 1] += q11
    H[o + 4, o + 2] += q21
    H[o + 4, o + 3] += xy
    H[o + 4, o + 4] += yy
    H[o + 5, o] += q02
    H[o + 5, o + 1] += q12
    H[o + 5, o + 2] += q22
    H[o + 5, o + 3] += zx
    H[o + 5, o + 4] += yz
    H[o + 5, o + 5] += zz
    diagonal[o] += n00
    diagonal[o + 1] += n11
    diagonal[o + 2] += n22
    diagonal[o + 3] += xx
    diagonal[o + 4] += yy
    diagonal[o + 5] += zz
    g0, g1, g2 = -pull[i, 0], -pull[i, 1], -pull[i, 2]
    right[o] += a1 * g2 - a2 * g1
    right[o + 1] += a2 * g0 - a0 * g2
    right[o + 2] += a0 * g1 - a1 * g0
    right[o + 3] += g0
    right[o + 4] += g1
    right[o + 5] += g2


@njit(cache=True, nogil=True)
def _symmetric_matrix_column(s: Array, j: int) -> tuple[float, float, float]:
    """Column j of the symmetric S held as xx, yy, zz, xy, yz, zx."""
    if j == 0:
        return s[0], s[3], s[5]
    if j == 1:
        return s[3], s[1], s[4]
    return s[5], s[4], s[2]


@njit(cache=True, nogil=True)
def _factor_point(
    p: int,
    begin: int,
    end: int,
    damping: float,
    weight: Array,
    pull: Array,
    chart: Array,
    lower: Array,
    damped: Array,
    step: Array,
) -> None:
    """Cholesky factor of the point's block in its chart; the chart's right side goes into `step`."""
    s0 = s1 = s2 = s3 = s4 = s5 = g0 = g1 = g2 = 0.0
    for i in range(begin, end):
        s0 += weight[i, 0]
        s1 += weight[i, 1]
        s2 += weight[i, 2]
        s3 += weight[i, 3]
        s4 += weight[i, 4]
        s5 += weight[i, 5]
        g0 += pull[i, 0]
        g1 += pull[i, 1]
        g2 += pull[i, 2]
    M, L = chart[p], lower[p]
    for j in range(3):
        x, y, z = M[0, j], M[1, j], M[2, j]
        step[p, j] = g0 * x + g1 * y + g2 * z
        v0, v1, v2 = s0 * x + s3 * y + s5 * z, s3 * x + s1 * y + s4 * z, s5 * x + s4 * y + s2 * z
        for c in range(j, 3):
            L[c, j] = M[0, c] * v0 + M[1, c] * v1 + M[2, c] * v2
    floor = POINT_PRIOR_INFORMATION + 1e-12 * (L[0, 0] + L[1, 1] + L[2, 2])
    for j in range(3):
        damped[p, j] = damping * L[j, j] + floor
        L[j, j] += damped[p, j]
    L[0, 0] = math.sqrt(L[0, 0])
    L[1, 0] /= L[0, 0]
    L[2, 0] /= L[0, 0]
    L[1, 1] = math.sqrt(L[1, 1] - L[1, 0] * L[1, 0])
    L[2, 1] = (L[2, 1] - L[2, 0] * L[1, 0]) / L[1, 1]
    L[2, 2] = math.sqrt(L[2, 2] - L[2, 0] * L[2, 0] - L[2, 1] * L[2, 1])


@njit(cache=True, nogil=True)
def _project_rows(p: int, i: int, at: int, chart: Array, lower: Array, weight: Array, arm: Array, rows: Array) -> None:
    """rows[at] (3, 6) = (A S M L^-T)^T: with V = L L^T, products of such rows are the blocks W V^-1 W^T."""
    M, L, s, out = chart[p], lower[p], weight[i], rows[at]
    i0, i1, i2 = 1.0 / L[0, 0], 1.0 / L[1, 1], 1.0 / L[2, 2]
    for j in range(3):
        x, y, z = _symmetric_matrix_column(s, j)
        u0 = (x * M[0, 0] + y * M[1, 0] + z * M[2, 0]) * i0
        u1 = (x * M[0, 1] + y * M[1, 1] + z * M[2, 1] - L[1, 0] * u0) * i1
        u2 = (x * M[0, 2] + y * M[1, 2] + z * M[2, 2] - L[2, 0] * u0 - L[2, 1] * u1) * i2
        out[0, 3 + j], out[1, 3 + j], out[2, 3 + j] = -u0, -u1, -u2
    a0, a1, a2 = arm[i, 0], arm[i, 1], arm[i, 2]
    for j in range(3):
        b0, b1, b2 = out[j, 3], out[j, 4], out[j, 5]
        out[j, 0], out[j, 1], out[j, 2] = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0


@njit(cache=True, nogil=True)
def _eliminate_point(
    p: int, count: int, step: Array, lower: Array, columns: Indices, rows: Array, reduced: Array, right: Array
) -> None:
    """Subtract W V^-1 W^T (lower triangle) and W V^-1 g of the frames that see point p."""
    L = lower[p]
    y0 = step[p, 0] / L[0, 0]
    y1 = (step[p, 1] - L[1, 0] * y0) / L[1, 1]
    y2 = (step[p, 2] - L[2, 0] * y0 - L[2, 1] * y1) / L[2, 2]
    for first in range(count):
        c = columns[first]
        for j in range(6):
            b0, b1, b2 = rows[first, 0, j], rows[first, 1, j], rows[first, 2, j]
            right[c + j] -= b0 * y0 + b1 * y1 + b2 * y2
            for second in range(count):
                d = columns[second]
                if d <= c:
                    for q in range(6):
                        reduced[c + j, d + q] -= (
                            b0 * rows[second, 0, q] + b1 * rows[second, 1, q] + b2 * rows[second, 2, q]
                        )
