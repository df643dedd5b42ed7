"""The camera's own structure in its left picture: where points stood still while the world moved on."""

import cv2
import numpy as np
from numpy.typing import NDArray

from server.vision.contracts import Array
from server.vision.odometry_align import AWAY_MAX_PX
from server.vision.odometry_observation import Observed, Tried
from server.vision.odometry_pose import PoseFit
from server.vision.odometry_sight import Sight, Wanted

VOTES_MAX = 8  # as many pairs in a row turn a cell's verdict round
Mask = NDArray[np.bool_]


class OwnStructure:
    """Votes by cells of the left picture: above 0 something went with the world there, below with the camera."""

    def __init__(self, shape: tuple[int, int], cell_px: int) -> None:
        self._cell_px = cell_px
        self._votes = np.zeros((shape[0] // cell_px + 1, shape[1] // cell_px + 1), dtype=np.int64)
        self._hidden = np.zeros(self._votes.shape, dtype=np.bool_)

    def vote(self, own_px: Array, world_px: Array) -> None:
        """Count points (n, 2) of one pair that stood still against the world, and points that moved with it."""
        for places, sign in ((own_px, -1), (world_px, 1)):
            np.add.at(self._votes, self._cells(places), sign)
        self._votes = np.clip(self._votes, -VOTES_MAX, VOTES_MAX)
        own = self._votes < 0
        wide = np.asarray(cv2.dilate(own.astype(np.uint8), np.ones((3, 3), np.uint8))) > 0
        self._hidden = own | (wide & (self._votes == 0))

    def hides(self, left_px: Array) -> Mask:
        """Which places (n, 2) [raw px] lie on it or right at it, where nothing of the world was ever seen."""
        return self._hidden[self._cells(left_px)]

    def _cells(self, places_px: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        finite = np.where(np.isfinite(places_px), places_px, 0.0)
        cells = np.clip(finite // self._cell_px, 0, np.array(self._votes.shape)[::-1] - 1).astype(np.int64)
        return cells[:, 1], cells[:, 0]


def vote(own: OwnStructure, sight: Sight, observed: Observed, fit: PoseFit, rest_squares: Array) -> None:
    """Let a located pair vote: on its points, on their keyframes, and on the picture's cells.

    A point votes where the world's motion and rest in the picture exclude each other: it fits one of them only. Points
    that were not found where the world has them are looked for where they were.
    """
    moved = rest_squares > fit.limit
    with_world, with_camera = fit.inliers & moved, (fit.squares >= fit.limit) & ~moved
    own_px, start = [observed.left_px[with_camera]], 0
    limit_px = observed.seen.sigma_px * np.sqrt(2.0 * fit.limit)
    for tried in observed.tried:
        end = start + int(tried.found.sum())
        at = tried.wanted.indices[tried.found]
        tried.keyframe.vote(at, with_world[start:end].astype(np.int8) - with_camera[start:end].astype(np.int8))
        own_px.append(_standing(sight, tried, limit_px))
        start = end
    own.vote(np.concatenate(own_px), observed.left_px[with_world])


def _standing(sight: Sight, tried: Tried, limit_px: float) -> Array:
    """Places (n, 2) of points that were missed, and that lie where they were kept, in both eyes."""
    wanted = tried.wanted
    away = np.linalg.norm(wanted.guesses_left_px - wanted.places_left_px, axis=1) > AWAY_MAX_PX
    missed = np.flatnonzero(~tried.found & away & sight.may_show(wanted.places_left_px))
    if len(missed) == 0:
        return np.zeros((0, 2))
    some = wanted.some(missed)
    warps, places = np.tile(np.eye(2), (len(missed), 1, 1)), (some.places_left_px, some.places_right_px)
    found = sight.find(tried.keyframe.sight, Wanted(some.indices, *places, warps, *places))
    good = np.ones(len(missed), dtype=bool)
    for eye, place in zip(found, places, strict=True):
        good &= eye.good & (np.linalg.norm(eye.points_px - place, axis=1) < limit_px)
    tried.keyframe.vote(some.indices[good], np.full(int(good.sum()), -1, dtype=np.int8))
    return places[0][good]
