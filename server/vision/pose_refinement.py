"""Pose of a rigid object from its points in one or two eyes: Levenberg-Marquardt with the analytic Jacobian."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from machine.poses import pose
from server.vision.contracts import Array
from server.vision.small_algebra import accumulate, apply, point_rows, rotated, solve_positive

DEPTH_MIN_M = 0.02  # nearer points are behind the glass: no pose puts them there
ITERATIONS_MAX = 40


@dataclass(frozen=True, slots=True)
class PointObservations:
    """Object points and where the eyes saw them, undistorted and relative to the principal point.

    points_object (n, 3) [m]; seen_px (n, 2) = (fx x, fy y) [px]; eye_x_m (n,): x of that eye in the left camera
    (0 or the baseline) [m]; focal_px (2,) = (fx, fy).
    """

    points_object: Array
    seen_px: Array
    eye_x_m: Array
    focal_px: Array

    @property
    def n_residuals(self) -> int:
        """Number of scalar residuals."""
        return 2 * len(self.points_object)


@dataclass(frozen=True, slots=True)
class RefinedPose:
    """A local minimum: pose, sum of squared residuals [px^2], information J^T J, residuals (n, 2) [px]."""

    T_cam_object: Array
    sum_squares_px2: float
    information: Array
    residuals_px: Array
    converged: bool


@njit(cache=True)
def _residuals(
    rotation: Array, position: Array, points: Array, seen: Array, eye_x: Array, focal: Array
) -> tuple[Array, float]:
    residuals = np.empty((len(points), 2))
    total = 0.0
    for i in range(len(points)):
        x, y, z = apply(rotation, points[i]) + position
        if z < DEPTH_MIN_M:
            return residuals, np.inf
        residuals[i, 0] = focal[0] * (x - eye_x[i]) / z - seen[i, 0]
        residuals[i, 1] = focal[1] * y / z - seen[i, 1]
        total += residuals[i, 0] ** 2 + residuals[i, 1] ** 2
    return residuals, total


@njit(cache=True)
def _normal_equations(
    rotation: Array, position: Array, points: Array, residuals: Array, eye_x: Array, focal: Array
) -> tuple[Array, Array]:
    """J^T J and J^T r for the left perturbation R <- exp(w) R, t <- t + dt."""
    information, gradient, rows = np.zeros((6, 6)), np.zeros(6), np.zeros((2, 6))
    for i in range(len(points)):
        arm = apply(rotation, points[i])
        x, y, z = arm + position
        point_rows(arm, (x - eye_x[i]) / z, y / z, z, focal[0], focal[1], rows)
        accumulate(rows, residuals[i], 1.0, information, gradient)
    return information, gradient


@njit(cache=True)
def _minimise(
    rotation: Array, position: Array, points: Array, seen: Array, eye_x: Array, focal: Array
) -> tuple[Array, Array, Array, float, Array, bool]:
    residuals, total = _residuals(rotation, position, points, seen, eye_x, focal)
    damping = 1e-3
    converged = False
    for _ in range(ITERATIONS_MAX):
        if not np.isfinite(total):
            break
        information, gradient = _normal_equations(rotation, position, points, residuals, eye_x, focal)
        damped = information.copy()
        for k in range(6):
            damped[k, k] += damping * information[k, k] + 1e-9
        step = solve_positive(damped, -gradient)
        new_rotation = rotated(rotation, step[:3])
        new_position = position + step[3:]
        new_residuals, new_total = _residuals(new_rotation, new_position, points, seen, eye_x, focal)
        if new_total <= total:
            small = np.abs(step).max() < 1e-11 or total - new_total < 1e-12 * total + 1e-20
            rotation, position, residuals, total = new_rotation, new_position, new_residuals, new_total
            damping = max(damping * 0.1, 1e-9)
            if small:
                converged = True
                break
        else:
            damping *= 10.0
            if damping > 1e12:
                converged = True  # no descent left in working precision
                break
    information = np.zeros((6, 6))
    if np.isfinite(total):
        information, gradient = _normal_equations(rotation, position, points, residuals, eye_x, focal)
    return rotation, position, residuals, total, information, converged


def refine_pose(T_cam_object: Array, observations: PointObservations) -> RefinedPose:
    """Local minimum of the reprojection error over both eyes from one start.

    Model:   p = R X + t (object into the left camera); residual = (fx (p_x - eye_x) / p_z, fy p_y / p_z) - seen;
             left perturbation R <- exp(w) R, t <- t + dt; LM with Marquardt scaling.
    Args:    T_cam_object: start (4, 4). observations: at least 3 points.
    Returns: RefinedPose; `sum_squares_px2` is inf when the start has points behind the camera.
    Source:  Levenberg-Marquardt; Jacobian of a calibrated pinhole, checked against finite differences in the tests.
    """
    rotation, position, residuals, total, information, converged = _minimise(
        np.ascontiguousarray(T_cam_object[:3, :3], dtype=np.float64),
        np.ascontiguousarray(T_cam_object[:3, 3], dtype=np.float64),
        np.ascontiguousarray(observations.points_object, dtype=np.float64),
        np.ascontiguousarray(observations.seen_px, dtype=np.float64),
        np.ascontiguousarray(observations.eye_x_m, dtype=np.float64),
        np.ascontiguousarray(observations.focal_px, dtype=np.float64),
    )
    return RefinedPose(pose(rotation, position), float(total), information, residuals, bool(converged))
