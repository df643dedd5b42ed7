"""Pose of the left camera from known points: a start that survives outliers, then a robust two-view refinement."""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.poses import pose
from machine.rotations import nearest_rotation
from server.vision.contracts import Array
from server.vision.small_algebra import accumulate, apply, point_rows, rotated, solve_positive

RANSAC_PX = 2.5
RANSAC_ROUNDS = 150
ROUNDS_MAX = 20
CAUCHY_SCALE = 2.0  # in sigmas
INLIER_SIGMA = 4.0
DEPTH_MIN_M = 0.05


@dataclass(frozen=True, slots=True)
class StereoPoints:
    """Known points (n, 3) [m] in vo, their undistorted rays (n, 2) in each eye (NaN = not seen), and the standard
    deviation (n, 2) [px] of each eye's coordinate, map error included."""

    points_vo: Array
    rays_left: Array
    rays_right: Array
    sigma_px: Array
    focal_px: float
    baseline_m: float


@dataclass(frozen=True, slots=True)
class PoseFit:
    """T_cam_vo, covariance (6, 6) (left perturbation in camera axes, then translation), inliers (n,), rms [sigma]."""

    T_cam_vo: Array
    covariance: Array
    inliers: NDArray[np.bool_]
    rms_sigma: float


@dataclass(frozen=True, slots=True)
class CoarsePose:
    """A start: T_cam_vo and how many points agree with it."""

    T_cam_vo: Array
    n_inliers: int


def coarse_pose(points_vo: Array, rays: Array, focal_px: float) -> CoarsePose | None:
    """T_cam_vo by PnP with RANSAC; None where no pose gathers at least 8 points."""
    if len(points_vo) < 8:
        return None
    try:
        good, rvec, tvec, inliers = cv2.solvePnPRansac(
            points_vo.reshape(-1, 1, 3),
            rays.reshape(-1, 1, 2),
            np.eye(3),
            None,
            iterationsCount=RANSAC_ROUNDS,
            reprojectionError=RANSAC_PX / focal_px,
            confidence=0.999,
            flags=cv2.SOLVEPNP_SQPNP,
        )
    except cv2.error:  # degenerate points
        return None
    if not good or inliers is None or len(inliers) < 8:
        return None
    rotation = nearest_rotation(np.asarray(cv2.Rodrigues(rvec)[0], dtype=float))
    return CoarsePose(pose(rotation, np.asarray(tvec, dtype=float).reshape(3)), len(inliers))


@njit(cache=True)
def _equations(
    rotation: Array, position: Array, points: Array, rays: Array, sigma: Array, focal: float, baseline: float
) -> tuple[Array, Array, float, Array]:
    """Weighted J^T J, J^T r, robust cost, and squared residual [sigma^2] per point and eye; rays (n, 2 eyes, 2)."""
    information, gradient, cost = np.zeros((6, 6)), np.zeros(6), 0.0
    squares = np.full((len(points), 2), np.nan)
    rows = np.zeros((2, 6))
    residual = np.zeros(2)
    for i in range(len(points)):
        arm = apply(rotation, points[i])
        x, y, z = arm + position
        if z < DEPTH_MIN_M:
            cost += 50.0
            continue
        for eye in range(2):
            if np.isnan(rays[i, eye, 0]):
                continue
            scale = focal / sigma[i, eye]
            u, v = (x - eye * baseline) / z, y / z
            residual[0], residual[1] = scale * (u - rays[i, eye, 0]), scale * (v - rays[i, eye, 1])
            square = residual[0] ** 2 + residual[1] ** 2
            squares[i, eye] = square
            weight = 1.0 / (1.0 + square / CAUCHY_SCALE**2)
            cost += CAUCHY_SCALE**2 * np.log1p(square / CAUCHY_SCALE**2)
            point_rows(arm, u, v, z, scale, scale, rows)
            accumulate(rows, residual, weight, information, gradient)
    return information, gradient, cost, squares


@njit(cache=True)
def _minimise(
    rotation: Array, position: Array, points: Array, rays: Array, sigma: Array, focal: float, baseline: float
) -> tuple[Array, Array, Array, Array]:
    information, gradient, cost, squares = _equations(rotation, position, points, rays, sigma, focal, baseline)
    damping = 1e-4
    for _ in range(ROUNDS_MAX):
        damped = information.copy()
        for k in range(6):
            damped[k, k] += damping * information[k, k] + 1e-6
        step = solve_positive(damped, -gradient)
        new_rotation, new_position = rotated(rotation, step[:3]), position + step[3:]
        new = _equations(new_rotation, new_position, points, rays, sigma, focal, baseline)
        if new[2] <= cost:
            small = cost - new[2] < 1e-7 * cost
            rotation, position = new_rotation, new_position
            information, gradient, cost, squares = new
            damping = max(0.1 * damping, 1e-9)
            if small:
                break
        else:
            damping *= 10.0
            if damping > 1e6:
                break
    return rotation, position, information, squares


def refine_camera(T_cam_vo: Array, seen: StereoPoints) -> PoseFit | None:
    """Robust pose of the camera from all points in both eyes; None where they do not determine it.

    Model:   min over T of sum of rho(|f (pi_eye(T X) - ray)|^2 / sigma^2), rho Cauchy, by IRLS-LM with analytic
             Jacobian; left perturbation. A point is an inlier below 4 sigma per eye. Covariance: (J^T W J)^-1 times
             the inliers' mean square where that exceeds 1.
    Args:    T_cam_vo: start (4, 4). seen: points and observations.
    """
    rays = np.stack([seen.rays_left, seen.rays_right], axis=1)
    rotation, position, information, squares = _minimise(
        np.ascontiguousarray(T_cam_vo[:3, :3]),
        np.ascontiguousarray(T_cam_vo[:3, 3]),
        np.ascontiguousarray(seen.points_vo),
        np.ascontiguousarray(rays),
        np.ascontiguousarray(seen.sigma_px),
        seen.focal_px,
        seen.baseline_m,
    )
    with np.errstate(invalid="ignore"):
        fits = (squares < INLIER_SIGMA**2) | np.isnan(squares)
    inliers = np.asarray(fits.all(axis=1) & ~np.isnan(squares).all(axis=1))
    if inliers.sum() < 6 or np.linalg.cond(information) > 1e14:
        return None
    mean_square = float(np.nanmean(squares[inliers])) / 2.0
    covariance = max(mean_square, 1.0) * np.linalg.inv(information)
    return PoseFit(pose(rotation, position), 0.5 * (covariance + covariance.T), inliers, float(np.sqrt(mean_square)))
