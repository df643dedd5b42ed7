"""Finds an anchored target in a later pair: surroundings recognised, aligned, and the patch compared with them."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from machine.camera import project_stereo, projection_jacobian, undistort_to_rays
from machine.description import StereoCamera
from machine.poses import moved_pose, transform_points
from machine.rotations import skew, skew_matrices
from server.targets.contracts import AnchoredTarget, BoolArray, Landmarks, TargetFix, TargetSettings, no_fix
from server.vision.contracts import Array, Image
from server.vision.object_pose import fitted_variance
from server.vision.odometry_align import align_reference_patches
from server.vision.odometry_features import allowed_masks, inside_mask, recognise
from server.vision.odometry_pose import ransac_pose
from server.vision.odometry_sight import optical_flow

FIX_LANDMARKS_MIN = 12  # landmarks in both eyes: half of them may be wrong, and six still overdetermine the pose
LANDMARKS_FOUND_MIN_FRAC = 0.3  # of the visible landmarks: fewer, and the surroundings are not those of the reference
PATCH_AGREEMENT_MIN_FRAC = 0.75  # of the visible patch samples, as for the first measurement
PATCH_MIDDLE_RADIUS_M = 0.045  # radius of what the operator pointed at: half of a tool's width
VISIBLE_SAMPLES_MIN = 5  # patch samples: fewer visible ones cannot outvote a wrong one
TARGET_MOVED_SIGMAS = 3.0
TARGET_MOVED_MIN_M = 0.001  # a look calls 1 mm rest
PATCH_AREA_RATIO_MAX = 2.5  # of a patch against its reference: beyond, the images are compared at half size
PATCH_AREA_RATIO_MIN = 0.4
PYRAMID_LEVELS = 3
PNP_INLIER_MAX_PX = 3.0
TUKEY_SIGMAS = 4.685
STEPS, STEP_MIN = 8, 1e-7  # rad and m: a hundredth of what noise moves
DEPTH_MIN_M = 0.05


@dataclass(frozen=True, slots=True)
class SearchedPair:
    """A raw pair in which landmarks are looked for: grey (h, w), and 255 in the masks where they may lie."""

    images: tuple[Image, Image]
    masks: tuple[Image, Image]
    camera: StereoCamera
    settings: TargetSettings


@dataclass(frozen=True, slots=True)
class SeenMarks:
    """Landmarks found in both eyes: numbers (n,), raw pixels (n, 4) left and right."""

    indices: np.ndarray
    stereo_pixels: Array


@dataclass(frozen=True, slots=True)
class MarksPose:
    """T_cam_target, its covariance, which of the seen landmarks agree (n,), residual rms [px].

    `variance_factor`: of the residuals over what noise and landmarks explain; 1 unless they refute it.
    """

    T_cam_target: Array
    covariance: Array
    inliers: BoolArray
    residual_px: float
    variance_factor: float = 1.0


class TargetTracker:
    """Keeps the last image and pose of one target; each call takes the next pair."""

    def __init__(self, target: AnchoredTarget, camera: StereoCamera, settings: TargetSettings | None = None) -> None:
        self._target, self._camera = target, camera
        self._settings = settings or TargetSettings()
        self._last: tuple[Image, Array] | None = (target.reference_left, target.T_ref_target)
        self._size = (camera.height_px, camera.width_px)
        self._mask_reference = _disc_mask(target, camera, self._settings, self._size)
        self._lost = 0

    def find_target(
        self, left: Image, right: Image, masks_px: tuple[Sequence[Array], Sequence[Array]] = ((), ())
    ) -> TargetFix:
        """Where the target is in this raw pair (h, w), or why that is not known.

        Args:    masks_px: polygons (k, 2) [px] of the own tool in the left and the right image; what lies under them is
                 covered by us and counts neither for nor against the target.
        """
        masks = allowed_masks(self._size, masks_px)
        pair = SearchedPair((left, right), masks, self._camera, self._settings)
        guess = self._by_flow(left, masks[0])
        fix, T = self._fix_from_guess(pair, guess) if guess is not None else (_LOST, None)
        if T is None and self._lost % RECOGNITION_INTERVAL_PAIRS == 0:
            guess = self._recognise_pose(left, masks[0])
            if guess is not None:
                fix, T = self._fix_from_guess(pair, guess)
        self._lost = 0 if T is not None else self._lost + 1
        self._last = None if T is None else (left.copy(), T)
        return fix

    def _by_flow(self, left: Image, mask: Image) -> Array | None:
        """The pose by landmarks that moved on from the last image."""
        if self._last is None:
            return None
        points, pixels = moved_on(
            self._camera, self._last, self._target.surrounding_landmarks.points_target, left, mask
        )
        return self._pose_by_ransac(points, pixels, self._last[1])

    def _recognise_pose(self, left: Image, mask: Image) -> Array | None:
        """The pose by features of the reference, wherever the camera is."""
        target = self._target
        first, second = recognise(target.reference_left, self._mask_reference, left, mask)
        if len(first) < FIX_LANDMARKS_MIN:
            return None
        return self._pose_by_ransac(self._lift_to_surface(first), second, None)

    def _lift_to_surface(self, left_px: Array) -> Array:
        """Places (n, 3) in target axes of reference pixels, on a curved surface through the landmarks.

        The disparity of a surface of second order is fitted: good to millimetres, which a first guess needs no better.
        """
        marks, camera = self._target.surrounding_landmarks, self._camera
        rays = undistort_to_rays(camera, marks.left_px)
        disparity = rays[:, 0] - undistort_to_rays(camera, marks.right_px)[:, 0]
        found = np.linalg.lstsq(_quadratic_terms(rays), disparity, rcond=None)[0]
        wanted = undistort_to_rays(camera, left_px)
        depth = camera.baseline_m / np.maximum(_quadratic_terms(wanted) @ found, 1e-3)
        T = self._target.T_ref_target
        return (np.column_stack([wanted, np.ones(len(wanted))]) * depth[:, None] - T[:3, 3]) @ T[:3, :3]

    def _pose_by_ransac(self, points: Array, pixels: Array, start: Array | None) -> Array | None:
        if len(points) < FIX_LANDMARKS_MIN:
            return None
        rays, limit = undistort_to_rays(self._camera, pixels), PNP_INLIER_MAX_PX / self._camera.fx_px
        found = ransac_pose(points, rays, limit, 200, cv2.SOLVEPNP_ITERATIVE, start)
        return None if found is None or len(found[1]) < FIX_LANDMARKS_MIN else found[0]

    def _fix_from_guess(self, pair: SearchedPair, guess: Array) -> tuple[TargetFix, Array | None]:
        """The fix from a guess; the pose None where the surroundings were not found."""
        target = self._target
        seen, visible, fit = fitted_marks(target.reference_images, target.surrounding_landmarks, pair, guess)
        if fit is None:
            return not_found(len(seen.indices), visible), None
        n = int(fit.inliers.sum())
        if n < FIX_LANDMARKS_MIN or n < LANDMARKS_FOUND_MIN_FRAC * visible:
            return not_found(n, visible), None
        agree, problem = _patch_verdict(target, pair, fit)
        if problem:
            return no_fix(problem, n, agree, fit.residual_px), fit.T_cam_target
        return TargetFix(True, "", fit.T_cam_target, fit.covariance, n, agree, fit.residual_px), fit.T_cam_target


RECOGNITION_INTERVAL_PAIRS = 3  # lost pairs: recognition takes as long as two pairs
_LOST = no_fix(
    "target: its surroundings are not recognised in the left eye; bring it into view, or clear what covers it",
    0,
    seen=False,
)


def not_found(n: int, visible: int) -> TargetFix:
    """The fix of surroundings of which too few landmarks were found."""
    reason = (
        f"target: {n} of {visible} visible landmarks found in both eyes (limits {FIX_LANDMARKS_MIN} and "
        f"{100 * LANDMARKS_FOUND_MIN_FRAC:.0f} %); clear the view, restore the light, or choose the target again"
    )
    return no_fix(reason, n, seen=False)


def _quadratic_terms(rays: Array) -> Array:
    x, y = rays[:, 0], rays[:, 1]
    return np.column_stack([np.ones(len(rays)), x, y, x * x, x * y, y * y])


def moved_on(
    camera: StereoCamera, last: tuple[Image, Array], points_target: Array, left: Image, mask: Image
) -> tuple[Array, Array]:
    """Those of the points (n, 3) that flow from the last image and its pose finds in this one, and their pixels."""
    image, T = last
    before = project_stereo(camera, transform_points(T, points_target))[0]
    inside = (before >= 0.0).all(axis=1) & (before < [left.shape[1], left.shape[0]]).all(axis=1)
    indices = np.flatnonzero(np.isfinite(before).all(axis=1) & inside)
    found = optical_flow(image, left, before[indices])
    good = found.valid & inside_mask(mask, found.points_px)
    return points_target[indices[good]], found.points_px[good]


def _disc_mask(target: AnchoredTarget, camera: StereoCamera, settings: TargetSettings, size: tuple[int, int]) -> Image:
    mask = np.zeros(size, np.uint8)
    pixel = target.patch.pixel
    radius_px = settings.surroundings_m * camera.fx_px / float(target.T_ref_target[2, 3])
    cv2.circle(mask, (round(pixel[0]), round(pixel[1])), round(radius_px), 255, -1)
    return mask


def align_marks(
    references: tuple[Image, Image], marks: Landmarks, pair: SearchedPair, T: Array
) -> tuple[SeenMarks, int]:
    """Landmarks found in both eyes, and how many should be visible at this pose; `references`: the pair they are of.

    Where the reference is magnified by more than the alignment allows, the new images are halved: their places are then
    good to 0.1 px instead of 0.05, at a range where a pixel is that much smaller.
    """
    camera, points = pair.camera, transform_points(T, marks.points_target)
    with np.errstate(invalid="ignore", divide="ignore"):
        left_px, right_px = project_stereo(camera, points)
        sides = [project_stereo(camera, transform_points(T, marks.support_target[:, k]))[0] - left_px for k in range(2)]
    growth = np.stack(sides, axis=2)  # d(new px) / d(reference px)
    area = growth[:, 0, 0] * growth[:, 1, 1] - growth[:, 0, 1] * growth[:, 1, 0]
    known = (points[:, 2] > DEPTH_MIN_M) & np.isfinite(area) & np.isfinite(right_px).all(axis=1)
    known[known] = inside_mask(pair.masks[0], left_px[known]) & inside_mask(pair.masks[1], right_px[known])
    known &= area > PATCH_AREA_RATIO_MIN
    if not known.any():
        return SeenMarks(np.zeros(0, dtype=np.int64), np.zeros((0, 4))), 0
    level = int(
        np.clip(
            np.ceil(0.5 * np.log2(max(float(np.median(area[known])) / PATCH_AREA_RATIO_MAX, 1.0))),
            0,
            PYRAMID_LEVELS - 1,
        )
    )
    scale = 0.5**level
    known &= area * scale**2 < PATCH_AREA_RATIO_MAX * 2.0
    indices = np.flatnonzero(known)
    if not len(indices):
        return SeenMarks(indices, np.zeros((0, 4))), 0
    warps = np.asarray(np.linalg.inv(growth[indices] * scale), dtype=np.float64)
    found = []
    for eye, places, guesses in ((0, marks.left_px, left_px), (1, marks.right_px, right_px)):
        small = _downsampled_image(pair.images[eye], level)
        at = align_reference_patches(
            references[eye], places[indices], warps, small, (guesses[indices] + 0.5) * scale - 0.5
        )
        found.append(((at.points_px + 0.5) / scale - 0.5, at.valid))
    good = found[0][1] & found[1][1]
    return SeenMarks(indices[good], np.hstack([found[0][0][good], found[1][0][good]])), len(indices)


def fitted_marks(
    references: tuple[Image, Image], marks: Landmarks, pair: SearchedPair, guess: Array
) -> tuple[SeenMarks, int, MarksPose | None]:
    """`align_marks` and the pose by them, twice: the second time from the better guess; None for too few landmarks."""

    def fitted(T: Array) -> tuple[SeenMarks, int, MarksPose | None]:
        seen, visible = align_marks(references, marks, pair, T)
        return seen, visible, solve_pose(pair, marks, seen, T) if len(seen.indices) >= FIX_LANDMARKS_MIN else None

    first = fitted(guess)
    return first if first[2] is None else fitted(first[2].T_cam_target)


def _downsampled_image(image: Image, level: int) -> Image:
    """The image at 1 / 2^level of its size; pixel centres at (u + 0.5) / 2^level - 0.5."""
    if level == 0:
        return image
    factor = 0.5**level
    return np.asarray(cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def solve_pose(pair: SearchedPair, marks: Landmarks, seen: SeenMarks, start: Array) -> MarksPose:
    """Pose by iteratively reweighted least squares over both eyes.

    Model:   residual (4,) = projection in both eyes minus seen, raw px; covariance sigma^2 I + J C J^T, with the
             landmark's own covariance C; Tukey's biweight on the whitened norm, its scale from the median.
    Returns: MarksPose with the covariance of noise and landmarks, larger where the residuals say so.
    """
    camera, points, C = pair.camera, marks.points_target[seen.indices], marks.covariances_target[seen.indices]
    T, shift = start, np.array([camera.baseline_m, 0.0, 0.0])
    weights, white, J = np.ones(len(points)), np.zeros((len(points), 4)), np.zeros((len(points), 4, 6))
    for _ in range(STEPS):
        cam = transform_points(T, points)
        both = [projection_jacobian(camera, cam), projection_jacobian(camera, cam - shift)]
        J_point = np.concatenate(both, axis=1)
        turned = -skew_matrices(cam - T[:3, 3])
        R = T[:3, :3]
        noise = pair.settings.sigma_px**2 * np.eye(4) + J_point @ (R @ C @ R.T) @ J_point.transpose(0, 2, 1)
        root = np.linalg.inv(np.linalg.cholesky(noise))
        residual = np.hstack(project_stereo(camera, cam)) - seen.stereo_pixels
        white = np.einsum("nij,nj->ni", root, residual)
        J = root @ np.concatenate([J_point @ turned, J_point], axis=2)
        norm = np.linalg.norm(white, axis=1) / 2.0
        spread = max(1.4826 * float(np.median(norm)) / 1.4, 1.0)
        weights = np.clip(1.0 - (norm / (TUKEY_SIGMAS * spread)) ** 2, 0.0, None) ** 2
        information = np.einsum("n,nki,nkj->ij", weights, J, J) + 1e-12 * np.eye(6)
        step = -np.linalg.solve(information, np.einsum("n,nki,nk->i", weights, J, white))
        T = moved_pose(T, step)
        if float(np.abs(step).max()) < STEP_MIN:
            break
    agree = weights > 0.05
    information = np.einsum("nki,nkj->ij", J[agree], J[agree]) + 1e-12 * np.eye(6)
    variance = fitted_variance(float(np.sum(white[agree] ** 2)), 4 * int(agree.sum()) - 6, 1.0)
    covariance = variance * np.linalg.inv(information)
    shown = np.hstack(project_stereo(camera, transform_points(T, points)))[agree] - seen.stereo_pixels[agree]
    rms = float(np.sqrt(np.mean(shown**2))) if len(shown) else 0.0
    return MarksPose(T, 0.5 * (covariance + covariance.T), agree, rms, variance)


def _patch_verdict(target: AnchoredTarget, pair: SearchedPair, fit: MarksPose) -> tuple[float, str]:
    """Share of the visible patch that agrees with its surroundings, and why the target must not be used, if so.

    The middle of the patch is judged first, by itself: an object smaller than the patch may lie on it or have moved.
    """
    near = np.linalg.norm(target.surface_landmarks.points_target, axis=1) <= PATCH_MIDDLE_RADIUS_M
    for marks in (target.surface_landmarks.subset(near), target.surface_landmarks):
        share, problem = _marks_verdict(target, marks, pair, fit)
        if problem:
            return share, problem
    return share, ""


def _marks_verdict(target: AnchoredTarget, marks: Landmarks, pair: SearchedPair, fit: MarksPose) -> tuple[float, str]:
    seen, visible = align_marks(target.reference_images, marks, pair, fit.T_cam_target)
    if visible < VISIBLE_SAMPLES_MIN:
        return float("nan"), ""  # under our own tool; the surroundings speak for it
    share = len(seen.indices) / visible
    if share < PATCH_AGREEMENT_MIN_FRAC or len(seen.indices) < VISIBLE_SAMPLES_MIN - 1:
        reason = (
            f"target: {100 * share:.0f} % of its visible surface looks as it did (limit "
            f"{100 * PATCH_AGREEMENT_MIN_FRAC:.0f} %); "
            "it is covered, has moved or has changed. Clear it, or choose the target again"
        )
        return share, reason
    own = solve_pose(pair, marks, seen, fit.T_cam_target)
    middle = marks.points_target[seen.indices].mean(axis=0)
    moved = transform_points(own.T_cam_target, middle[None])[0] - transform_points(fit.T_cam_target, middle[None])[0]
    sigma = _sigma_at(own, fit, middle) + np.sqrt(target.covariance_target[5, 5]) * np.abs(fit.T_cam_target[:3, 2])
    limit = np.maximum(TARGET_MOVED_SIGMAS * sigma, TARGET_MOVED_MIN_M)
    worst = int(np.argmax(np.abs(moved) / limit))
    if abs(moved[worst]) > limit[worst]:
        reason = (
            f"target has moved against its surroundings by {1e3 * np.linalg.norm(moved):.1f} mm (limit "
            f"{1e3 * limit[worst]:.1f} mm); choose the target again"
        )
        return share, reason
    return share, ""


def _sigma_at(own: MarksPose, fit: MarksPose, point_target: Array) -> Array:
    """Standard deviation (3,) [m] of a point's place, both poses together, camera axes."""
    total = np.zeros((3, 3))
    for estimate in (own, fit):
        J = np.hstack([-skew(estimate.T_cam_target[:3, :3] @ point_target), np.eye(3)])
        total += J @ estimate.covariance @ J.T
    return np.sqrt(np.diag(total))
