"""Square fiducials in one eye: any dictionary by name, regions around the last corners, full searches in between."""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from machine.description import StereoCamera
from server.vision.contracts import Array, Image
from server.vision.corners import refine_corners
from server.vision.errors import UnknownDictionaryError


@dataclass(frozen=True, slots=True)
class DetectionSettings:
    """How markers are searched."""

    full_search_every: int = 10  # pairs between full-frame searches while every marker is tracked
    perimeter_min_px: float = 32.0  # smaller quadrilaterals are not decoded
    region_margin_frac: float = 0.5  # of the marker's size, on every side of its last place
    refine: bool = True


@dataclass(frozen=True, slots=True)
class FoundMarker:
    """One decoded marker: id and corners (4, 2) [raw px], OpenCV order."""

    marker_id: int
    corners_px: Array


@dataclass(frozen=True, slots=True)
class EyeDetection:
    """What one eye shows: one entry per id, and the ids that were seen at more than one place."""

    markers: dict[int, Array]
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
    cells = cells_along_side(dictionary)
    found = []
    for quad, marker_id in zip(corners, np.asarray(ids).reshape(-1), strict=True):
        start = np.asarray(quad, dtype=np.float64).reshape(4, 2)
        found.append(FoundMarker(int(marker_id), refine_corners(image, start, cells, camera) if refine else start))
    return tuple(found)


@dataclass(slots=True)
class EyeDetector:
    """Markers of interest in one eye, pair after pair. Holds the last corners and nothing else."""

    camera: StereoCamera
    dictionary_name: str
    wanted: frozenset[int]
    settings: DetectionSettings = field(default_factory=DetectionSettings)
    _dictionary: "cv2.aruco.Dictionary" = field(init=False)
    _last: dict[int, Array] = field(init=False, default_factory=dict)
    _repeated: frozenset[int] = field(init=False, default=frozenset())
    _since_full: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self._dictionary = dictionary_by_name(self.dictionary_name)

    def detect(self, image: Image) -> EyeDetection:
        """Wanted markers in the next image of this eye."""
        self._since_full += 1
        if self._last and self._since_full < self.settings.full_search_every:
            markers = self._in_regions(image)
            if len(markers) == len(self._last):
                self._last = markers
                return EyeDetection(dict(markers), self._repeated, full_search=False)
        return self._full(image)

    def _find(self, image: Image) -> tuple[FoundMarker, ...]:
        return find_markers(image, self._dictionary, self.settings.perimeter_min_px, refine=False)

    def _refined(self, image: Image, corners: Array) -> Array:
        if not self.settings.refine:
            return corners
        return refine_corners(image, corners, cells_along_side(self._dictionary), self.camera)

    def _in_regions(self, image: Image) -> dict[int, Array]:
        markers = {}
        for marker_id, last in self._last.items():
            corner = self._region(image, last)
            left, top, right, bottom = corner
            for found in self._find(np.ascontiguousarray(image[top:bottom, left:right])):
                if found.marker_id == marker_id:
                    markers[marker_id] = self._refined(image, found.corners_px + np.array([left, top]))
        return markers

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
        found = [
            replace(marker, corners_px=self._refined(image, marker.corners_px))
            for marker in found
            if marker.marker_id not in self._repeated
        ]
        self._last = {marker.marker_id: marker.corners_px for marker in found}
        return EyeDetection(dict(self._last), self._repeated, full_search=True)
