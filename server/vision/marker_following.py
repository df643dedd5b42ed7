"""From one pair to the next: a marker's sides are fitted straight from where they should be, without a new search."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from machine.description import StereoCamera
from server.vision.border_fit import border_covered, printed_pattern
from server.vision.contracts import Array, Image
from server.vision.corners import side_sags
from server.vision.edge_fit import SideFit, fit_corners
from server.vision.marker_code import marker_cells, wrong_cells
from server.vision.marker_search import FoundMarker, cells_along_side

WRONG_CELLS_MAX = 0
SHAPE_CHANGE_MAX_FRAC = 0.10  # of a side's length from pair to pair; more is no motion of a crane
TURN_MIN_PX = 0.5  # the sag of the sides is computed anew once the corners have moved by this much


@dataclass(slots=True)
class _Followed:
    """What is remembered of one marker: its last two places, and how the lens bows its sides there."""

    corners_px: Array
    before_px: Array | None
    sags_px: Array
    sags_at_px: Array


class MarkerFollower:
    """The markers of one eye whose sides were clean in the last pair.

    `follow` answers only when the sides are clean again *and* every printed cell reads as this id does, upright as
    before; anything else is left to the search.
    """

    def __init__(self, camera: StereoCamera, dictionary: "cv2.aruco.Dictionary") -> None:
        self._camera = camera
        self._dictionary = dictionary
        self._cells: dict[int, NDArray[np.bool_]] = {}
        self._patterns: dict[int, Array] = {}
        self._followed: dict[int, _Followed] = {}

    def follow(self, marker_id: int, image: Image) -> FoundMarker | None:
        """The marker in the next image of this eye; None where it must be searched."""
        known = self._followed.get(marker_id)
        if known is None:
            return None
        expected = known.corners_px if known.before_px is None else 2.0 * known.corners_px - known.before_px
        sags = self._sags(known, expected)
        fit, corners = fit_corners(image, expected, cells_along_side(self._dictionary), sags)
        if fit is not SideFit.CLEAN or not _same_shape(corners, known.corners_px):
            return None
        if wrong_cells(image, np.ascontiguousarray(corners), self._printed(marker_id)) > WRONG_CELLS_MAX:
            return None
        if border_covered(image, corners, self._pattern(marker_id), float(np.abs(sags).max())):
            return None
        return FoundMarker(marker_id, corners, fit)

    def remember(self, found: dict[int, FoundMarker]) -> None:
        """Take over where the markers are in this pair; what is not clean is forgotten."""
        followed: dict[int, _Followed] = {}
        for marker_id, marker in found.items():
            if marker.fit is not SideFit.CLEAN:
                continue
            last = self._followed.get(marker_id)
            if last is None:
                sags = side_sags(self._camera, marker.corners_px)
                followed[marker_id] = _Followed(marker.corners_px, None, sags, marker.corners_px)
            else:
                followed[marker_id] = _Followed(marker.corners_px, last.corners_px, last.sags_px, last.sags_at_px)
        self._followed = followed

    def _sags(self, known: _Followed, corners_px: Array) -> Array:
        if float(np.abs(corners_px - known.sags_at_px).max()) > TURN_MIN_PX:
            known.sags_px, known.sags_at_px = side_sags(self._camera, corners_px), corners_px
        return known.sags_px

    def _printed(self, marker_id: int) -> NDArray[np.bool_]:
        if marker_id not in self._cells:
            self._cells[marker_id] = marker_cells(self._dictionary, marker_id)
        return self._cells[marker_id]

    def _pattern(self, marker_id: int) -> Array:
        if marker_id not in self._patterns:
            self._patterns[marker_id] = printed_pattern(self._printed(marker_id))
        return self._patterns[marker_id]


def _same_shape(corners_px: Array, before_px: Array) -> bool:
    sides, before = (np.linalg.norm(np.roll(c, -1, axis=0) - c, axis=1) for c in (corners_px, before_px))
    return bool(np.all(np.abs(sides - before) <= SHAPE_CHANGE_MAX_FRAC * before + 1.0))
