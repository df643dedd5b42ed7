"""Pose of the left camera from known points: a start that survives outliers, then a robust two-view refinement."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.poses import pose
from machine.rotations import nearest_rotation
from server.vision.contracts import Array
from server.vision.small_algebra import apply, rotated_by_rotvec, solve_positive

RANSAC_INLIER_MAX_PX = 2.5
RANSAC_ITERATIONS = 150
ITERATIONS_MAX = 20
FINAL_ITERATIONS = 3  # after the robust fit, with the inliers' full weight
CAUCHY_SCALE_SQUARED = 8.0  # [sigma^2] over the four coordinates of a point
INLIER_CHI2_MAX = 20.0  # 99.95 % of chi2 with 4 degrees of freedom
NORMAL_MAD_SIGMAS = 0.6745  # median absolute deviation of a normal distribution, in its sigmas
NOISE_FACTOR_MAX = 4.0  # images may be noisier than assumed, up to so many times
NOISE_FACTOR_MIN = 0.4  # residuals may show better images, but not what a patch errs by in all pairs alike
INLIERS_MIN = 6
DEPTH_MIN_M = 0.05


@dataclass(frozen=True, slots=True)
class StereoPoints:
    """Known points (n, 3) [m] in vo with their covariances (n, 3, 3), their undistorted rays (n, 2) in each eye (NaN in
    the right one = not seen), and the standard deviation of one measured coordinate [px].
    unit_noise_covariances (n, 2, 2, 2): what the lens makes of a sigma of 1 in each eye; None = the identity."""

    points_vo: Array
    covariances_vo: Array
    rays_left: Array
    rays_right: Array
    sigma_px: float
    focal_px: float
    baseline_m: float
    unit_noise_covariances: Array | None = None


@dataclass(frozen=True, slots=True)
class PoseFit:
    """T_cam_vo, covariance (6, 6) (left perturbation in camera axes, then translation), inliers (n,), rms [sigma].

    `information` (6, 6) and `whitening_matrices` (n, 4, 4) [1/px] are what the fit worked with; `squared_residuals`
    (n,) what it left of each point, whitened and squared; below `inlier_limit` a point is an inlier.
    """

    T_cam_vo: Array
    covariance: Array
    inliers: NDArray[np.bool_]
    rms_sigma: float
    information: Array
    whitening_matrices: Array
    squared_residuals: Array
    inlier_limit: float

    @property
    def noise_factor(self) -> float:
        """How many times noisier than assumed the images are, as far as the residuals show."""
        return noise_factor(self.rms_sigma**2)


@dataclass(frozen=True, slots=True)
class CoarsePose:
    """A start: T_cam_vo and how many points agree with it."""

    T_cam_vo: Array
    n_inliers: int


def ransac_pose(
    points: Array, rays: Array, limit: float, rounds: int, method: int = cv2.SOLVEPNP_SQPNP, start: Array | None = None
) -> tuple[Array, NDArray[np.int64]] | None:
    """T_cam_points by PnP with RANSAC from rays (n, 2), inliers below this limit of a ray; and the inliers' indices."""
    rvec = None if start is None else cv2.Rodrigues(start[:3, :3])[0]
    tvec = None if start is None else start[:3, 3].reshape(3, 1).copy()
    good, rvec, tvec, inliers = cv2.solvePnPRansac(
        points.reshape(-1, 1, 3),
        rays.reshape(-1, 1, 2),
        np.eye(3),
        None,
        rvec,
        tvec,
        useExtrinsicGuess=start is not None,
        iterationsCount=rounds,
        reprojectionError=limit,
        confidence=0.999,
        flags=method,
    )
    if not good or inliers is None:
        return None
    T = pose(np.asarray(cv2.Rodrigues(rvec)[0], dtype=float), np.asarray(tvec, dtype=float).reshape(3))
    return T, np.asarray(inliers, dtype=np.int64).ravel()


def coarse_pose(points_vo: Array, rays: Array, focal_px: float) -> CoarsePose | None:
    """T_cam_vo by PnP with RANSAC; None where no pose gathers at least 8 points."""
    if len(points_vo) < 8:
        return None
    try:
        found = ransac_pose(points_vo, rays, RANSAC_INLIER_MAX_PX / focal_px, RANSAC_ITERATIONS)
    except cv2.error:  # degenerate points
        return None
    if found is None or len(found[1]) < 8:
        return None
    T, inliers = found
    return CoarsePose(pose(nearest_rotation(T[:3, :3]), T[:3, 3]), len(inliers))


@njit(cache=True, nogil=True)
def projection_jacobian(point_cam: Array, focal: float, baseline: float, rows: Array) -> None:
    """d(four coordinates) / d(point in camera axes), (4, 3) [px/m], in place: x, y of left, then right eye."""
    inverse = focal / point_cam[2]
    for eye in range(2):
        rows[2 * eye, 0], rows[2 * eye, 1] = inverse, 0.0
        rows[2 * eye, 2] = -inverse * (point_cam[0] - eye * baseline) / point_cam[2]
        rows[2 * eye + 1, 0], rows[2 * eye + 1, 1] = 0.0, inverse
        rows[2 * eye + 1, 2] = -inverse * point_cam[1] / point_cam[2]


@njit(cache=True, nogil=True)
def _inverse_root(covariance: Array, n: int, root: Array) -> None:
    """Inverse of the lower Cholesky factor of the leading (n, n) block, in place; the rest of `root` is zero."""
    root[:] = 0.0
    lower = np.zeros((4, 4))
    for i in range(n):
        for j in range(i + 1):
            value = covariance[i, j]
            for k in range(j):
                value -= lower[i, k] * lower[j, k]
            lower[i, j] = np.sqrt(value) if i == j else value / lower[j, j]
    for j in range(n):
        root[j, j] = 1.0 / lower[j, j]
        for i in range(j + 1, n):
            value = 0.0
            for k in range(j, i):
                value -= lower[i, k] * root[k, j]
            root[i, j] = value / lower[i, i]


@njit(cache=True, nogil=True)
def _whitening_matrices(
    rotation: Array, position: Array, points: Array, covariances: Array, rays: Array, noise: Array, shape: Array
) -> Array:
    """(n, 4, 4): whitens a point's four residuals, of which the map's own error makes one piece."""
    roots = np.zeros((len(points), 4, 4))
    rows, turned, total = np.zeros((4, 3)), np.zeros((4, 3)), np.zeros((4, 4))
    for i in range(len(points)):
        point_cam = apply(rotation, points[i]) + position
        if point_cam[2] < DEPTH_MIN_M:
            continue
        projection_jacobian(point_cam, shape[0], shape[1], rows)
        for a in range(4):
            for k in range(3):
                turned[a, k] = rows[a, 0] * rotation[0, k] + rows[a, 1] * rotation[1, k] + rows[a, 2] * rotation[2, k]
        for a in range(4):
            for b in range(4):
                value = noise[i, a // 2, a % 2, b % 2] if a // 2 == b // 2 else 0.0
                for k in range(3):
                    for m in range(3):
                        value += turned[a, k] * covariances[i, k, m] * turned[b, m]
                total[a, b] = value
        _inverse_root(total, 2 if np.isnan(rays[i, 2]) else 4, roots[i])
    return roots


@njit(cache=True, nogil=True)
def white_rows(
    arm: Array, point_cam: Array, ray: Array, root: Array, shape: Array, rows: Array, slope: Array, white: Array
) -> None:
    """Whitened residuals white (4,) and Jacobian rows (4, 6) for R <- exp(w) R, t <- t + dt, in place; arm = R X."""
    projection_jacobian(point_cam, shape[0], shape[1], slope)
    n = 2 if np.isnan(ray[2]) else 4
    for a in range(4):
        white[a] = 0.0
        for k in range(6):
            rows[a, k] = 0.0
    for b in range(n):
        offset = shape[1] if b == 2 else 0.0
        place = point_cam[1] if b % 2 else point_cam[0] - offset
        residual = shape[0] * (place / point_cam[2] - ray[b])
        wx = arm[1] * slope[b, 2] - arm[2] * slope[b, 1]
        wy = arm[2] * slope[b, 0] - arm[0] * slope[b, 2]
        wz = arm[0] * slope[b, 1] - arm[1] * slope[b, 0]
        for a in range(b, n):
            weight = root[a, b]
            white[a] += weight * residual
            rows[a, 0] += weight * wx
            rows[a, 1] += weight * wy
            rows[a, 2] += weight * wz
            for k in range(3):
                rows[a, 3 + k] += weight * slope[b, k]


@njit(cache=True, nogil=True)
def normal_equations(
    rotation: Array, position: Array, points: Array, rays: Array, roots: Array, shape: Array, limit: float
) -> tuple[Array, Array, float, Array]:
    """Weighted J^T J, J^T r, cost, squared whitened residual per point. `limit`: points below it count fully, others
    not at all; negative: all count by the Cauchy weight of this size."""
    information, gradient, cost = np.zeros((6, 6)), np.zeros(6), 0.0
    squares = np.full(len(points), np.inf)
    rows, slope, white = np.zeros((4, 6)), np.zeros((4, 3)), np.zeros(4)
    for i in range(len(points)):
        arm = apply(rotation, points[i])
        point_cam = arm + position
        if point_cam[2] < DEPTH_MIN_M or roots[i, 0, 0] == 0.0:
            cost += 50.0
            continue
        white_rows(arm, point_cam, rays[i], roots[i], shape, rows, slope, white)
        square = white[0] ** 2 + white[1] ** 2 + white[2] ** 2 + white[3] ** 2
        squares[i] = square
        if limit > 0.0:
            weight = 1.0 if square < limit else 0.0
            cost += min(square, limit)
        else:
            weight = 1.0 / (1.0 - square / limit)
            cost -= limit * np.log1p(-square / limit)
        if weight == 0.0:
            continue
        for a in range(4):
            for j in range(6):
                scaled = weight * rows[a, j]
                gradient[j] += scaled * white[a]
                for k in range(j + 1):
                    information[j, k] += scaled * rows[a, k]
    for j in range(6):
        for k in range(j):
            information[k, j] = information[j, k]
    return information, gradient, cost, squares


@njit(cache=True, nogil=True)
def squared_residuals(
    rotation: Array, position: Array, points: Array, rays: Array, roots: Array, shape: Array
) -> Array:
    """Squared whitened residuals (n,) alone; infinite for a point behind the eye or left out."""
    squares = np.full(len(points), np.inf)
    for i in range(len(points)):
        point_cam = apply(rotation, points[i]) + position
        if point_cam[2] < DEPTH_MIN_M or roots[i, 0, 0] == 0.0:
            continue
        n, total = 2 if np.isnan(rays[i, 2]) else 4, 0.0
        for a in range(n):
            white = 0.0
            for b in range(a + 1):
                place = point_cam[1] if b % 2 else point_cam[0] - (shape[1] if b == 2 else 0.0)
                white += roots[i, a, b] * shape[0] * (place / point_cam[2] - rays[i, b])
            total += white * white
        squares[i] = total
    return squares


@njit(cache=True, nogil=True)
def minimise(
    rotation: Array, position: Array, points: Array, rays: Array, roots: Array, shape: Array, limit: float, rounds: int
) -> tuple[Array, Array, Array, Array]:
    """Levenberg-Marquardt from a pose: rotation, position, J^T J and squared residuals at the end; `limit` as above."""
    information, gradient, cost, squares = normal_equations(rotation, position, points, rays, roots, shape, limit)
    damping = 1e-4
    for _ in range(rounds):
        damped = information.copy()
        for k in range(6):
            damped[k, k] += damping * information[k, k] + 1e-6
        step = solve_positive(damped, -gradient)
        new_rotation, new_position = rotated_by_rotvec(rotation, step[:3]), position + step[3:]
        new = normal_equations(new_rotation, new_position, points, rays, roots, shape, limit)
        if new[2] <= cost:
            small = cost - new[2] < 1e-6 * cost
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


def stacked_rays(seen: StereoPoints) -> Array:
    """Rays (n, 4): x, y of the left eye, x, y of the right one."""
    return np.concatenate([seen.rays_left, seen.rays_right], axis=1)


@dataclass(frozen=True, slots=True)
class PoseProblem:
    """Points and observations near a start pose, ready for as many fits as are wanted.

    rays (n, 4); focal_and_baseline: [px], [m]; noise_factor: how many times noisier than assumed the images are.
    """

    points: Array
    rays: Array
    whitening_matrices: Array
    focal_and_baseline: Array
    noise_factor: float

    @property
    def limit(self) -> float:
        """Squared whitened residual below which a point is an inlier."""
        return INLIER_CHI2_MAX * max(self.noise_factor, 1.0) ** 2

    def without_points(self, points: NDArray[np.bool_]) -> "PoseProblem":
        """The same without some of the points (n,): they agree with no pose."""
        return replace(self, whitening_matrices=np.where(points[:, None, None], 0.0, self.whitening_matrices))

    def squares(self, T_cam_vo: Array, points: Array | None = None) -> Array:
        """Squared whitened residuals (n,) at a pose, of the problem's points or of others in their place (n, 3)."""
        rotation, position = np.ascontiguousarray(T_cam_vo[:3, :3]), np.ascontiguousarray(T_cam_vo[:3, 3])
        places = self.points if points is None else np.ascontiguousarray(points)
        return squared_residuals(
            rotation, position, places, self.rays, self.whitening_matrices, self.focal_and_baseline
        )


def pose_problem(T_cam_vo: Array, seen: StereoPoints) -> PoseProblem:
    """What a fit near `T_cam_vo` works with.

    Model:   C = sigma^2 I + P C_map P^T for the four coordinates of a point: the map's error is common to both eyes.
    """
    rays, points = stacked_rays(seen), np.ascontiguousarray(seen.points_vo)
    shape = np.array([seen.focal_px, seen.baseline_m])
    noise = (
        np.tile(np.eye(2), (len(points), 2, 1, 1))
        if seen.unit_noise_covariances is None
        else seen.unit_noise_covariances
    )
    rotation, position = np.ascontiguousarray(T_cam_vo[:3, :3]), np.ascontiguousarray(T_cam_vo[:3, 3])
    covariances = np.ascontiguousarray(seen.covariances_vo)
    roots = _whitening_matrices(rotation, position, points, covariances, rays, seen.sigma_px**2 * noise, shape)
    return PoseProblem(points, rays, roots, shape, row_factor(seen))


def row_factor(seen: StereoPoints) -> float:
    """How many times noisier than assumed the images are, 0.4 to 4, as the rows of both eyes show it.

    Model:   the rows of a point's two rays are equal whatever moves, so their difference, of sigma sqrt(2), is noise
             alone: median absolute deviation from zero. Residuals of a pose would take a second motion for noise.
    """
    apart = np.abs(seen.rays_left[:, 1] - seen.rays_right[:, 1]) * seen.focal_px
    apart = apart[np.isfinite(apart)]
    if len(apart) < INLIERS_MIN:
        return 1.0
    factor = float(np.median(apart)) / (NORMAL_MAD_SIGMAS * np.sqrt(2.0) * seen.sigma_px)
    return float(np.clip(factor, NOISE_FACTOR_MIN, NOISE_FACTOR_MAX))


def refine_camera(T_cam_vo: Array, seen: StereoPoints) -> PoseFit | None:
    """Robust pose of the camera from all points in both eyes; None where they do not determine it.

    Model:   min over T of sum of rho(r^T C^-1 r), r = the four coordinates of a point minus their prediction. rho
             Cauchy, LM with analytic Jacobian, left perturbation; then the inliers with full weight: r^T C^-1 r < 20
             times the square of `row_factor` where that is above 1. Covariance: (J^T C^-1 J)^-1 times the inliers' mean
             square, but not less than 0.16.
    Args:    T_cam_vo: start (4, 4), near enough for C. seen: points and observations.
    """
    problem = pose_problem(T_cam_vo, seen)
    return settled_pose(problem, *rough_pose(problem, T_cam_vo))


def rough_pose(problem: PoseProblem, T_cam_vo: Array) -> tuple[Array, Array]:
    """Rotation and position by the Cauchy cost of all points: the nearest of its minima."""
    rotation, position = np.ascontiguousarray(T_cam_vo[:3, :3]), np.ascontiguousarray(T_cam_vo[:3, 3])
    data = problem.points, problem.rays, problem.whitening_matrices, problem.focal_and_baseline
    found = minimise(
        rotation, position, *data, -CAUCHY_SCALE_SQUARED * max(problem.noise_factor, 1.0) ** 2, ITERATIONS_MAX
    )
    return found[0], found[1]


def settled_pose(problem: PoseProblem, rotation: Array, position: Array) -> PoseFit | None:
    """The fit of the inliers about a pose, at their full weight."""
    rays, limit = problem.rays, problem.limit
    data = problem.points, rays, problem.whitening_matrices, problem.focal_and_baseline
    rotation, position, information, squares = minimise(rotation, position, *data, limit, FINAL_ITERATIONS)
    inliers = np.asarray(squares < limit)
    if inliers.sum() < INLIERS_MIN or np.linalg.cond(information) > 1e14:
        return None
    n_coordinates = 4 * int(inliers.sum()) - 2 * int(np.isnan(rays[inliers, 2]).sum())
    mean_square = float(squares[inliers].sum() / max(n_coordinates - 6, 1))
    covariance = noise_factor(mean_square) ** 2 * np.linalg.inv(information)
    return PoseFit(
        T_cam_vo=pose(rotation, position),
        covariance=0.5 * (covariance + covariance.T),
        inliers=inliers,
        rms_sigma=float(np.sqrt(mean_square)),
        information=information,
        whitening_matrices=problem.whitening_matrices,
        squared_residuals=squares,
        inlier_limit=limit,
    )


def noise_factor(mean_square: float) -> float:
    """Noise over the assumed one from the mean square of whitened residuals."""
    return float(np.sqrt(max(mean_square, NOISE_FACTOR_MIN**2)))
