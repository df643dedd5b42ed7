"""Pose of a rigid object from its points in one or two eyes: Levenberg-Marquardt with the analytic Jacobian."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from server.vision.contracts import Array
from server.vision.small_algebra import rotated_by_rotvec, solve_positive

DEPTH_MIN_M = 0.02  # nearer points are behind the glass: no pose puts them there
ITERATIONS_MAX = 60
CONVERGED_GAIN_FRAC = 1e-12  # of the sum of squares


@dataclass(frozen=True, slots=True)
class PointObservations:
    """Object points and where the eyes saw them, undistorted and relative to the principal point.

    points_object (n, 3) [m]; seen_px (n, 2) = (fx x, fy y) [px]; eye_x_m (n,): x of that eye in the left camera
    (0 or the baseline) [m]; focal_px (2,) = (fx, fy). weights (n, 2, 2): what turns a small residual of the point into
    one whose coordinates have equal, independent noise, such as the lens's d(raw px)/d(undistorted px); None: the unit.
    """

    points_object: Array
    seen_px: Array
    eye_x_m: Array
    focal_px: Array
    weights: Array | None = None

    def subset(self, rows: NDArray[np.bool_]) -> "PointObservations":
        """Only these rows (n,)."""
        weights = None if self.weights is None else self.weights[rows]
        kept = self.points_object[rows], self.seen_px[rows], self.eye_x_m[rows]
        return PointObservations(*kept, self.focal_px, weights)


@dataclass(frozen=True, slots=True)
class RefinedPose:
    """A local minimum: pose, sum of squared residuals [px^2], information J^T J, residuals (n, 2) [px]."""

    T_cam_object: Array
    sum_squares_px2: float
    information: Array
    residuals_px: Array


class KernelArrays(NamedTuple):
    """`PointObservations` as the kernels take them: contiguous arrays."""

    points: Array
    seen_px: Array
    eye_x: Array
    focal_px: Array
    weights: Array


def kernel_arrays(observations: PointObservations) -> KernelArrays:
    """The kernels' argument."""
    weights = observations.weights
    if weights is None:
        weights = np.repeat(np.eye(2)[None], len(observations.points_object), axis=0)
    arrays = observations.points_object, observations.seen_px, observations.eye_x_m, observations.focal_px, weights
    return KernelArrays(*(np.ascontiguousarray(array, dtype=np.float64) for array in arrays))


@njit(cache=True, nogil=True)
def sum_squares(rotation: Array, position: Array, given: KernelArrays) -> float:
    """Sum of squared residuals [px^2]; inf where a point lies behind the glass."""
    points, seen, eye_x, focal, weights = given
    total = 0.0
    for i in range(points.shape[0]):
        a, b, c = points[i, 0], points[i, 1], points[i, 2]
        z = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c + position[2]
        if not z >= DEPTH_MIN_M:
            return np.inf
        x = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c + position[0]
        y = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c + position[1]
        du = focal[0] * (x - eye_x[i]) / z - seen[i, 0]
        dv = focal[1] * y / z - seen[i, 1]
        a, b = weights[i, 0, 0] * du + weights[i, 0, 1] * dv, weights[i, 1, 0] * du + weights[i, 1, 1] * dv
        total += a * a + b * b
    return total


@njit(cache=True, nogil=True)
def _normal_equations(
    rotation: Array, position: Array, given: KernelArrays, information: Array, gradient: Array
) -> None:
    """J^T J and J^T r, in place, for the left perturbation R <- exp(w) R, t <- t + dt; upper half mirrored."""
    points, seen, eye_x, focal, weights = given
    information[:], gradient[:] = 0.0, 0.0
    row, col = np.empty(6), np.empty(6)
    for i in range(points.shape[0]):
        a, b, c = points[i, 0], points[i, 1], points[i, 2]
        ax = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c
        ay = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c
        az = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c
        inverse = 1.0 / (az + position[2])
        u, v = (ax + position[0] - eye_x[i]) * inverse, (ay + position[1]) * inverse
        du, dv = focal[0] * u - seen[i, 0], focal[1] * v - seen[i, 1]
        row[4], col[3] = 0.0, 0.0
        row[3], row[5] = focal[0] * inverse, -focal[0] * u * inverse
        col[4], col[5] = focal[1] * inverse, -focal[1] * v * inverse
        row[0], row[1], row[2] = ay * row[5], az * row[3] - ax * row[5], -ay * row[3]  # d(exp(w) arm)/dw = -[arm]x
        col[0], col[1], col[2] = ay * col[5] - az * col[4], -ax * col[5], ax * col[4]
        w00, w01, w10, w11 = weights[i, 0, 0], weights[i, 0, 1], weights[i, 1, 0], weights[i, 1, 1]
        du, dv = w00 * du + w01 * dv, w10 * du + w11 * dv
        for j in range(6):
            row[j], col[j] = w00 * row[j] + w01 * col[j], w10 * row[j] + w11 * col[j]
        for j in range(6):
            gradient[j] += row[j] * du + col[j] * dv
            for k in range(j, 6):
                information[j, k] += row[j] * row[k] + col[j] * col[k]
    for j in range(6):
        for k in range(j):
            information[j, k] = information[k, j]


@njit(cache=True, nogil=True)
def _levenberg_marquardt(T: Array, given: KernelArrays) -> tuple[Array, Array, float, Array]:
    """Levenberg-Marquardt from one start: rotation, position, sum of squares, information."""
    rotation, position = T[:3, :3].copy(), T[:3, 3].copy()
    total = sum_squares(rotation, position, given)
    information, gradient, damped = np.zeros((6, 6)), np.zeros(6), np.zeros((6, 6))
    damping, fresh = 1e-3, False
    for _ in range(ITERATIONS_MAX):
        if not np.isfinite(total):
            break
        if not fresh:
            _normal_equations(rotation, position, given, information, gradient)
            fresh = True
        damped[:] = information
        for k in range(6):
            damped[k, k] += damping * information[k, k] + 1e-9
        step = solve_positive(damped, -gradient)
        new_rotation = rotated_by_rotvec(rotation, step[:3])
        new_position = position + step[3:]
        new_total = sum_squares(new_rotation, new_position, given)
        if new_total <= total:
            small = np.abs(step).max() < 1e-11 or total - new_total < CONVERGED_GAIN_FRAC * total + 1e-20
            rotation, position, total, fresh = new_rotation, new_position, new_total, False
            damping = max(damping * 0.1, 1e-9)
            if small:
                break
        else:
            damping *= 10.0
            if damping > 1e12:
                break  # no descent left in working precision
    if np.isfinite(total) and not fresh:
        _normal_equations(rotation, position, given, information, gradient)
    return rotation, position, total, information


@njit(cache=True, nogil=True)
def _descend_all(Ts: Array, given: KernelArrays) -> tuple[Array, Array, Array]:
    """From every start (k, 4, 4): poses (k, 4, 4), sums of squares (k,), information (k, 6, 6)."""
    found, totals, informations = np.zeros(Ts.shape), np.empty(len(Ts)), np.empty((len(Ts), 6, 6))
    for k in range(len(Ts)):
        rotation, position, total, information = _levenberg_marquardt(Ts[k], given)
        found[k, :3, :3], found[k, :3, 3], found[k, 3, 3] = rotation, position, 1.0
        totals[k], informations[k] = total, information
    return found, totals, informations


def residuals_px(T_cam_object: Array, observations: PointObservations) -> Array:
    """Predicted minus seen, weighted, (n, 2) [px]."""
    x, y, z = (observations.points_object @ T_cam_object[:3, :3].T + T_cam_object[:3, 3]).T
    rays = np.column_stack([(x - observations.eye_x_m) / z, y / z])
    plain = rays * observations.focal_px - observations.seen_px
    return plain if observations.weights is None else np.einsum("nij,nj->ni", observations.weights, plain)


@njit(cache=True, nogil=True)
def _distinct_orientations(Ts: Array, totals: Array, order: NDArray[np.intp], trace_max: float) -> list[int]:
    """Of poses in ascending order of their sums of squares: the first of each group with the same orientation."""
    kept = [-1]
    for i in order:
        if not totals[i] < np.inf:
            continue
        new = True
        for j in kept[1:]:
            trace = 0.0
            for r in range(3):
                for c in range(3):
                    trace += Ts[i, r, c] * Ts[j, r, c]
            new = new and trace < trace_max
        if new:
            kept.append(i)
    return kept[1:]


def distinct_minima(starts: Array, observations: PointObservations, apart_rad: float) -> list[RefinedPose]:
    """Local minima of the reprojection error over both eyes whose orientations differ, the best first.

    Model:   p = R X + t (object into the left camera); residual = (fx (p_x - eye_x) / p_z, fy p_y / p_z) - seen;
             left perturbation R <- exp(w) R, t <- t + dt; LM with Marquardt scaling.
    Args:    starts (k, 4, 4). observations: at least 3 points.
    """
    Ts = np.ascontiguousarray(starts, dtype=np.float64).reshape(-1, 4, 4)
    found, totals, informations = _descend_all(Ts, kernel_arrays(observations))
    order = np.argsort(totals, kind="stable")
    kept = _distinct_orientations(found, totals, order, 1.0 + 2.0 * float(np.cos(apart_rad)))
    return [
        RefinedPose(found[k], float(totals[k]), informations[k], residuals_px(found[k], observations)) for k in kept
    ]
