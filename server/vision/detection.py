"""Markers in one eye, pair after pair: regions around the last corners, full searches in between."""

from dataclasses import dataclass, field

import cv2
import numpy as np

from machine.description import StereoCamera
from server.vision.contracts import Array, Image
from server.vision.marker_search import FoundMarker, dictionary_by_name, find_markers, refined


@dataclass(frozen=True, slots=True)
class DetectionSettings:
    """How markers are searched."""

    full_search_every: int = 10  # pairs between full-frame searches while every wanted marker is tracked
    full_search_missing_every: int = 3  # the same while some are not
    perimeter_min_px: float = 32.0  # smaller quadrilaterals are not decoded
    region_margin_frac: float = 0.5  # of the marker's size, on every side of its last place
    refine: bool = True


@dataclass(frozen=True, slots=True)
class EyeDetection:
    """What one eye shows: markers with clean sides, covered ones, and the ids seen at more than one place."""

    markers: dict[int, Array]
    covered: dict[int, Array]  # decoded, but a side is no clean edge: something is in front of it
    repeated_ids: frozenset[int]
    full_search: bool


@dataclass(slots=True)
class EyeDetector:
    """Markers of interest in one eye, pair after pair. Holds the last corners and nothing else."""

    camera: StereoCamera
    dictionary_name: str
    wanted: frozenset[int]
    settings: DetectionSettings = field(default_factory=DetectionSettings)
    _dictionary: "cv2.aruco.Dictionary" = field(init=False)
    _last: dict[int, FoundMarker] = field(init=False, default_factory=dict)
    _repeated: frozenset[int] = field(init=False, default=frozenset())
    _since_full: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self._dictionary = dictionary_by_name(self.dictionary_name)

    def detect(self, image: Image) -> EyeDetection:
        """Wanted markers in the next image of this eye."""
        self._since_full += 1
        settings = self.settings
        complete = len(self._last) == len(self.wanted)
        pause = settings.full_search_every if complete else settings.full_search_missing_every
        if self._last and self._since_full < pause:
            tracked = self._in_regions(image)
            if len(tracked) == len(self._last):
                return self._keep(tracked, full_search=False)
        return self._full(image)

    def _keep(self, found: dict[int, FoundMarker], full_search: bool) -> EyeDetection:
        self._last = found
        clean = {one.marker_id: one.corners_px for one in found.values() if not one.covered}
        covered = {one.marker_id: one.corners_px for one in found.values() if one.covered}
        return EyeDetection(clean, covered, self._repeated, full_search)

    def _find(self, image: Image) -> tuple[FoundMarker, ...]:
        return find_markers(image, self._dictionary, self.settings.perimeter_min_px)

    def _refined(self, marker: FoundMarker, image: Image) -> FoundMarker:
        return refined(marker, image, self._dictionary, self.camera) if self.settings.refine else marker

    def _in_regions(self, image: Image) -> dict[int, FoundMarker]:
        tracked = {}
        for marker_id, last in self._last.items():
            left, top, right, bottom = self._region(image, last.corners_px)
            for found in self._find(np.ascontiguousarray(image[top:bottom, left:right])):
                if found.marker_id == marker_id:
                    moved = FoundMarker(marker_id, found.corners_px + np.array([left, top]))
                    tracked[marker_id] = self._refined(moved, image)
        return tracked

    def _region(self, image: Image, corners: Array) -> tuple[int, int, int, int]:
        height, width = image.shape
        low, high = corners.min(axis=0), corners.max(axis=0)
        margin = self.settings.region_margin_frac * float((high - low).max()) + 8.0
        left, top = np.maximum(np.floor(low - margin), 0).astype(int)
        right, bottom = np.minimum(np.ceil(high + margin) + 1, [width, height]).astype(int)
        return int(left), int(top), int(right), int(bottom)

    def _full(self, image: Image) -> EyeDetection:
        self._since_full = 0
        found = [marker for marker in self._find(image) if marker.marker_id in self.wanted]
        ids = [marker.marker_id for marker in found]
        self._repeated = frozenset(marker_id for marker_id in ids if ids.count(marker_id) > 1)
        single = (marker for marker in found if marker.marker_id not in self._repeated)
        return self._keep({marker.marker_id: self._refined(marker, image) for marker in single}, full_search=True)
