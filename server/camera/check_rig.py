"""Do the two eyes still stand as calibrated? By the rows of matched spots: pitch, roll, focal ratio. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from machine.camera import undistort_to_rays
from machine.description import StereoCamera
from machine.rotations import Array
from server.camera.check_findings import CheckFinding, Level, level_by_limits
from server.vision.contracts import Image
from server.vision.odometry_features import clear_matches

SIFT_FEATURES_MAX = 1500
MATCH_RATIO_MAX = 0.75  # of the best match's distance to the second best's
ROW_OFFSET_MAX_FRAC = 0.15  # of the height: a rig off by more shows in no sensible picture
KLT_WINDOW_PX = 15
REFINEMENT_SHIFT_MAX_PX = 2.5
FEATURES_MIN = 8


def match_eyes(left: Image, right: Image) -> Array:
    """Matched spots (n, 4): u, v in the left eye, u, v in the right [raw px], to about 0.05 px.

    Model:   SIFT at half size, best match both ways and clearly better than the second; then the right eye's place is
             refined by Lucas and Kanade's alignment of the patch at full size, once in each direction.
    """
    finder = cv2.SIFT.create(nfeatures=SIFT_FEATURES_MAX, contrastThreshold=0.02)
    keys_left, words_left = finder.detectAndCompute(_half_size_image(left), None)
    keys_right, words_right = finder.detectAndCompute(_half_size_image(right), None)
    if len(keys_left) < FEATURES_MIN or len(keys_right) < FEATURES_MIN:
        return np.zeros((0, 4))
    there, back = _descriptor_matches(words_left, words_right), _descriptor_matches(words_right, words_left)
    pairs = [(i, j) for i, j in there.items() if back.get(j) == i]
    if len(pairs) < FEATURES_MIN:
        return np.zeros((0, 4))
    from_px = _full_px([keys_left[i].pt for i, _ in pairs])
    to_px = _full_px([keys_right[j].pt for _, j in pairs])
    near = np.abs(from_px[:, 1] - to_px[:, 1]) < ROW_OFFSET_MAX_FRAC * left.shape[0]
    return _refined_matches(left, right, from_px[near], to_px[near])


def _half_size_image(image: Image) -> Image:
    return np.asarray(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)


def _full_px(half_px: Sequence[Sequence[float]]) -> np.ndarray:
    """From the halved picture's pixels to the whole one's: a pixel's edges scale, not its centre."""
    return (2.0 * (np.array(half_px, np.float32) + 0.5) - 0.5).astype(np.float32)


def _descriptor_matches(words: np.ndarray, others: np.ndarray) -> dict[int, int]:
    """Index of the clearly nearest other word."""
    return {match.queryIdx: match.trainIdx for match in clear_matches(words, others, cv2.NORM_L2, MATCH_RATIO_MAX)}


def _refined_matches(left: Image, right: Image, from_px: np.ndarray, to_px: np.ndarray) -> Array:
    if not len(from_px):
        return np.zeros((0, 4))
    there, good = _track_points(left, right, from_px, to_px)
    back, also = _track_points(right, left, there, from_px)
    kept = (
        good
        & also
        & (np.linalg.norm(there - to_px, axis=1) < REFINEMENT_SHIFT_MAX_PX)
        & (np.linalg.norm(back - from_px, axis=1) < 0.3)
    )
    return np.hstack([from_px[kept], there[kept]]).astype(float)


def _track_points(one: Image, other: Image, at: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found, good, _ = cv2.calcOpticalFlowPyrLK(
        np.ascontiguousarray(one),
        np.ascontiguousarray(other),
        at.reshape(-1, 1, 2),
        start.copy().reshape(-1, 1, 2),
        winSize=(KLT_WINDOW_PX, KLT_WINDOW_PX),
        maxLevel=0,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.005),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return found.reshape(-1, 2), good.ravel().astype(bool)


MATCHES_MIN = 60
COVERED_CELLS_MIN = 6  # of 12 cells of the picture that must hold spots
INLIER_MAX_PX = 1.5
RANSAC_ITERATIONS = 400
INLIERS_MIN_FRAC = 0.4
SWAPPED_SHARE, PARALLEL_PX = 0.8, 1.0
HUBER_SIGMAS = 1.5
INDEPENDENT_MATCHES = 40
SIGNIFICANCE_SIGMAS = 4.0
OFFSET_WARN_PX, OFFSET_FAIL_PX = 0.5, 1.5
SPREAD_WARN_PX, SPREAD_FAIL_PX = 0.6, 2.0
# What the rows can show of a rig, in the order of the fit, with what is believed of each before [rad or 1].
RIG_ERROR_TERMS = ("pitch", "roll", "focal", "yaw", "up", "ahead", "lens")
RIG_ERROR_PRIOR_SIGMAS = np.array([0.1, 0.1, 0.05, 0.01, 0.003, 0.003, 0.3])
RIG_ERROR_SIGMA_FLOORS = np.array(
    [1e-4, 1e-4, 1e-4, 0.0, 0.0, 0.0, 0.0]
)  # matching is not better than 0.05 px over the whole picture


@dataclass(frozen=True, slots=True, eq=False)
class RigFit:
    """The right eye against the left by the rows of both, beyond what the calibration says.

    `pitch_rad`, `roll_rad`: rotation about x and z that takes points of the calibrated right eye's frame to the true
    one's. `focal_ratio`: right to left. `pitch_roll_focal_sigma`: of these three. `row_px`, `spread_px`: median row
    difference right minus left before the fit, and robust spread after it. `k1_error` +- `lens_sigma`: by which the
    lens model's k1 is off.
    A yaw is fitted, so that nothing else is blamed, but not reported: remains of a real lens look like 0.5 deg of it.
    The scale of known markers shows a real one.
    """

    pitch_rad: float
    roll_rad: float
    focal_ratio: float
    pitch_roll_focal_sigma: Array
    row_px: float
    spread_px: float
    k1_error: float
    lens_sigma: float
    lens_effect_px: float
    n_spots: int


def rays_of(camera: StereoCamera, spots: Sequence[Array]) -> Array:
    """Undistorted rays (n, 4) of matched spots (n, 4) [raw px] of one or more pairs."""
    flat = np.vstack([np.zeros((0, 4)), *spots])
    return np.hstack([undistort_to_rays(camera, flat[:, :2]), undistort_to_rays(camera, flat[:, 2:])])


def _row_difference_jacobian(camera: StereoCamera, rays: Array) -> Array:
    """d(row difference) / d(term), (n, 7) [px]; first order.

    Model:   right eye turned by small w and moved by b (0, up, ahead), its focal length (1 + focal) times the left's:
             y_r - y_l = -pitch (1 + y^2) + roll x + focal y + yaw x y - up D + ahead y D + lens y (x_r^2 - x_l^2),
             x, y: the right ray, D = x_l - x_r.
    """
    x_left, x, y = rays[:, 0], rays[:, 2], 0.5 * (rays[:, 1] + rays[:, 3])
    D = x_left - x
    columns = [-(1.0 + y * y), x, y, x * y, -D, y * D, y * (x * x - x_left * x_left)]
    return camera.fy_px * np.stack(columns, axis=1)


def _row_px(camera: StereoCamera, rays: Array) -> Array:
    return camera.fy_px * (rays[:, 3] - rays[:, 1])


def _ransac_inliers(rows: Array, design: Array, rng: np.random.Generator) -> np.ndarray:
    """Spots that agree on pitch, roll and focal ratio (random samples of three)."""
    best = np.zeros(len(rows), bool)
    for _ in range(RANSAC_ITERATIONS):
        chosen = rng.choice(len(rows), 3, replace=False)
        A = design[chosen][:, :3]
        if abs(np.linalg.det(A)) < 1e-3 * np.prod(np.linalg.norm(A, axis=1)):
            continue
        near = np.abs(rows - design[:, :3] @ np.linalg.solve(A, rows[chosen])) < INLIER_MAX_PX
        if near.sum() > best.sum():
            best = near
    return best


def fit_rig(camera: StereoCamera, rays: Array, rng: np.random.Generator) -> RigFit | None:
    """Robust fit; None when the spots do not agree on any rig.

    Args:    rays: (n, 4), of one or more pairs.
    Model:   minimum of Huber's loss over the row differences with weak priors P; covariance
             (A^T W A / s^2 * m / n + P)^-1, m of the n spots counting as independent. Their errors are alike over wide
             parts of the picture (slant, texture, compression), and the same in every pair of a still scene: taken as
             independent, a good rig's yaw came out 5 sigma off.
    """
    rows, design = _row_px(camera, rays), _row_difference_jacobian(camera, rays)
    kept = _ransac_inliers(rows, design, rng)
    if kept.sum() < INLIERS_MIN_FRAC * len(rows) or kept.sum() < MATCHES_MIN:
        return None
    A, r = design[kept], rows[kept]
    theta, weights, scale = np.zeros(len(RIG_ERROR_TERMS)), np.ones(len(r)), 0.3
    for _ in range(20):
        information = (A * weights[:, None]).T @ A / scale**2 + np.diag(RIG_ERROR_PRIOR_SIGMAS**-2.0)
        theta = np.linalg.solve(information, (A * weights[:, None]).T @ r / scale**2)
        rest = r - A @ theta
        scale = max(1.4826 * float(np.median(np.abs(rest - np.median(rest)))), 0.03)
        weights = np.minimum(1.0, HUBER_SIGMAS * scale / np.maximum(np.abs(rest), 1e-12))
    independent = min(1.0, INDEPENDENT_MATCHES / len(r))
    information = (A * weights[:, None]).T @ A / scale**2 * independent + np.diag(RIG_ERROR_PRIOR_SIGMAS**-2.0)
    sigma = np.sqrt(np.diag(np.linalg.inv(information)) + RIG_ERROR_SIGMA_FLOORS**2)
    return RigFit(
        pitch_rad=float(theta[0]),
        roll_rad=float(theta[1]),
        focal_ratio=1.0 + float(theta[2]),
        pitch_roll_focal_sigma=sigma[:3],
        row_px=float(np.median(rows[kept])),
        spread_px=scale,
        k1_error=float(theta[6]),
        lens_sigma=float(sigma[6]),
        lens_effect_px=float(np.sqrt(np.mean((A[:, 6] * theta[6]) ** 2))),
        n_spots=int(kept.sum()),
    )


def check_rig(camera: StereoCamera, spots: Sequence[Array], rng: np.random.Generator) -> list[CheckFinding]:
    """Findings `eyes` (swapped or not), then `rows`, `pitch`, `roll`, `focal_ratio`, `lens`.

    Args:    camera: what the pictures are said to be. spots: matched spots (n, 4) [raw px] of each pair.
    """
    rays = rays_of(camera, spots)
    if (
        len(rays) < MATCHES_MIN
        or _covered_cell_count(camera, np.vstack([np.zeros((0, 4)), *spots])) < COVERED_CELLS_MIN
    ):
        text = (
            f"{len(rays)} spots matched between the eyes, too few or too close together: the rig check is inconclusive"
        )
        remedy = "point it at a scene with texture all over the picture, 0.5 to 3 m away, and light it"
        return [CheckFinding("eyes", Level.WARN, text, remedy, {"spots": float(len(rays))})]
    disparity_px = camera.fx_px * (rays[:, 0] - rays[:, 2])
    eyes = _swapped_eyes(disparity_px)
    if eyes.level is Level.FAIL:
        return [eyes]
    fit = fit_rig(camera, rays, rng)
    if fit is None:
        text = "the rows of the two eyes fit no rig at all"
        remedy = (
            "check that both pictures are of one moment, one camera and one size, and that this calibration is theirs"
        )
        return [eyes, CheckFinding("rows", Level.FAIL, text, remedy)]
    return [eyes, _row_difference_finding(fit), *_pitch_roll_focal_findings(camera, fit), _lens_distortion_finding(fit)]


def _covered_cell_count(camera: StereoCamera, spots: Array) -> int:
    columns = np.clip(spots[:, 0] * 4 / camera.width_px, 0, 3).astype(int)
    rows = np.clip(spots[:, 1] * 3 / camera.height_px, 0, 2).astype(int)
    return len(np.unique(4 * rows + columns))


def _swapped_eyes(disparity_px: Array) -> CheckFinding:
    median = float(np.median(disparity_px))
    figures = {"disparity_median_px": median, "spots": float(len(disparity_px))}
    if float(np.mean(disparity_px < -PARALLEL_PX)) >= SWAPPED_SHARE:
        text = f"disparity is {median:.0f} px: left and right eye are swapped"
        return CheckFinding("eyes", Level.FAIL, text, "exchange the two pictures (or cables)", figures)
    if float(np.mean(disparity_px < -PARALLEL_PX)) > 1.0 - SWAPPED_SHARE:
        text = f"disparity has both signs (median {median:.0f} px): one eye is turned inwards or outwards"
        return CheckFinding("eyes", Level.FAIL, text, "load this camera's calibration, or calibrate the rig", figures)
    return CheckFinding(
        "eyes", Level.OK, f"in order; {len(disparity_px)} spots, disparity {median:.0f} px", "", figures
    )


def _row_difference_finding(fit: RigFit) -> CheckFinding:
    level = level_by_limits(fit.spread_px, SPREAD_WARN_PX, SPREAD_FAIL_PX)
    text = f"differ by {fit.row_px:+.2f} px (median), spread {fit.spread_px:.2f} px after the fit, {fit.n_spots} spots"
    remedy = "" if level is Level.OK else "expose both eyes simultaneously; check that the calibration is this camera's"
    figures = {"row_median_px": fit.row_px, "row_spread_px": fit.spread_px}
    return CheckFinding("rows", level, text, remedy, figures)


def _pitch_roll_focal_findings(camera: StereoCamera, fit: RigFit) -> list[CheckFinding]:
    """Each of the three as an angle or ratio, judged by what it moves in the picture, and only when it is certain."""
    off, deg = fit.focal_ratio - 1.0, float(np.rad2deg(1.0))
    half_width, half_height = 0.5 * camera.width_px, 0.5 * camera.height_px
    rows = (
        ("pitch", fit.pitch_rad, deg, "deg", fit.pitch_rad * camera.fy_px, "everywhere"),
        ("roll", fit.roll_rad, deg, "deg", fit.roll_rad * half_width, "at the sides"),
        ("focal_ratio", off, 100.0, "%", off * half_height, "at top and bottom"),
    )
    findings = []
    for (name, raw, factor, unit, effect_px, where), raw_sigma in zip(rows, fit.pitch_roll_focal_sigma, strict=True):
        value, sigma = factor * raw, factor * float(raw_sigma)
        certain = abs(value) > SIGNIFICANCE_SIGMAS * sigma
        level = level_by_limits(abs(effect_px), OFFSET_WARN_PX, OFFSET_FAIL_PX) if certain else Level.OK
        text = f"right eye against left {value:+.3f} +- {sigma:.3f} {unit}: {abs(effect_px):.1f} px {where}"
        remedy = f"the rig was bumped ({name}) or this is another camera's file: calibrate it again"
        key = f"{name}_{'pct' if unit == '%' else unit}"
        figures = {key: value, f"{key}_sigma": sigma, "effect_px": effect_px}
        findings.append(CheckFinding(name, level, text, "" if level is Level.OK else remedy, figures))
    return findings


def _lens_distortion_finding(fit: RigFit) -> CheckFinding:
    certain = abs(fit.k1_error) > SIGNIFICANCE_SIGMAS * fit.lens_sigma
    level = level_by_limits(fit.lens_effect_px, OFFSET_WARN_PX, OFFSET_FAIL_PX) if certain else Level.OK
    text = f"k1 off by {fit.k1_error:+.3f} +- {fit.lens_sigma:.3f}: {fit.lens_effect_px:.1f} px"
    remedy = "raw pictures are taken as rectified ones or the reverse, or it is another lens: give the right file"
    figures = {"k1": fit.k1_error, "k1_sigma": fit.lens_sigma}
    return CheckFinding("lens", level, text, "" if level is Level.OK else remedy, figures)
