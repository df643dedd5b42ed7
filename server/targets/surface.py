"""The surface around a pixel: stereo samples, plane or curved patch, position and normal with covariance."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from machine.camera import undistort_to_rays
from machine.description import StereoCamera
from machine.poses import pose, pose_difference
from machine.rotations import rotation_about
from server.targets.contracts import BoolArray, PatchStatus, SurfacePatch, TargetSettings, refused_patch
from server.targets.stereo_match import coarse_disparity, fine_disparities, sample_places, texture_sigma_px
from server.vision.contracts import Array, Image
from server.vision.object_pose import fitted_variance
from server.vision.odometry_align import PATCH_CORRELATION_MIN, PATCH_HALF_PX, PATCH_SIZE_PX

CENTRE_WINDOW_HALF_PX = 20  # window of the first match: wide enough to be unique on natural texture
SAMPLE_WINDOW_HALF_PX = 7  # as the fine alignment's patch
DISPARITY_SLACK_PX = 8.0  # of a sample's disparity about the centre's: 45 deg of slope over 60 mm at 0.7 m
SURROUNDING_SAMPLES_MIN = 30  # samples around a hole: ten times a plane's unknowns
SATURATED_MIN_GREY = 254
RANSAC_ITERATIONS = 200  # finds a plane of 50 % inliers with a failure rate below 1e-9
OUTLIER_SIGMAS = 4.0
ON_SURFACE_MIN_FRAC = 0.75  # more than a quarter elsewhere: the patch covers two surfaces
F_TEST_CRITICAL_1PCT = 3.8  # F(3, 60..200) at 1 %: a curved patch must explain the residuals significantly better
CHI2_2_95, CHI2_1_95 = 5.991, 3.841
ROLL_SIGMA_RAD = float(np.deg2rad(0.01))  # the roll is a convention; no covariance may be singular
Shape = Literal["plane", "curved"]


@dataclass(frozen=True, slots=True)
class _DisparityFit:
    """disparity(u, v) about the pixel: coefficients, their covariance, samples on it, residual rms [px]."""

    coefficients: Array
    covariance: Array
    on_surface: BoolArray
    residual_px: float
    surface_shape: Shape


@dataclass(frozen=True, slots=True)
class _SurfaceQuery:
    """A raw left pixel of a raw pair whose surface is wanted; `label`: for the reasons."""

    left: Image
    right: Image
    camera: StereoCamera
    pixel: tuple[float, float]
    settings: TargetSettings
    label: str

    @property
    def ray(self) -> Array:
        return undistort_to_rays(self.camera, np.array([self.pixel]))[0]

    def refused(self, status: PatchStatus, reason: str) -> SurfacePatch:
        return refused_patch(status, f"{self.label}{reason}", self.pixel)


def measure_patch(
    left: Image, right: Image, camera: StereoCamera, pixel: tuple[float, float], settings: TargetSettings
) -> SurfacePatch:
    """Position and normal of the surface that a raw left pixel shows.

    Model:   disparities of a grid of samples, d(u, v) = a + b u + c v (a plane, exactly), or with u^2, uv, v^2 where
             an F test at 1 % asks for them. Z = f B / d; the normal follows from the gradient at the pixel. The patch
             grows until the normal's 95 % uncertainty fits.
    Args:    left, right: raw grey pair (h, w). pixel: (u, v) [px], raw left image.
    Returns: SurfacePatch; refused ones say what is wrong, by how much, and what would help.
    """
    place = _SurfaceQuery(left, right, camera, pixel, settings, f"Patch at ({pixel[0]:.0f}, {pixel[1]:.0f}) px")
    problem = _image_problem(place)
    if problem is not None:
        return problem
    bf = camera.fx_px * camera.baseline_m
    coarse = coarse_disparity(
        camera, left, right, place.ray, CENTRE_WINDOW_HALF_PX, (bf / settings.depth_max_m, bf / settings.depth_min_m)
    )
    if coarse.correlation < 0.0:
        return place.refused(PatchStatus.NO_TEXTURE, " has no texture; choose a rougher place or add light")
    found = place.refused(PatchStatus.NO_TEXTURE, "")
    for radius_m in settings.radii_m:
        larger = _measure_at_disparity(place, coarse.disparity_px, radius_m)
        if found.ok and not larger.ok:
            break  # the smaller patch lies on one surface, the larger one reaches beyond it
        found = larger
        if found.status not in (PatchStatus.OK, PatchStatus.TOO_FAR, PatchStatus.NO_TEXTURE):
            break
        if found.covariance is not None and uncertainty_95(found.covariance)[0] <= settings.normal_wanted_deg:
            break
    if coarse.is_unique or found.status is PatchStatus.NO_TEXTURE:
        return found
    if coarse.correlation < PATCH_CORRELATION_MIN and not found.ok:
        return place.refused(
            PatchStatus.DEPTH_EDGE,
            f" covers a depth edge: no single depth explains it (correlation {coarse.correlation:.2f}, limit "
            f"{PATCH_CORRELATION_MIN:.2f}); choose a place farther from the edge",
        )
    return place.refused(
        PatchStatus.REPEATED_TEXTURE,
        f" repeats along the row: dissimilarity of the best to the second-best match {coarse.dissimilarity_ratio:.2f} "
        "(limit 0.80); choose a place whose texture differs from its neighbours",
    )


def measure_surface_around(
    left: Image,
    right: Image,
    camera: StereoCamera,
    pixel: tuple[float, float],
    depth_m: float,
    avoid: Sequence[tuple[float, float, float]],
    settings: TargetSettings,
) -> SurfacePatch:
    """The surface around a hole whose rim is depth_m away: as `measure_patch`, from samples outside the discs
    (u, v, radius) [px] to avoid."""
    place = _SurfaceQuery(left, right, camera, pixel, settings, f"Surface around ({pixel[0]:.0f}, {pixel[1]:.0f}) px")
    found = place.refused(PatchStatus.NO_TEXTURE, " was not measured")
    for radius_m in settings.radii_m:
        radius_px = radius_m * camera.fx_px / depth_m
        if (
            len(sample_places(left.shape, pixel, radius_px, avoid)[0]) < SURROUNDING_SAMPLES_MIN
            and radius_m < settings.radii_m[-1]
        ):
            continue
        found = _measure_at_disparity(place, camera.fx_px * camera.baseline_m / depth_m, radius_m, avoid)
        if found.covariance is not None and uncertainty_95(found.covariance)[0] <= settings.normal_wanted_deg:
            break
    return found


def _image_problem(place: _SurfaceQuery) -> SurfacePatch | None:
    (u, v), (height, width) = place.pixel, place.left.shape
    margin = min(u, v, width - 1 - u, height - 1 - v)
    if not margin >= CENTRE_WINDOW_HALF_PX:
        reason = (
            f" lies {margin:.0f} px from the image border (limit {CENTRE_WINDOW_HALF_PX} px); turn the camera to it"
        )
        return place.refused(PatchStatus.OUTSIDE_IMAGE, reason)
    top, left = round(v) - CENTRE_WINDOW_HALF_PX, round(u) - CENTRE_WINDOW_HALF_PX
    window = place.left[top : top + 2 * CENTRE_WINDOW_HALF_PX + 1, left : left + 2 * CENTRE_WINDOW_HALF_PX + 1]
    clipped, limit = float(np.mean(window >= SATURATED_MIN_GREY)), place.settings.clipped_max_frac
    if clipped > limit:
        return place.refused(
            PatchStatus.GLARE,
            f" is over-exposed: {100 * clipped:.0f} % of its pixels are clipped (limit {100 * limit:.0f} %); shade it "
            "or lower the exposure",
        )
    return None


def _measure_at_disparity(
    place: _SurfaceQuery, disparity_px: float, radius_m: float, avoid: Sequence[tuple[float, float, float]] = ()
) -> SurfacePatch:
    camera, settings, ray = place.camera, place.settings, place.ray
    depth_m = camera.fx_px * camera.baseline_m / disparity_px
    radius_px = max(radius_m * camera.fx_px / depth_m, PATCH_SIZE_PX / 2.0)
    samples, wanted = sample_places(place.left.shape, place.pixel, radius_px, avoid)
    if len(samples) < ON_SURFACE_MIN_FRAC * wanted:
        reason = f": its surroundings of {1e3 * radius_m:.0f} mm leave the image; turn the camera to it"
        return place.refused(PatchStatus.OUTSIDE_IMAGE, reason)
    rays = undistort_to_rays(camera, samples)
    uv = (rays - ray) * [camera.fx_px, camera.fy_px]
    limits = disparity_px - DISPARITY_SLACK_PX, disparity_px + DISPARITY_SLACK_PX
    coarse = [coarse_disparity(camera, place.left, place.right, ray, SAMPLE_WINDOW_HALF_PX, limits) for ray in rays]
    guess = np.array([found.disparity_px for found in coarse])
    usable = np.isfinite(guess)
    sigma_texture = texture_sigma_px(place.left, place.pixel, radius_px)
    sigma_depth_m = depth_m**2 / (camera.fx_px * camera.baseline_m) * sigma_texture
    if sigma_depth_m * np.sqrt(CHI2_1_95) > settings.position_max_m or usable.mean() < ON_SURFACE_MIN_FRAC:
        return place.refused(
            PatchStatus.NO_TEXTURE,
            f" has too little texture: it would give the depth to {2e3 * sigma_depth_m:.1f} mm (limit "
            f"{1e3 * settings.position_max_m:.1f} mm); choose a rougher place, add light or come nearer",
        )
    per_sample_px = (
        sigma_texture * np.sqrt(np.pi) * radius_px / PATCH_SIZE_PX
    )  # the bound of one sample's smaller patch
    sampled = replace(settings, sigma_px=float(np.hypot(per_sample_px, settings.sigma_floor_px)))
    fit, good = _match_and_fit_surface(replace(place, settings=sampled), samples, uv, guess, radius_px)
    if fit is None or good.mean() < ON_SURFACE_MIN_FRAC:
        return place.refused(
            PatchStatus.NOT_IN_BOTH_EYES,
            f": only {100 * good.mean():.0f} % of it is found in the right eye (limit "
            f"{100 * ON_SURFACE_MIN_FRAC:.0f} %); move so that both eyes see it, or clear what covers it",
        )
    share = float(fit.on_surface.sum() / good.sum())
    if share < ON_SURFACE_MIN_FRAC:
        return place.refused(
            PatchStatus.DEPTH_EDGE,
            f" covers a depth edge: {100 * share:.0f} % of it lies on one surface (limit "
            f"{100 * ON_SURFACE_MIN_FRAC:.0f} %); choose a place farther from the edge",
        )
    coherent = settings.sigma_floor_px * np.array([1.0, 1.0 / radius_px, 1.0 / radius_px])
    fit.covariance[:3, :3] += np.diag(coherent**2)  # interpolation errs alike where the sub-pixel phase is alike
    return _judge_patch(place, fit, samples, uv, radius_m)


def _match_and_fit_surface(
    place: _SurfaceQuery, samples: Array, uv: Array, guess: Array, radius_px: float
) -> tuple[_DisparityFit | None, BoolArray]:
    """Fine disparities by the plane of the coarse ones, then the surface through them."""
    start = _robust_plane(uv, guess)
    good = np.zeros(len(samples), dtype=bool)
    fit: _DisparityFit | None = None
    for _ in range(2):  # the second time with the slopes of the first
        expected = _polynomial_terms(uv, "plane") @ start
        near = np.abs(guess - expected) < 2.0  # a coarse match is good to a pixel; else the neighbours' surface
        slopes = np.tile(start[1:3], (len(uv), 1))
        found = fine_disparities(
            place.camera, place.left, place.right, samples, np.where(near, expected, guess), slopes
        )
        good = found.valid
        if good.sum() < 12:
            return None, good
        fit = _fit_surface(uv, found.disparity_px, good, radius_px, place.settings)
        start = fit.coefficients[:3]
    return fit, good


def _polynomial_terms(uv: Array, shape: Shape) -> Array:
    u, v = uv[:, 0], uv[:, 1]
    columns = [np.ones(len(uv)), u, v]
    return np.column_stack(columns if shape == "plane" else [*columns, u * u, u * v, v * v])


def _robust_plane(uv: Array, disparity: Array) -> Array:
    """Least median of squares over random triples, then least squares on what lies within a pixel (3,)."""
    known = np.flatnonzero(np.isfinite(disparity))
    A, d = _polynomial_terms(uv[known], "plane"), disparity[known]
    rng = np.random.default_rng(0)
    best, best_median = np.array([float(np.median(d)), 0.0, 0.0]), np.inf
    for _ in range(RANSAC_ITERATIONS):
        three = rng.choice(len(known), 3, replace=False)
        if abs(np.linalg.det(A[three])) < 1.0:
            continue
        plane = np.linalg.solve(A[three], d[three])
        median = float(np.median(np.abs(A @ plane - d)))
        if median < best_median:
            best, best_median = plane, median
    close = np.abs(A @ best - d) < 1.0
    if close.sum() >= 6:
        best = np.linalg.lstsq(A[close], d[close], rcond=None)[0]
    return np.asarray(best, dtype=np.float64)


def _fit_surface(
    uv: Array, disparity: Array, good: BoolArray, radius_px: float, settings: TargetSettings
) -> _DisparityFit:
    """Plane, or curved patch where the F test asks for it; samples off the surface are left out.

    The samples' patches overlap: n of them hold only the patch area's worth of independent ones, and the covariance is
    scaled by that ratio.
    """
    area = np.pi * (radius_px + PATCH_HALF_PX) ** 2
    overlap = max(1.0, float(good.sum()) * PATCH_SIZE_PX**2 / area)
    on = good.copy()
    plane = _least_squares(uv, disparity, on, "plane", settings, overlap)
    on = good & (np.abs(_polynomial_terms(uv, "plane") @ plane.coefficients - disparity) < _limit_px(plane, settings))
    plane = _least_squares(uv, disparity, on, "plane", settings, overlap)
    curved_on = good & (
        np.abs(_polynomial_terms(uv, "plane") @ plane.coefficients - disparity) < 2.0 * _limit_px(plane, settings)
    )
    if curved_on.sum() < 20:
        return plane
    curved = _least_squares(uv, disparity, curved_on, "curved", settings, overlap)
    same = _least_squares(uv, disparity, curved_on, "plane", settings, overlap)
    n_free = max(curved_on.sum() / overlap - 6.0, 1.0)
    gain = (same.residual_px**2 - curved.residual_px**2) * curved_on.sum() / overlap / 3.0
    if gain / max(curved.residual_px**2 * curved_on.sum() / overlap / n_free, 1e-12) < F_TEST_CRITICAL_1PCT:
        return plane
    return curved


def _limit_px(fit: _DisparityFit, settings: TargetSettings) -> float:
    return OUTLIER_SIGMAS * max(fit.residual_px, settings.sigma_px)


def _least_squares(
    uv: Array, disparity: Array, on: BoolArray, shape: Shape, settings: TargetSettings, overlap: float
) -> _DisparityFit:
    A, d = _polynomial_terms(uv[on], shape), disparity[on]
    scale = np.abs(A).max(axis=0)  # columns of one magnitude: the normal equations stay well conditioned
    for _ in range(3):
        found = np.linalg.lstsq(A / scale, d, rcond=None)[0]
        residuals = A / scale @ found - d
        limit = OUTLIER_SIGMAS * max(1.4826 * float(np.median(np.abs(residuals))), settings.sigma_px)
        kept = np.abs(residuals) < limit
        if kept.all() or kept.sum() < 12:
            break
        indices = np.flatnonzero(on)
        on = np.zeros_like(on)
        on[indices[kept]] = True
        A, d = A[kept], d[kept]
    found = np.linalg.lstsq(A / scale, d, rcond=None)[0]
    residuals = A / scale @ found - d
    dof = max(int(len(d) / overlap) - A.shape[1], 1)
    variance = fitted_variance(float(np.sum(residuals**2)) / overlap, dof, settings.sigma_px) * overlap
    covariance = variance * np.linalg.inv((A / scale).T @ (A / scale)) / np.outer(scale, scale)
    return _DisparityFit(found / scale, covariance, on, float(np.sqrt(np.mean(residuals**2))), shape)


def target_frame(normal: Array, origin: Array) -> Array:
    """T_cam_target (4, 4): z along the normal, x to the right of the image, y up."""
    z = normal / np.linalg.norm(normal)
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    return pose(np.array([x, np.cross(z, x), z], dtype=np.float64).T, origin)


def _frame_of(camera: StereoCamera, ray: Array, abc: Array) -> Array:
    """T_cam_target from the disparity and its slopes at the ray.

    Model:   B / Z = alpha + beta x + gamma y on a plane, so its normal is (beta, gamma, alpha), here towards the eye.
    """
    scale = np.array([1.0 / camera.fx_px, 1.0, camera.fy_px / camera.fx_px])
    delta, beta, gamma = abc * scale
    alpha = delta - beta * ray[0] - gamma * ray[1]
    origin = np.append(ray, 1.0) * camera.baseline_m / delta
    return target_frame(-np.array([beta, gamma, alpha]), origin)


def _judge_patch(place: _SurfaceQuery, fit: _DisparityFit, samples: Array, uv: Array, radius_m: float) -> SurfacePatch:
    camera, settings, abc = place.camera, place.settings, fit.coefficients[:3]
    T = _frame_of(camera, place.ray, abc)
    covariance = _pose_covariance(place, abc, fit.covariance[:3, :3], T)
    view = T[:3, 3] / np.linalg.norm(T[:3, 3])
    oblique_deg = float(np.rad2deg(np.arccos(np.clip(-view @ T[:3, 2], -1.0, 1.0))))
    if oblique_deg > settings.oblique_max_deg:
        return place.refused(
            PatchStatus.TOO_OBLIQUE,
            f" is seen too obliquely: {oblique_deg:.0f} deg off its normal (limit {settings.oblique_max_deg:.0f} deg); "
            "face it more squarely",
        )
    normal_deg, depth_m = uncertainty_95(covariance)
    if normal_deg > settings.normal_max_deg or depth_m > settings.position_max_m:
        return place.refused(
            PatchStatus.TOO_FAR,
            f" at {T[2, 3]:.2f} m is known to {normal_deg:.1f} deg (limit {settings.normal_max_deg:.1f} deg) and "
            f"{1e3 * depth_m:.1f} mm (limit {1e3 * settings.position_max_m:.1f} mm) only; come nearer",
        )
    on = fit.on_surface
    disparity = _polynomial_terms(uv[on], fit.surface_shape) @ fit.coefficients
    rays = undistort_to_rays(camera, samples[on])
    points = np.column_stack([rays, np.ones(len(rays))]) * (camera.fx_px * camera.baseline_m / disparity)[:, None]
    n_used, residual_px = int(on.sum()), fit.residual_px
    return SurfacePatch(
        PatchStatus.OK,
        "",
        place.pixel,
        T,
        covariance,
        samples[on],
        points,
        radius_m,
        fit.surface_shape,
        n_used,
        residual_px,
    )


def with_roll(patch: SurfacePatch, roll_rad: float) -> SurfacePatch:
    """The same place, turned about its normal: positive turns x towards y."""
    if patch.T_cam_target is None or roll_rad == 0.0:
        return patch
    return replace(patch, T_cam_target=patch.T_cam_target @ pose(rotation_about("z", roll_rad), np.zeros(3)))


def uncertainty_95(covariance: Array) -> tuple[float, float]:
    """Half axes at 95 %: tilt of the normal [deg] (two degrees of freedom), position along its worst axis [m] (one)."""
    tilt = np.sqrt(CHI2_2_95 * np.linalg.eigvalsh(covariance[:3, :3])[-1])
    place = np.sqrt(CHI2_1_95 * np.linalg.eigvalsh(covariance[3:, 3:])[-1])
    return float(np.rad2deg(tilt)), float(place)


def _pose_covariance(place: _SurfaceQuery, abc: Array, C_abc: Array, T: Array) -> Array:
    """First-order covariance (6, 6) of the pose; the pixel is exact, so across the ray only the alignment's noise."""
    J = np.zeros((6, 3))
    for k, step in enumerate(np.array([1e-3, 1e-6, 1e-6])):
        moved = abc.copy()
        moved[k] += step
        J[:, k] = pose_difference(T, _frame_of(place.camera, place.ray, moved)) / step
    C = J @ C_abc @ J.T
    C[:3, :3] += ROLL_SIGMA_RAD**2 * np.eye(3)
    C[3:, 3:] += (place.settings.sigma_px * T[2, 3] / place.camera.fx_px) ** 2 * np.eye(3)
    return 0.5 * (C + C.T)
