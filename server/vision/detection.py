"""Square fiducials in one eye: any dictionary by name, regions around the last corners, full searches in between."""

from dataclasses import dataclass, field

import cv2
import numpy as np

from machine.description import StereoCamera
from server.vision.contracts import Array, Image
from server.vision.corners import refine_corners
from server.vision.edge_fit import SideFit
from server.vision.errors import UnknownDictionaryError


@dataclass(frozen=True, slots=True)
class DetectionSettings:
    """How markers are searched."""

    full_search_every: int = 10  # pairs between full-frame searches while every wanted marker is tracked
    full_search_missing_every: int = 3  # the same while some are not
    perimeter_min_px: float = 32.0  # smaller quadrilaterals are not decoded
    region_margin_frac: float = 0.5  # of the marker's size, on every side of its last place
    refine: bool = True


@dataclass(frozen=True, slots=True)
class FoundMarker:
    """One decoded marker: id and corners (4, 2) [raw px], OpenCV order."""

    marker_id: int
    corners_px: Array
    covered: bool = False  # a side is no clean edge; the corners are coarse


@dataclass(frozen=True, slots=True)
class EyeDetection:
    """What one eye shows: one entry per id with clean sides, the covered ones, and the ids seen at more than one place."""

    markers: dict[int, Array]
    covered: dict[int, Array]  # decoded, but a side is no clean edge: something is in front of it
    repeated_ids: frozenset[int]
    full_search: bool


def dictionary_names() -> tuple[str, ...]:
    """Names of all ArUco and AprilTag dictionaries that can be given in a machine file."""
    return tuple(sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_")))


def dictionary_by_name(name: str) -> "cv2.aruco.Dictionary":
    """The dictionary of a name such as DICT_4X4_50 or DICT_APRILTAG_36h11.

    Raises: UnknownDictionaryError with the known names.
    """
    if name not in dictionary_names():
        raise UnknownDictionaryError(
            f"marker dictionary '{name}' is unknown; give one of {', '.join(dictionary_names())}"
        )
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def cells_along_side(dictionary: "cv2.aruco.Dictionary") -> int:
    """Cells along one side, the black border included."""
    return int(dictionary.markerSize) + 2


def _parameters(image_size_px: int, perimeter_min_px: float) -> "cv2.aruco.DetectorParameters":
    parameters = cv2.aruco.DetectorParameters()
    parameters.minMarkerPerimeterRate = float(np.clip(perimeter_min_px / image_size_px, 1e-3, 0.3))
    parameters.maxMarkerPerimeterRate = 8.0  # a region is hardly larger than its marker
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    return parameters


def find_markers(
    image: Image,
    dictionary: "cv2.aruco.Dictionary",
    perimeter_min_px: float = 32.0,
    camera: StereoCamera | None = None,
    refine: bool = True,
) -> tuple[FoundMarker, ...]:
    """Every marker of a dictionary in one grey image (h, w), corners refined; empty when there is none.

    Pixel convention: centre of the top left pixel is (0, 0).
    """
    if min(image.shape) < 12:
        return ()
    detector = cv2.aruco.ArucoDetector(dictionary, _parameters(max(image.shape), perimeter_min_px))
    corners, ids, _ = detector.detectMarkers(image)
    if ids is None:
        return ()
    found = (
        FoundMarker(int(marker_id), np.asarray(quad, dtype=np.float64).reshape(4, 2))
        for quad, marker_id in zip(corners, np.asarray(ids).reshape(-1), strict=True)
    )
    return tuple(refined(marker, image, dictionary, camera) if refine else marker for marker in found)


def refined(
    marker: FoundMarker, image: Image, dictionary: "cv2.aruco.Dictionary", camera: StereoCamera | None
) -> FoundMarker:
    """The marker with sub-pixel corners."""
    fit, corners = refine_corners(image, marker.corners_px, cells_along_side(dictionary), camera)
    return FoundMarker(marker.marker_id, corners, fit is SideFit.COVERED)


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
        return find_markers(image, self._dictionary, self.settings.perimeter_min_px, refine=False)

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
