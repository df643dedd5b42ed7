"""What a pair shows of the map: points of the keyframes, found again; and what stood still with the camera."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from machine.camera import project_stereo, undistort_to_rays
from machine.description import StereoCamera
from machine.poses import inverse_pose, transform_points
from server.vision.contracts import Array
from server.vision.odometry_align import ALIGNMENT_SHIFT_MAX_PX
from server.vision.odometry_keyframe import DEPTH_MIN_M, Hides, Keyframe, expect_points, ray_noise
from server.vision.odometry_pose import PoseFit, StereoPoints
from server.vision.odometry_sight import SearchPoints, Sight

POINTS_FOUND_MIN_FRAC = 0.5  # of the points wanted: found, not only expected
VIEW_CHECK_POINTS = 24  # points of a keyframe that are asked first
IMAGE_BORDER_FRAC = 0.02  # of the image's width: a patch about a point nearer than this may leave it
VIEW_HALF_WIDTH_FRAC = 0.7  # half of the image and some more


@dataclass(frozen=True, slots=True)
class ObservedPoints:
    """Map points found in a pair: keyframe and number in it (n,), raw pixels (n, 2) (right NaN where not shown), and
    the same for the fit. points_row (n, 3): in the axes of the camera that kept them. motion_votes (n,): of earlier
    pairs, above 0 for a point that went with the world, below for one that went with the camera."""

    keyframe_indices: NDArray[np.int64]
    indices: NDArray[np.int64]
    left_px: Array
    right_px: Array
    n_expected: int
    stereo_points: StereoPoints
    points_row: Array
    motion_votes: NDArray[np.int8]
    correlations: Array
    searched_points: tuple["SearchedPoints", ...] = ()

    def count_misses(self, good: NDArray[np.bool_]) -> None:
        """Hold misses, and finds that are not `good` (n,), against the points.

        Only right where the pair was located: in the dark all are missed.
        """
        start = 0
        for tried in self.searched_points:
            found = tried.found_mask.copy()
            end = start + int(found.sum())
            found[found] = good[start:end]
            tried.keyframe.count_misses(tried.search_points.indices, found)
            start = end


@dataclass(frozen=True, slots=True)
class SearchedPoints:
    """Points of a keyframe (n,) that were looked for, and which of them were found."""

    keyframe: Keyframe
    search_points: SearchPoints
    found_mask: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class _Part:
    searched_points: SearchedPoints
    keyframe_index: int
    left_px: Array
    right_px: Array
    correlations: Array

    @property
    def indices(self) -> NDArray[np.int64]:
        return self.searched_points.search_points.indices[self.searched_points.found_mask]


def observe_map(
    camera: StereoCamera,
    keyframes: Sequence[Keyframe],
    sight: Sight,
    T_vo_cam: Array,
    points_max: int,
    sigma_px: float,
    hides: Hides,
) -> ObservedPoints:
    """Map points in a pair taken near `T_vo_cam`.

    Args:    keyframes: oldest first. points_max: no further keyframe once this many points were expected.
             sigma_px: of one coordinate in one image. hides: which places of the left picture show own structure.
    """
    parts: list[_Part] = []
    n_expected = n_found = 0
    for number, keyframe in enumerate(keyframes):
        if number > 0 and number < len(keyframes) - 1 and not in_view(camera, keyframe, T_vo_cam):
            continue
        wanted = expect_points(camera, keyframe, T_vo_cam, sight, hides)
        part, expected = _observe_keyframe(number, keyframe, sight, wanted, points_max - n_found)
        parts.append(part)
        n_expected += expected
        n_found += len(part.left_px)
        if n_expected >= points_max and n_found >= POINTS_FOUND_MIN_FRAC * points_max:
            break

    def together(of: Callable[[_Part], NDArray[Any]]) -> NDArray[Any]:
        return np.concatenate([of(part) for part in parts])

    left_px, right_px = together(lambda part: part.left_px), together(lambda part: part.right_px)
    rays_left, rays_right = undistort_to_rays(camera, left_px), undistort_to_rays(camera, right_px)
    seen = StereoPoints(
        points_vo=together(lambda part: part.searched_points.keyframe.points_vo[part.indices]),
        covariances_vo=together(lambda part: part.searched_points.keyframe.covariances_vo[part.indices]),
        rays_left=rays_left,
        rays_right=rays_right,
        sigma_px=sigma_px,
        focal_px=camera.fx_px,
        baseline_m=camera.baseline_m,
        unit_noise_covariances=np.stack([ray_noise(camera, rays_left), ray_noise(camera, rays_right)], axis=1),
    )
    return ObservedPoints(
        keyframe_indices=np.repeat([part.keyframe_index for part in parts], [len(part.left_px) for part in parts]),
        indices=together(lambda part: part.indices),
        left_px=left_px,
        right_px=right_px,
        n_expected=n_expected,
        stereo_points=seen,
        points_row=together(lambda part: part.searched_points.keyframe.points_row[part.indices]),
        motion_votes=together(lambda part: part.searched_points.keyframe.motion_votes[part.indices]),
        correlations=together(lambda part: part.correlations),
        searched_points=tuple(part.searched_points for part in parts),
    )


def expected_right(camera: StereoCamera, points_cam: Array) -> NDArray[np.bool_]:
    """Which points (n, 3) in the left eye's axes [m] the right eye must show: away from its image's border."""
    right_px = project_stereo(camera, points_cam)[1]
    border = IMAGE_BORDER_FRAC * camera.width_px
    size = np.array([camera.width_px, camera.height_px])
    return np.asarray(((right_px > border) & (right_px < size - border)).all(axis=1))


def in_view(camera: StereoCamera, keyframe: Keyframe, T_vo_cam: Array) -> bool:
    """Whether any of a few of a keyframe's points may be seen from here: a quick look before the thorough one."""
    some = keyframe.points_vo[:: max(1, keyframe.n_points // VIEW_CHECK_POINTS)]
    x, y, z = transform_points(inverse_pose(T_vo_cam), some).T
    near = z > DEPTH_MIN_M
    across = np.abs(x) * camera.fx_px < VIEW_HALF_WIDTH_FRAC * camera.width_px * z
    above = np.abs(y) * camera.fy_px < VIEW_HALF_WIDTH_FRAC * camera.height_px * z
    return bool((near & across & above).any())


def _observe_keyframe(
    number: int, keyframe: Keyframe, sight: Sight, wanted: SearchPoints, room: int
) -> tuple[_Part, int]:
    if len(wanted.indices) > room:
        wanted = wanted.subset(np.linspace(0, len(wanted.indices) - 1, room).astype(np.int64))
    left, right = sight.find_points(keyframe.image_pair, wanted)
    good = left.valid
    right_px = np.where(right.valid[:, None], right.points_px, np.nan)[good]
    part = _Part(SearchedPoints(keyframe, wanted, good), number, left.points_px[good], right_px, left.correlation[good])
    return part, len(wanted.indices)


CELL_VOTES_MAX = 8  # as many pairs in a row turn a cell's verdict round
Mask = NDArray[np.bool_]


class OwnStructure:
    """Votes by cells of the left picture: above 0 something went with the world there, below with the camera."""

    def __init__(self, shape: tuple[int, int], cell_px: int) -> None:
        self._cell_px = cell_px
        self._votes = np.zeros((shape[0] // cell_px + 1, shape[1] // cell_px + 1), dtype=np.int64)
        self._hidden = np.zeros(self._votes.shape, dtype=np.bool_)

    def vote_on_motion(self, own_px: Array, world_px: Array) -> None:
        """Count points (n, 2) of one pair that stood still against the world, and points that moved with it."""
        for places, sign in ((own_px, -1), (world_px, 1)):
            np.add.at(self._votes, self._cells(places), sign)
        self._votes = np.clip(self._votes, -CELL_VOTES_MAX, CELL_VOTES_MAX)
        own = self._votes < 0
        wide = np.asarray(cv2.dilate(own.astype(np.uint8), np.ones((3, 3), np.uint8))) > 0
        self._hidden = own | (wide & (self._votes == 0))

    def on_own_structure(self, left_px: Array) -> Mask:
        """Which places (n, 2) [raw px] lie on it or right at it, where nothing of the world was ever seen."""
        return self._hidden[self._cells(left_px)]

    def _cells(self, places_px: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        finite = np.where(np.isfinite(places_px), places_px, 0.0)
        cells = np.clip(finite // self._cell_px, 0, np.array(self._votes.shape)[::-1] - 1).astype(np.int64)
        return cells[:, 1], cells[:, 0]


def vote_by_pair(own: OwnStructure, sight: Sight, observed: ObservedPoints, fit: PoseFit, rest_squares: Array) -> None:
    """Let a located pair vote: on its points, on their keyframes, and on the picture's cells.

    A point votes where the world's motion and rest in the picture exclude each other: it fits one of them only. Points
    that were not found where the world has them are looked for where they were.
    """
    moved = rest_squares > fit.inlier_limit
    with_world, with_camera = fit.inliers & moved, (fit.squared_residuals >= fit.inlier_limit) & ~moved
    own_px, start = [observed.left_px[with_camera]], 0
    limit_px = observed.stereo_points.sigma_px * np.sqrt(2.0 * fit.inlier_limit)
    for tried in observed.searched_points:
        end = start + int(tried.found_mask.sum())
        at = tried.search_points.indices[tried.found_mask]
        tried.keyframe.vote_on_motion(
            at, with_world[start:end].astype(np.int8) - with_camera[start:end].astype(np.int8)
        )
        own_px.append(_image_fixed_points(sight, tried, limit_px))
        start = end
    own.vote_on_motion(np.concatenate(own_px), observed.left_px[with_world])


def _image_fixed_points(sight: Sight, tried: SearchedPoints, limit_px: float) -> Array:
    """Places (n, 2) of points that were missed, and that lie where they were kept, in both eyes."""
    wanted = tried.search_points
    away = np.linalg.norm(wanted.guesses_left_px - wanted.places_left_px, axis=1) > ALIGNMENT_SHIFT_MAX_PX
    missed = np.flatnonzero(~tried.found_mask & away & sight.may_show(wanted.places_left_px))
    if len(missed) == 0:
        return np.zeros((0, 2))
    some = wanted.subset(missed)
    warps, places = np.tile(np.eye(2), (len(missed), 1, 1)), (some.places_left_px, some.places_right_px)
    found = sight.find_points(tried.keyframe.image_pair, SearchPoints(some.indices, *places, warps, *places))
    good = np.ones(len(missed), dtype=bool)
    for eye, place in zip(found, places, strict=True):
        good &= eye.valid & (np.linalg.norm(eye.points_px - place, axis=1) < limit_px)
    tried.keyframe.vote_on_motion(some.indices[good], np.full(int(good.sum()), -1, dtype=np.int8))
    return places[0][good]
