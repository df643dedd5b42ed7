"""Markers in one eye, pair after pair: followed by their sides, else searched near their last place, else everywhere.

Most pairs need no search at all. A whole-frame search comes round all the same: it finds what is new, and an id that is
at two places. While those that are known are large it runs on the picture at half size."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.description import StereoCamera
from server.vision.border_fit import border_covered, printed_pattern
from server.vision.contracts import Array, Image
from server.vision.edge_fit import SideFit, fit_corners, side_length_min, side_sags
from server.vision.marker_search import (
    FoundMarker,
    cells_along_side,
    dictionary_by_name,
    find_inverted,
    find_markers,
    marker_cells,
    refined_marker,
    require_ids,
    same_place,
    wrong_cells,
)

#: Searches in a row that missed a marker, at which white-on-black prints are looked for: soon, then twice again.
INVERTED_SEARCH_MISSES = (2, 8, 32)

WRONG_CELLS_MAX = 0
SHAPE_CHANGE_MAX_FRAC = 0.10  # of a side's length from pair to pair; more does not come from a crane's motion
SAG_UPDATE_MOTION_MIN_PX = 0.5  # the sag of the sides is computed again once the corners have moved by this much


@dataclass(slots=True)
class _TrackedMarker:
    """What is remembered of one marker: its last two places, and how the lens bows its sides there."""

    corners_px: Array
    before_px: Array | None
    sags_px: Array
    sags_at_px: Array


class MarkerFollower:
    """The markers of one eye whose sides were clean in the last pair.

    `follow_marker` answers only when the sides are clean again *and* every printed cell reads as this id does, upright
    as before; anything else is left to the search.
    """

    def __init__(self, camera: StereoCamera, dictionary: "cv2.aruco.Dictionary") -> None:
        self._camera = camera
        self._dictionary = dictionary
        self._cells: dict[int, NDArray[np.bool_]] = {}
        self._patterns: dict[int, Array] = {}
        self._followed: dict[int, _TrackedMarker] = {}

    def follow_marker(self, marker_id: int, image: Image) -> FoundMarker | None:
        """The marker in the next image of this eye; None where it must be searched."""
        known = self._followed.get(marker_id)
        if known is None:
            return None
        expected = known.corners_px if known.before_px is None else 2.0 * known.corners_px - known.before_px
        sags = self._cached_side_sags(known, expected)
        fit, corners = fit_corners(image, expected, cells_along_side(self._dictionary), sags)
        if fit is not SideFit.CLEAN or not _same_shape(corners, np.ascontiguousarray(known.corners_px)):
            return None
        if wrong_cells(image, np.ascontiguousarray(corners), self._cached_marker_cells(marker_id)) > WRONG_CELLS_MAX:
            return None
        if border_covered(image, corners, self._cached_printed_pattern(marker_id), float(np.abs(sags).max())):
            return None
        return FoundMarker(marker_id, corners, fit)

    def store_marker_positions(self, found: dict[int, FoundMarker]) -> None:
        """Take over where the markers are in this pair; what is not clean is forgotten."""
        followed: dict[int, _TrackedMarker] = {}
        for marker_id, marker in found.items():
            if marker.side_fit is not SideFit.CLEAN:
                continue
            last = self._followed.get(marker_id)
            if last is None:
                sags = side_sags(self._camera, marker.corners_px)
                followed[marker_id] = _TrackedMarker(marker.corners_px, None, sags, marker.corners_px)
            else:
                followed[marker_id] = _TrackedMarker(marker.corners_px, last.corners_px, last.sags_px, last.sags_at_px)
        self._followed = followed

    def _cached_side_sags(self, known: _TrackedMarker, corners_px: Array) -> Array:
        if float(np.abs(corners_px - known.sags_at_px).max()) > SAG_UPDATE_MOTION_MIN_PX:
            known.sags_px, known.sags_at_px = side_sags(self._camera, corners_px), corners_px
        return known.sags_px

    def _cached_marker_cells(self, marker_id: int) -> NDArray[np.bool_]:
        if marker_id not in self._cells:
            self._cells[marker_id] = marker_cells(self._dictionary, marker_id)
        return self._cells[marker_id]

    def _cached_printed_pattern(self, marker_id: int) -> Array:
        if marker_id not in self._patterns:
            self._patterns[marker_id] = printed_pattern(self._cached_marker_cells(marker_id))
        return self._patterns[marker_id]


@njit(cache=True, nogil=True)
def _same_shape(corners_px: Array, before_px: Array) -> bool:
    for i in range(4):
        j = (i + 1) % 4
        side = math.hypot(corners_px[j, 0] - corners_px[i, 0], corners_px[j, 1] - corners_px[i, 1])
        before = math.hypot(before_px[j, 0] - before_px[i, 0], before_px[j, 1] - before_px[i, 1])
        if not abs(side - before) <= SHAPE_CHANGE_MAX_FRAC * before + 1.0:
            return False
    return True


@dataclass(frozen=True, slots=True)
class DetectionSettings:
    """How markers are searched."""

    full_search_every: int = 8  # pairs between searches of the whole picture while all are tracked: one in a look
    full_search_missing_every: int = 3  # the same while some are not ...
    full_search_missing_every_max: int = 9  # ... and once they have been missing for long
    perimeter_min_px: float = 32.0  # smaller quadrilaterals are not decoded
    half_size_side_min_px: float = 40.0  # from this side on a marker is found at half size, too
    region_margin_frac: float = 0.5  # of the marker's size, on every side of its last place
    refine: bool = True


@dataclass(frozen=True, slots=True)
class EyeDetection:
    """What one eye shows: markers with clean sides, covered ones, and the ids seen at more than one place."""

    markers: dict[int, Array]
    covered: dict[int, Array]  # decoded, but a side is not a clean edge: something is in front of it
    repeated_ids: frozenset[int]
    full_search: bool
    no_margin: frozenset[int] = frozenset()  # of the covered ones: printed without white around the black border
    inverted_ids: frozenset[int] = frozenset()  # missing, but seen white on black at the last look for such prints


class EyeDetector:
    """Markers of interest in one eye, pair after pair. Holds the last places and nothing else.

    `extra`: ids that are read where they show, but are not missed where they do not, nor fitted: those of boards.
    `phase`: in which pair of each period the periodic search comes, so that two eyes do not search in the same pair.
    """

    def __init__(
        self,
        camera: StereoCamera,
        dictionary_name: str,
        wanted: frozenset[int],
        settings: DetectionSettings | None = None,
        phase: int = 0,
        extra: frozenset[int] = frozenset(),
    ) -> None:
        self._camera = camera
        self._wanted = wanted
        self._read = wanted | extra
        self._dictionary = dictionary_by_name(dictionary_name)
        require_ids(self._dictionary, dictionary_name, self._read)
        self._settings = settings or DetectionSettings()
        self._follower = MarkerFollower(camera, self._dictionary)
        self._last: dict[int, FoundMarker] = {}
        self._repeated: frozenset[int] = frozenset()
        self._phase = phase
        self._pair = -1
        self._missed_searches = 1
        self._inverted: frozenset[int] = frozenset()

    def detect(self, image: Image) -> EyeDetection:
        """Wanted markers in the next image of this eye."""
        self._pair += 1
        due = self._pair % self._full_search_period() == self._phase % self._full_search_period()
        if not self._last:
            return self._search_whole_image(image) if due else self._record_detection({}, full_search=False)
        tracked = self._track_markers(image)
        if len(tracked) < len(self._last):
            return self._search_whole_image(image)
        return self._search_whole_image(image, tracked) if due else self._record_detection(tracked, full_search=False)

    def _full_search_period(self) -> int:
        """Pairs from one whole search to the next."""
        settings = self._settings
        if self._missed_searches == 0:
            return settings.full_search_every
        if not self._last:  # nothing at all: every pair for a while, then as rarely as for a missing one
            return 1 if self._missed_searches <= 3 else settings.full_search_missing_every
        longer = settings.full_search_missing_every * (1 + self._missed_searches // 4)
        return min(longer, settings.full_search_missing_every_max)

    def _record_detection(self, found: dict[int, FoundMarker], full_search: bool) -> EyeDetection:
        self._last = found
        if self._settings.refine:
            self._follower.store_marker_positions(found)
        clean = {marker.marker_id: marker.corners_px for marker in found.values() if not marker.covered}
        covered = {marker.marker_id: marker.corners_px for marker in found.values() if marker.covered}
        bare = frozenset(marker.marker_id for marker in found.values() if marker.side_fit is SideFit.NO_MARGIN)
        return EyeDetection(clean, covered, self._repeated, full_search, bare, self._inverted - found.keys())

    def _detect_markers(self, image: Image) -> tuple[FoundMarker, ...]:
        return find_markers(image, self._dictionary, self._settings.perimeter_min_px)

    def _refined_if_wanted(self, marker: FoundMarker, image: Image) -> FoundMarker:
        fitted = self._settings.refine and marker.marker_id in self._wanted
        return refined_marker(marker, image, self._dictionary, self._camera) if fitted else marker

    def _track_markers(self, image: Image) -> dict[int, FoundMarker]:
        """The last pair's markers that are still there, each followed or found near its last place."""
        tracked = {}
        for marker_id, last in self._last.items():
            found = self._follower.follow_marker(marker_id, image) or self._find_near_last(last, image)
            if found is not None:
                tracked[marker_id] = found
        return tracked

    def _find_near_last(self, last: FoundMarker, image: Image) -> FoundMarker | None:
        left, top, right, bottom = self._search_region(image, last.corners_px)
        for found in self._detect_markers(np.ascontiguousarray(image[top:bottom, left:right])):
            if found.marker_id == last.marker_id:
                return self._refined_if_wanted(
                    FoundMarker(last.marker_id, found.corners_px + np.array([left, top])), image
                )
        return None

    def _search_region(self, image: Image, corners: Array) -> tuple[int, int, int, int]:
        height, width = image.shape
        low, high = corners.min(axis=0), corners.max(axis=0)
        margin = self._settings.region_margin_frac * float((high - low).max()) + 8.0
        left, top = np.maximum(np.floor(low - margin), 0).astype(int)
        right, bottom = np.minimum(np.ceil(high + margin) + 1, [width, height]).astype(int)
        return int(left), int(top), int(right), int(bottom)

    def _search_whole_image(self, image: Image, tracked: dict[int, FoundMarker] | None = None) -> EyeDetection:
        """Search the whole picture; `tracked`: what is known to be there, whose corners need no second fit."""
        known = tracked or {}
        found = [marker for marker in self._find_all_markers(image, known) if marker.marker_id in self._read]
        found += [marker for marker in known.values() if not any(same_place(marker, other) for other in found)]
        ids = [marker.marker_id for marker in found]
        self._repeated = frozenset(marker_id for marker_id in ids if ids.count(marker_id) > 1)
        new = {marker.marker_id: marker for marker in found if marker.marker_id not in known}
        everything = known | {marker_id: self._refined_if_wanted(marker, image) for marker_id, marker in new.items()}
        single = {marker_id: marker for marker_id, marker in everything.items() if marker_id not in self._repeated}
        self._missed_searches = 0 if self._wanted <= single.keys() else self._missed_searches + 1
        if self._missed_searches in INVERTED_SEARCH_MISSES or not self._missed_searches:
            self._inverted = self._white_on_black(image) if self._missed_searches else frozenset()
        return self._record_detection(single, full_search=True)

    def _white_on_black(self, image: Image) -> frozenset[int]:
        found = find_inverted(image, self._dictionary, self._settings.perimeter_min_px)
        return frozenset(marker.marker_id for marker in found) & self._wanted

    def _find_all_markers(self, image: Image, known: dict[int, FoundMarker]) -> tuple[FoundMarker, ...]:
        """Every marker of the picture; at half size where those that are known are large."""
        sides = [side_length_min(marker.corners_px) for marker in known.values()]
        if min(sides, default=0.0) < self._settings.half_size_side_min_px:
            return self._detect_markers(image)
        half = np.asarray(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)
        found = find_markers(half, self._dictionary, 0.5 * self._settings.perimeter_min_px)
        return tuple(FoundMarker(marker.marker_id, (marker.corners_px + 0.5) * 2.0 - 0.5) for marker in found)
