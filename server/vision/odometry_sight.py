"""What the odometry asks of a stereo pair: new points, known points found again, coarse correspondence."""

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from machine.camera import undistort_to_rays
from machine.description import StereoCamera
from server.vision.contracts import Array, Image
from server.vision.odometry_align import PATCH_CORRELATION_MIN, PATCH_HALF_PX, Alignment, align_reference_patches
from server.vision.odometry_features import (
    UNIQUE_RATIO_MAX,
    inside_mask,
    recognise,
    repeats,
    spread_corners,
    texture_grey,
)

EPIPOLAR_MAX_PX = 1.0
DISPARITY_MIN_PX = 1.5
REPETITION_CHECK_POINTS = 40  # points that say which disparity is the right one where a texture repeats
REPETITION_STEPS_MAX = 8

KLT_WINDOW_PX = 21
KLT_PYRAMID_LEVELS = 4
KLT_RETURN_ERROR_MAX_PX = 0.7  # a point must come back to within this
KLT_TERMINATION_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)


@dataclass(frozen=True, slots=True)
class Flow:
    """Points (n, 2) [px] in the second image, and which of them (n,) may be believed."""

    points_px: Array
    valid: NDArray[np.bool_]


def optical_flow(first: Image, second: Image, points_px: Array, guess_px: Array | None = None) -> Flow:
    """Where points of the first image are in the second.

    Args:    first, second: grey (h, w). points_px (n, 2). guess_px (n, 2): start, the same place if None.
    Source:  Lucas and Kanade 1981 in pyramids (Bouguet); forward-backward check of Kalal 2010.
    """
    if len(points_px) == 0:
        return Flow(np.zeros((0, 2)), np.zeros(0, dtype=bool))
    start = np.ascontiguousarray(points_px, dtype=np.float32).reshape(-1, 1, 2)
    guess = start.copy() if guess_px is None else np.ascontiguousarray(guess_px, dtype=np.float32).reshape(-1, 1, 2)
    there, forward = _track_points_klt(first, second, start, guess)
    back, backward = _track_points_klt(second, first, there, start.copy())
    returned = np.linalg.norm((back - start).reshape(-1, 2), axis=1)
    good = (forward.reshape(-1) == 1) & (backward.reshape(-1) == 1) & (returned < KLT_RETURN_ERROR_MAX_PX)
    return Flow(there.reshape(-1, 2).astype(np.float64), good)


def _track_points_klt(
    first: Image, second: Image, points: np.ndarray, guess: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        first,
        second,
        points,
        guess.copy(),
        winSize=(KLT_WINDOW_PX, KLT_WINDOW_PX),
        maxLevel=KLT_PYRAMID_LEVELS,
        criteria=KLT_TERMINATION_CRITERIA,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=1e-5,
    )
    return np.asarray(found), np.asarray(status)


@dataclass(frozen=True, slots=True)
class StereoMatches:
    """Raw pixels (n, 2) of the same points in both eyes; `texture_grey`: how much the grey varies about a typical one
    (standard deviation over its patch), infinite where there are no images. `disparity_unique`: no other is as good."""

    left_px: Array
    right_px: Array
    texture_grey: float = float("inf")
    disparity_unique: bool = True


@dataclass(frozen=True, slots=True)
class SearchPoints:
    """Points of a kept pair that are looked for in a new one: places (n, 2) raw in the kept pair's two eyes, warps
    (n, 2, 2) = d(kept px)/d(new px), guesses (n, 2) raw in the new pair."""

    indices: NDArray[np.int64]
    places_left_px: Array
    places_right_px: Array
    warps: Array
    guesses_left_px: Array
    guesses_right_px: Array

    def subset(self, chosen: NDArray[np.int64]) -> "SearchPoints":
        """Only these of them."""
        return SearchPoints(
            self.indices[chosen],
            self.places_left_px[chosen],
            self.places_right_px[chosen],
            self.warps[chosen],
            self.guesses_left_px[chosen],
            self.guesses_right_px[chosen],
        )


class Sight(Protocol):
    """One stereo pair as the odometry sees it: images, or in a simulation points that are known to lie there."""

    @property
    def t_exposure_ns(self) -> int:
        """Mid-exposure of the middle row, camera clock."""
        ...

    def match_eyes(self, camera: StereoCamera, count: int, occupied_px: Array) -> StereoMatches:
        """New points in both eyes, about `count` at most, away from `occupied_px` (m, 2)."""
        ...

    def find_points(self, kept: "Sight", wanted: SearchPoints) -> tuple[Alignment, Alignment]:
        """Points of a kept pair in this pair's left and right eye."""
        ...

    def may_show(self, left_px: Array) -> NDArray[np.bool_]:
        """Which places (n, 2) of the left eye are not masked."""
        ...

    def flow_from(self, kept: "Sight", places_left_px: Array) -> Flow:
        """Where left places of a kept pair are in this left eye, without any idea of the motion."""
        ...

    def recognise(self, kept: "Sight") -> tuple[Array, Array]:
        """Left places (n, 2) of a kept pair and where they seem to be in this left eye, wherever the camera is."""
        ...

    def repetition_ways(self) -> Array:
        """Ways (k, 2) [px] by which the left picture may repeat itself."""
        ...

    def keep_copy(self) -> "Sight":
        """A copy that stays true when the caller's buffers are used again."""
        ...


@dataclass(frozen=True, slots=True)
class ImageSight:
    """A pair of raw grey images (h, w) with the masks (255 = may be used) of both eyes."""

    left: Image
    right: Image
    masks: tuple[Image, Image]
    t_exposure_ns: int

    def match_eyes(self, camera: StereoCamera, count: int, occupied_px: Array) -> StereoMatches:
        """New corners of the left eye found again in the right one.

        Model:   kept where the rows of the undistorted rays agree to 1 px and the disparity is at least 1.5 px. Flow
                 runs twice: what fails starts again at the disparity of its neighbours.
        """
        corners = spread_corners(self.left, self.masks[0], count, occupied_px)
        found = optical_flow(self.left, self.right, corners)
        rays_left = undistort_to_rays(camera, corners)
        right_px, good = found.points_px, plausible_match_mask(camera, rays_left, found.points_px, found.valid)
        if 0 < good.sum() < len(good):
            shift = np.median(right_px[good] - corners[good], axis=0)
            again = optical_flow(self.left, self.right, corners[~good], corners[~good] + shift)
            right_px = right_px.copy()
            right_px[~good] = again.points_px
            retried = good.copy()
            retried[~good] = again.valid
            good = plausible_match_mask(camera, rays_left, right_px, retried)
        right_px, unique = self._best_disparity(corners, right_px, good)
        good = plausible_match_mask(camera, rays_left, right_px, good) & inside_mask(self.masks[1], right_px)
        return StereoMatches(corners[good], right_px[good], texture_grey(self.left, corners[good]), unique)

    def _best_disparity(self, corners: Array, right_px: Array, good: NDArray[np.bool_]) -> tuple[Array, bool]:
        """Right places (n, 2), moved along the rows by as many repetitions of the texture as make both eyes most alike,
        and whether that is clearly better than one repetition more or less."""
        some = np.flatnonzero(good)[:: max(1, int(good.sum()) // REPETITION_CHECK_POINTS)]
        ways = repeats(self.left, along_rows=True)
        if len(some) == 0 or len(ways) == 0:
            return right_px, True
        warps, offset = np.tile(np.eye(2), (len(some), 1, 1)), np.zeros(2)
        border = np.array([2.0 * PATCH_HALF_PX, 0.0])
        size = np.array([self.left.shape[1], self.left.shape[0]])
        worst = 1.0 - PATCH_CORRELATION_MIN**2

        def unlike(way: Array) -> Array:
            guesses = right_px[some] + way
            found = align_reference_patches(self.left, corners[some], warps, self.right, guesses)
            inside = ((guesses >= border) & (guesses < size - border)).all(axis=1)
            least = np.where(found.valid, 1.0 - found.correlation**2, worst)
            return np.where(inside, least, np.nan)

        best, ratio = unlike(offset), 0.0
        for _ in range(REPETITION_STEPS_MAX):
            others = [unlike(offset + way) for way in ways]
            both = [np.minimum(best, other) < worst for other in others]  # NaN: not in the picture
            ratios = [
                float(np.median(best[on]) / np.median(other[on])) if 2 * on.sum() > len(some) else 0.0
                for on, other in zip(both, others, strict=True)
            ]
            ratio = max(ratios)
            if ratio <= 1.0:
                break
            chosen = int(np.argmax(ratios))
            offset, best = offset + ways[chosen], others[chosen]
        unique = bool(ratio <= UNIQUE_RATIO_MAX)
        if not offset.any():
            return right_px, unique
        moved = align_reference_patches(
            self.left, corners, np.tile(np.eye(2), (len(corners), 1, 1)), self.right, right_px + offset
        )
        return np.where(moved.valid[:, None], moved.points_px, np.nan), unique

    def find_points(self, kept: Sight, wanted: SearchPoints) -> tuple[Alignment, Alignment]:
        """Patches of the kept pair, warped, laid onto this one; what lies under a mask is not found."""
        kept = _require_image_sight(kept)
        left = align_reference_patches(
            kept.left, wanted.places_left_px, wanted.warps, self.left, wanted.guesses_left_px
        )
        right = align_reference_patches(
            kept.right, wanted.places_right_px, wanted.warps, self.right, wanted.guesses_right_px
        )
        shown = right.valid & inside_mask(self.masks[1], right.points_px)
        return left, Alignment(right.points_px, right.correlation, shown)

    def may_show(self, left_px: Array) -> NDArray[np.bool_]:
        """Which places (n, 2) of the left eye are not masked."""
        return inside_mask(self.masks[0], left_px)

    def flow_from(self, kept: Sight, places_left_px: Array) -> Flow:
        """Pyramidal flow from the kept left image to this one."""
        kept = _require_image_sight(kept)
        found = optical_flow(kept.left, self.left, places_left_px)
        return Flow(found.points_px, found.valid & inside_mask(self.masks[0], found.points_px))

    def recognise(self, kept: Sight) -> tuple[Array, Array]:
        """Match a kept pair to this one by ORB features; pixels in both."""
        kept = _require_image_sight(kept)
        return recognise(kept.left, kept.masks[0], self.left, self.masks[0])

    def repetition_ways(self) -> Array:
        """By its likeness to itself."""
        return repeats(self.left)

    def keep_copy(self) -> "ImageSight":
        """With images of its own."""
        return ImageSight(self.left.copy(), self.right.copy(), self.masks, self.t_exposure_ns)


def _require_image_sight(kept: Sight) -> ImageSight:
    if not isinstance(kept, ImageSight):
        raise TypeError(f"a pair of images is compared with images, not with {type(kept).__name__}")
    return kept


def plausible_match_mask(
    camera: StereoCamera, rays_left: Array, right_px: Array, good: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Which matches (n,) lie on the epipolar line (rows agree to 1 px), in front of the eyes, and inside the image."""
    height, width = camera.height_px, camera.width_px
    inside = np.asarray((right_px >= 0.0).all(axis=1) & (right_px < [width, height]).all(axis=1))
    rays_right = undistort_to_rays(camera, np.where(inside[:, None], right_px, 0.0))
    disparity = (rays_left[:, 0] - rays_right[:, 0]) * camera.fx_px
    row = np.abs(rays_left[:, 1] - rays_right[:, 1]) * camera.fy_px
    return np.asarray(good & inside & (row < EPIPOLAR_MAX_PX) & (disparity > DISPARITY_MIN_PX))
