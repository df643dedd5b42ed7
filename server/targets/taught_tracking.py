"""Finds a taught object in a pair without its marker: features recognised, aligned in both eyes, verified."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from machine.camera import project_stereo, undistort_to_rays
from machine.description import StereoCamera
from machine.poses import inverse_pose, transform_points
from machine.rotations import Array, geodesic_angle
from server.targets.contracts import TargetFix, TargetSettings, no_fix
from server.targets.stereo_match import coarse_disparity
from server.targets.surface import SAMPLE_WINDOW_HALF_PX
from server.targets.taught import Descriptors, TaughtObject, TaughtView, image_features
from server.targets.tracking import (
    FIX_LANDMARKS_MIN,
    PATCH_AGREEMENT_MIN_FRAC,
    MarksPose,
    SearchedPair,
    fitted_marks,
    moved_on,
)
from server.vision.contracts import Image
from server.vision.odometry_align import PATCH_CORRELATION_MIN
from server.vision.odometry_features import MATCH_RATIO_MAX, allowed_masks, clear_matches, inside_mask
from server.vision.odometry_pose import ransac_pose

OCCLUSION_DISPARITY_PX = 3.0  # of disparity: the alignment's basin; what lies that much before the object covers it
RECOGNITION_INTERVAL_PAIRS = 3  # lost pairs: recognition takes as long as several pairs
PNP_INLIER_MAX_PX = 3.0
RIVAL_FEATURES_MIN = 8  # four points make a pose; one more agrees with it by chance in about 1 of 1000
SHIFTED_FEATURES_MIN = 5  # one gives the shift; another one within 3 px of it by chance: 1 of 1000
RIVAL_DISTANCE_MIN_PX = 2.0 * PNP_INLIER_MAX_PX  # farther apart, two poses place a landmark at two places
VARIANCE_FACTOR_MAX = 9.0  # residuals three times what noise and landmarks explain: another geometry


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A pose by one view's matches, how many of them it explains, and the numbers of those features."""

    view: TaughtView
    T_cam_object: Array
    n_inliers: int
    explained_features: NDArray[np.int64]


class TaughtTracker:
    """Keeps the last image and pose of one object; each call takes the next pair."""

    def __init__(self, taught: TaughtObject, camera: StereoCamera, settings: TargetSettings | None = None) -> None:
        self._taught, self._camera = taught, camera
        self._settings = settings or TargetSettings()
        self._last: tuple[Image, Array] | None = None
        self._lost = 0

    def find_target(
        self, left: Image, right: Image, masks_px: tuple[Sequence[Array], Sequence[Array]] = ((), ())
    ) -> TargetFix:
        """Where the object is in this raw pair (h, w), or why that is not known.

        Args:    masks_px: polygons (k, 2) [px] of the own tool in the left and the right image.
        """
        masks = allowed_masks((self._camera.height_px, self._camera.width_px), masks_px)
        pair = SearchedPair((left, right), masks, self._camera, self._settings)
        guess = self._by_flow(left, masks[0])
        fix = self._not_seen(0)
        if guess is not None:
            fix = self._fix_from_guess(pair, guess)
        if not fix.ok and self._lost % RECOGNITION_INTERVAL_PAIRS == 0:
            fix = self._recognise_object(pair)
        self._lost = 0 if fix.ok else self._lost + 1
        self._last = None if fix.T_cam_target is None else (left.copy(), fix.T_cam_target)
        return fix

    def _by_flow(self, left: Image, mask: Image) -> Array | None:
        """The pose by landmarks that moved on from the last image."""
        if self._last is None:
            return None
        view = self._nearest_view(self._last[1])
        solved = _pose_by_ransac(
            self._camera, *moved_on(self._camera, self._last, view.landmarks.points_target, left, mask)
        )
        return None if solved is None else solved[0]

    def _nearest_view(self, T_cam_object: Array) -> TaughtView:
        """The view from the most similar side and distance."""
        here = inverse_pose(T_cam_object)

        def unlike(view: TaughtView) -> float:
            there = inverse_pose(view.T_cam_object)
            apart = np.linalg.norm(here[:3, 3] - there[:3, 3]) / np.linalg.norm(there[:3, 3])
            return float(apart) + geodesic_angle(here[:3, :3], there[:3, :3])

        return min(self._taught.views, key=unlike)

    def _recognise_object(self, pair: SearchedPair) -> TargetFix:
        """The fix from features alone, wherever the camera is."""
        places, descriptors = image_features(pair.images[0], pair.masks[0])
        found = [self._candidate_from_view(view, places, descriptors) for view in self._taught.views]
        known = [candidate for candidate in found if candidate is not None]
        if not known:
            return self._not_seen(0)
        best = max(known, key=lambda one: one.n_inliers)
        rival = self._rival_feature_count(best, places, descriptors)
        if rival:
            reason = (
                f"object '{self._taught.name}': {best.n_inliers} of its features fit one place and {rival} fit "
                "another; there are two of them in view, or it is a similar one with other measures. Cover the other "
                "one, or teach this object"
            )
            return no_fix(reason, best.n_inliers)
        return self._fix_from_guess(pair, best.T_cam_object)

    def _candidate_from_view(self, view: TaughtView, places: Array, descriptors: Descriptors) -> _Candidate | None:
        pairs = _match_features(descriptors, view.descriptors)
        if len(pairs) < FIX_LANDMARKS_MIN:
            return None
        points, pixels = view.landmarks.points_target[pairs[:, 1]], places[pairs[:, 0]]
        solved = _pose_by_ransac(self._camera, points, pixels)
        if solved is None:
            return None
        T, inliers = solved
        return _Candidate(view, T, len(inliers), pairs[inliers, 0])

    def _rival_feature_count(self, best: _Candidate, places: Array, descriptors: Descriptors) -> int:
        """How many of the features that the pose leaves unexplained another pose explains, or a part that has moved."""
        rest = np.ones(len(places), dtype=bool)
        rest[best.explained_features] = False
        places, T = places[rest], best.T_cam_object
        pairs = _match_features(descriptors[rest], best.view.descriptors)
        points, pixels = best.view.landmarks.points_target[pairs[:, 1]], places[pairs[:, 0]]
        moved = _moved_alike(project_stereo(self._camera, transform_points(T, points))[0], pixels)
        second = _pose_by_ransac(self._camera, points, pixels, RIVAL_FEATURES_MIN)
        if second is None:
            return moved
        own, other = (project_stereo(self._camera, transform_points(at, points[second[1]]))[0] for at in (T, second[0]))
        apart = np.linalg.norm(own - other, axis=1)
        number = int((apart > RIVAL_DISTANCE_MIN_PX).sum())
        return max(moved, number if number >= RIVAL_FEATURES_MIN else 0)

    def _fix_from_guess(self, pair: SearchedPair, guess: Array) -> TargetFix:
        """The fix from a guess by the landmarks of the view nearest to it, verified."""
        view = self._nearest_view(guess)
        seen, _, fit = fitted_marks(view.reference_images, view.landmarks, pair, guess)
        if fit is None:
            return self._not_seen(len(seen.indices))
        missing = np.setdiff1d(np.arange(len(view.landmarks)), seen.indices[fit.inliers])
        return self._verified_fix(
            fit,
            int(fit.inliers.sum())
            + _uncovered_landmark_count(view.landmarks.points_target[missing], pair, fit.T_cam_target),
        )

    def _verified_fix(self, fit: MarksPose, visible: int) -> TargetFix:
        n = int(fit.inliers.sum())
        share, name = n / max(visible, 1), self._taught.name
        limit = PATCH_AGREEMENT_MIN_FRAC * self._taught.agree_frac
        if n < FIX_LANDMARKS_MIN or share < limit:
            return no_fix(
                f"object '{name}': {n} of {visible} landmarks that nothing covers are where they were taught "
                f"({100 * share:.0f} %, limits {FIX_LANDMARKS_MIN} and {100 * limit:.0f} %); it has changed, needs "
                "light, or is a similar one. Clean and light it, or teach this object",
                n,
                share,
            )
        if fit.variance_factor > VARIANCE_FACTOR_MAX:
            return no_fix(
                f"object '{name}': its landmarks fit {np.sqrt(fit.variance_factor):.1f} times worse than their noise "
                f"(limit {np.sqrt(VARIANCE_FACTOR_MAX):.0f}); it is a similar one with other measures, or bent. Teach "
                "this object",
                n,
                share,
            )
        return TargetFix(True, "", fit.T_cam_target, fit.covariance, n, share, fit.residual_px)

    def _not_seen(self, n: int) -> TargetFix:
        reason = (
            f"object '{self._taught.name}': {n} of its landmarks are recognised (limit {FIX_LANDMARKS_MIN}); bring it "
            "into view, clear what covers it, or add light"
        )
        return no_fix(reason, n, seen=False)


def _uncovered_landmark_count(points_object: Array, pair: SearchedPair, T: Array) -> int:
    """How many landmarks that were not found have nothing before them: there the object itself looks different."""
    camera = pair.camera
    left_px, right_px = project_stereo(camera, transform_points(T, points_object))
    visible = inside_mask(pair.masks[0], left_px) & inside_mask(pair.masks[1], right_px)
    rays, others = undistort_to_rays(camera, left_px[visible]), undistort_to_rays(camera, right_px[visible])
    nearest = camera.fx_px * camera.baseline_m / pair.settings.depth_min_m
    covered = 0
    for ray, expected in zip(rays, (rays[:, 0] - others[:, 0]) * camera.fx_px, strict=True):
        found = coarse_disparity(
            camera, *pair.images, ray, SAMPLE_WINDOW_HALF_PX, (expected - OCCLUSION_DISPARITY_PX, nearest)
        )
        covered += found.correlation > PATCH_CORRELATION_MIN and found.disparity_px > expected + OCCLUSION_DISPARITY_PX
    return int(visible.sum()) - covered


def _moved_alike(expected_px: Array, pixels: Array) -> int:
    """How many features (n, 2) are shifted alike from where their landmarks should be; 0 below SHIFTED_FEATURES_MIN."""
    shift = pixels - expected_px
    shift = shift[np.linalg.norm(shift, axis=1) > RIVAL_DISTANCE_MIN_PX]
    if len(shift) < SHIFTED_FEATURES_MIN:
        return 0
    alike = np.linalg.norm(shift[:, None] - shift[None], axis=2) < PNP_INLIER_MAX_PX
    most = int(alike.sum(axis=1).max())
    return most if most >= SHIFTED_FEATURES_MIN else 0


def _match_features(seen: Descriptors, taught: Descriptors) -> NDArray[np.int64]:
    """Pairs (n, 2): image feature, landmark; each landmark once.

    Model:   ratio test among landmarks (Lowe 2004), so that two equal objects in view both match; of the features that
             match one landmark the most similar.
    """
    if len(taught) < 2 or not len(seen):
        return np.zeros((0, 2), dtype=np.int64)
    found = clear_matches(seen.astype(np.float32), taught.astype(np.float32), cv2.NORM_L2, MATCH_RATIO_MAX)
    good = [(match.distance, match.queryIdx, match.trainIdx) for match in found]
    best: dict[int, tuple[float, int, int]] = {}
    for match in sorted(good):
        best.setdefault(match[2], match)
    return np.array([(feature, landmark) for _, feature, landmark in best.values()], dtype=np.int64).reshape(-1, 2)


def _pose_by_ransac(
    camera: StereoCamera, points: Array, pixels: Array, least: int = FIX_LANDMARKS_MIN
) -> tuple[Array, NDArray[np.int64]] | None:
    """T_cam_object by RANSAC in the left eye, and the inliers' indices; None for fewer than `least`."""
    if len(points) < least:
        return None
    cv2.setRNGSeed(1)
    found = ransac_pose(points, undistort_to_rays(camera, pixels), PNP_INLIER_MAX_PX / camera.fx_px, 500)
    if found is None or len(found[1]) < least or found[0][2, 3] <= 0.0:
        return None
    return found
