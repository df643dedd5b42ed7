"""Residuals of a bundle, their robust cost, and what each observation says about its point and its eye.

An observation's rows b = d residual / d point (in vo axes) are all that is needed: the frame's part is
(-[a]x b, -b) with a = point - eye. So only S = sum w b b^T and g = sum w b r are kept.

Helpers take single arrays and numbers, never the whole tuples: handing 17 arrays over costs more than the work itself.
"""

import math

from numba import njit

from server.vision.bundle_contracts import BundleLayout, BundleState, BundleWork
from server.vision.contracts import Array
from server.vision.small_algebra import rotated_by_rotvec

NONE, HUBER, CAUCHY, CUT = 0, 1, 2, 3  # BundleLoss; CUT: 1 below the scale, 0 beyond (for covariances)
Three = tuple[float, float, float]


INVERSE_DEPTH_STEP_MIN = -0.9  # of the relative inverse depth in one step: no point jumps behind its anchor


@njit(cache=True, nogil=True)
def apply_step(layout: BundleLayout, state: BundleState, work: BundleWork, step: Array, trial: BundleState) -> None:
    """Write the moved state into `trial`: frames by R <- exp(w) R, t <- t + dt, points in their charts."""
    for frame in range(len(layout.frame_columns)):
        column = layout.frame_columns[frame]
        if column < 0:
            trial.rotation[frame] = state.rotation[frame]
            trial.position[frame] = state.position[frame]
            continue
        part = step[6 * column : 6 * column + 6]
        trial.rotation[frame] = rotated_by_rotvec(state.rotation[frame], part[:3])
        for j in range(3):
            trial.position[frame, j] = state.position[frame, j] + part[3 + j]
    for p in range(len(work.anchor_frames)):
        if work.anchor_frames[p] >= 0:
            _move_point(state, work, p, trial)
        else:
            trial.points[p] = state.points[p]


@njit(cache=True, nogil=True)
def _move_point(state: BundleState, work: BundleWork, p: int, trial: BundleState) -> None:
    eye, M, d = state.position[work.anchor_frames[p]], work.point_chart[p], work.point_step[p]
    shrink = 1.0 / (1.0 + max(d[2], INVERSE_DEPTH_STEP_MIN))
    for j in range(3):  # the chart's third column is minus `eye_to_point`
        trial.points[p, j] = eye[j] + (M[j, 0] * d[0] + M[j, 1] * d[1] - M[j, 2]) * shrink


@njit(cache=True, nogil=True)
def loss(kind: int, scale: float, square: float) -> float:
    """rho(s) of s = |r|^2 [sigma^2]; half of it is the cost."""
    if kind == HUBER and square > scale * scale:
        return 2.0 * scale * math.sqrt(square) - scale * scale
    if kind == CAUCHY:
        return scale * scale * math.log1p(square / (scale * scale))
    if kind == CUT and square > scale * scale:
        return 0.0
    return square


@njit(cache=True, nogil=True)
def weight(kind: int, scale: float, square: float) -> float:
    """d rho / d s."""
    if kind == HUBER and square > scale * scale:
        return scale / math.sqrt(square)
    if kind == CAUCHY:
        return 1.0 / (1.0 + square / (scale * scale))
    if kind == CUT and square > scale * scale:
        return 0.0
    return 1.0


@njit(cache=True, nogil=True)
def in_eye(rotation: Array, position: Array, points: Array, frame: int, p: int) -> Three:
    """Point p in the axes of the left eye of a frame."""
    a0 = points[p, 0] - position[frame, 0]
    a1 = points[p, 1] - position[frame, 1]
    a2 = points[p, 2] - position[frame, 2]
    return (
        rotation[frame, 0, 0] * a0 + rotation[frame, 1, 0] * a1 + rotation[frame, 2, 0] * a2,
        rotation[frame, 0, 1] * a0 + rotation[frame, 1, 1] * a1 + rotation[frame, 2, 1] * a2,
        rotation[frame, 0, 2] * a0 + rotation[frame, 1, 2] * a1 + rotation[frame, 2, 2] * a2,
    )


@njit(cache=True, nogil=True)
def residuals(rays: Array, scale: Array, i: int, ul: float, ur: float, v: float) -> tuple[float, float, float, float]:
    """Left u, v, right u, v of observation i [sigma]; 0 where an eye does not see the point."""
    return (
        scale[i, 0] * (ul - rays[i, 0]),
        scale[i, 1] * (v - rays[i, 1]),
        scale[i, 2] * (ur - rays[i, 2]),
        scale[i, 3] * (v - rays[i, 3]),
    )


@njit(cache=True, nogil=True)
def observations_cost(layout: BundleLayout, state: BundleState) -> tuple[float, int]:
    """Cost of all observations `in_front`, and how many of them have their point behind the eye."""
    rotation, position, points = state.rotation, state.position, state.points
    frame, first, alive, rays, scale = (
        layout.frame_indices,
        layout.first_observation,
        layout.in_front,
        layout.rays,
        layout.focal_over_sigma,
    )
    kind, size, joint, baseline = layout.loss, layout.loss_scale, layout.shared_row, layout.baseline
    cost, behind = 0.0, 0
    for p in range(len(points)):
        for i in range(first[p], first[p + 1]):
            if not alive[i]:
                continue
            x, y, z = in_eye(rotation, position, points, frame[i], p)
            if not z > layout.depth_min:
                behind += 1
                continue
            r0, r1, r2, r3 = residuals(rays, scale, i, x / z, (x - baseline) / z, y / z)
            left, right = r0 * r0 + r1 * r1, r2 * r2 + r3 * r3
            if joint:
                cost += 0.5 * loss(kind, size, left + right)
            else:
                cost += 0.5 * (loss(kind, size, left) + loss(kind, size, right))
    return cost, behind


@njit(cache=True, nogil=True)
def drop_behind(layout: BundleLayout, state: BundleState) -> None:
    """Leave out for good what has its point behind the eye."""
    for p in range(len(state.points)):
        for i in range(layout.first_observation[p], layout.first_observation[p + 1]):
            _, _, z = in_eye(state.rotation, state.position, state.points, layout.frame_indices[i], p)
            if not z > layout.depth_min:
                layout.in_front[i] = False


@njit(cache=True, nogil=True)
def linearise(layout: BundleLayout, state: BundleState, work: BundleWork) -> None:
    """Write S, g, `eye_to_point` and `squared_residuals` of every observation `in_front`; zeros for the others."""
    rotation, position, points = state.rotation, state.position, state.points
    frame, first, alive, rays, scale = (
        layout.frame_indices,
        layout.first_observation,
        layout.in_front,
        layout.rays,
        layout.focal_over_sigma,
    )
    kind, size, joint, baseline = layout.loss, layout.loss_scale, layout.shared_row, layout.baseline
    weights, pull, arm, squares = (
        work.observation_information,
        work.observation_gradient,
        work.eye_to_point,
        work.squared_residuals,
    )
    for p in range(len(points)):
        for i in range(first[p], first[p + 1]):
            f = frame[i]
            x, y, z = in_eye(rotation, position, points, f, p)
            if not alive[i] or not z > layout.depth_min:
                _clear_observation(i, weights, pull, arm, squares)
                continue
            ul, ur, v = x / z, (x - baseline) / z, y / z
            r0, r1, r2, r3 = residuals(rays, scale, i, ul, ur, v)
            left, right = r0 * r0 + r1 * r1, r2 * r2 + r3 * r3
            if joint:
                left += right
                right = left
            squares[i, 0], squares[i, 1] = left, right
            left, right = weight(kind, size, left), weight(kind, size, right)
            # rows b in camera axes: scale / z * (1, 0, -u) and scale / z * (0, 1, -v)
            s0, s1, s2, s3 = scale[i, 0] / z, scale[i, 1] / z, scale[i, 2] / z, scale[i, 3] / z
            gl, gr = left * s0 * r0, right * s2 * r2
            gy = left * s1 * r1 + right * s3 * r3
            _rotate_pull(rotation, f, i, gl + gr, gy, -(gl * ul + gr * ur + gy * v), pull)
            cl, cr, cy = left * s0 * s0, right * s2 * s2, left * s1 * s1 + right * s3 * s3
            own = (cl + cr, cy, cl * ul * ul + cr * ur * ur + cy * v * v)
            _rotate_weight(rotation, f, i, own, (-cy * v, -cl * ul - cr * ur), weights)
            for j in range(3):
                arm[i, j] = points[p, j] - position[f, j]


@njit(cache=True, nogil=True)
def _clear_observation(i: int, weights: Array, pull: Array, arm: Array, squares: Array) -> None:
    for j in range(3):
        weights[i, j] = weights[i, 3 + j] = pull[i, j] = arm[i, j] = 0.0
    squares[i, 0] = squares[i, 1] = 0.0


@njit(cache=True, nogil=True)
def _rotate_pull(R: Array, f: int, i: int, x: float, y: float, z: float, pull: Array) -> None:
    for j in range(3):
        pull[i, j] = R[f, j, 0] * x + R[f, j, 1] * y + R[f, j, 2] * z


@njit(cache=True, nogil=True)
def _rotate_weight(R: Array, f: int, i: int, own: Three, off: tuple[float, float], weights: Array) -> None:
    """R S R^T of S with diagonal (xx, yy, zz) and off-diagonal yz and zx (xy is 0), as xx, yy, zz, xy, yz, zx."""
    xx, yy, zz = own
    yz, zx = off
    for j in range(3):
        k = (j + 1) % 3
        tx = R[f, j, 0] * xx + R[f, j, 2] * zx
        ty = R[f, j, 1] * yy + R[f, j, 2] * yz
        tz = R[f, j, 0] * zx + R[f, j, 1] * yz + R[f, j, 2] * zz
        weights[i, j] = tx * R[f, j, 0] + ty * R[f, j, 1] + tz * R[f, j, 2]
        weights[i, 3 + j] = tx * R[f, k, 0] + ty * R[f, k, 1] + tz * R[f, k, 2]
