"""Square fiducials in one image: any ArUco or AprilTag dictionary by name."""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.description import StereoCamera
from server.vision.border_fit import border_covered, printed_pattern, sides_without_margin
from server.vision.contracts import Array, Image
from server.vision.edge_fit import SideFit, refine_corners, side_sags
from server.vision.errors import UnknownDictionaryError
from server.vision.quadrilateral import grey_at, of_unit_square

IMAGE_SIDE_MIN_PX = 12  # of a picture; the smallest marker has 6 cells
MARGINLESS_SIDES_MIN = 3  # of four without white: a cover lies over one or two, and a print may touch something bright
DUPLICATE_DISTANCE_MAX_FRAC = 0.25  # of a marker's size: closer than that, two finds are one marker

CONTRAST_MIN_GREY = 12.0  # between the cells printed white and those printed black
MARKER_BORDER_CELLS = 1  # the black border
NO_MATCH = 1000


def marker_cells(dictionary: "cv2.aruco.Dictionary", marker_id: int) -> NDArray[np.bool_]:
    """Which cells are white (n, n), the black border included, row 0 at the top as printed."""
    n = int(dictionary.markerSize) + 2 * MARKER_BORDER_CELLS
    drawn = cv2.aruco.generateImageMarker(dictionary, marker_id, n, borderBits=MARKER_BORDER_CELLS)
    return np.ascontiguousarray(np.asarray(drawn) > 127)


@njit(cache=True, nogil=True)
def wrong_cells(image: Image, corners: Array, white: NDArray[np.bool_]) -> int:
    """How many cells of a printed square lie on the wrong side of the grey in the middle.

    Model:   homography from the unit square to the corners; each cell is the mean of its middle and four points around
             it; the limit is halfway between the means of the cells that should be white and black.
    Args:    image: grey (h, w). corners (4, 2) [px], top left first, clockwise as printed. white (n, n).
    Returns: count, 0 when all agree; `NO_MATCH` where it leaves the image or shows no contrast.
    """
    n = white.shape[0]
    good, place = of_unit_square(corners, 1e-9)
    if not good:
        return NO_MATCH
    a, b, c, d, e, f, g, h = place
    grey = np.zeros((n, n))
    for row in range(n):
        for column in range(n):
            for k in range(5):
                s = (column + 0.5 + (0.2 if k == 1 else -0.2 if k == 2 else 0.0)) / n
                t = (row + 0.5 + (0.2 if k == 3 else -0.2 if k == 4 else 0.0)) / n
                w = g * s + h * t + 1.0
                seen = grey_at(image, (a * s + b * t + c) / w, (d * s + e * t + f) / w)
                if seen < 0.0:
                    return NO_MATCH
                grey[row, column] += 0.2 * seen
    bright, dark, n_bright = 0.0, 0.0, 0
    for row in range(n):
        for column in range(n):
            if white[row, column]:
                bright += grey[row, column]
                n_bright += 1
            else:
                dark += grey[row, column]
    if n_bright == 0 or n_bright == n * n:
        return NO_MATCH
    bright, dark = bright / n_bright, dark / (n * n - n_bright)
    if bright - dark < CONTRAST_MIN_GREY:
        return NO_MATCH
    limit, wrong = 0.5 * (bright + dark), 0
    for row in range(n):
        for column in range(n):
            if (grey[row, column] > limit) != white[row, column]:
                wrong += 1
    return wrong


@dataclass(frozen=True, slots=True)
class FoundMarker:
    """One decoded marker: id and corners (4, 2) [raw px], OpenCV order."""

    marker_id: int
    corners_px: Array
    side_fit: SideFit | None = None  # how the refinement ended; None before it. Unless CLEAN the corners are coarse

    @property
    def covered(self) -> bool:
        """Whether a side is not a clean edge."""
        return self.side_fit in (SideFit.COVERED, SideFit.NO_MARGIN)


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


def require_ids(dictionary: "cv2.aruco.Dictionary", name: str, ids: Iterable[int]) -> None:
    """Every id must be one of the dictionary's.

    Raises: UnknownDictionaryError naming the ids and the range.
    """
    n = len(dictionary.bytesList)
    beyond = sorted(marker_id for marker_id in ids if not 0 <= marker_id < n)
    if beyond:
        raise UnknownDictionaryError(f"marker ids {beyond} are not in {name}; it has ids 0 to {n - 1}: print others")


def cells_along_side(dictionary: "cv2.aruco.Dictionary") -> int:
    """Cells along one side, the black border included."""
    return int(dictionary.markerSize) + 2


def search_parameters(image_size_px: int, perimeter_min_px: float) -> "cv2.aruco.DetectorParameters":
    """OpenCV's, for markers of at least this perimeter in an image of this size [px]; unrefined corners."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.minMarkerPerimeterRate = float(np.clip(perimeter_min_px / image_size_px, 1e-3, 0.3))
    parameters.maxMarkerPerimeterRate = 8.0  # a region is hardly larger than its marker
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    return parameters


def detect_markers(
    image: Image, dictionary: "cv2.aruco.Dictionary", parameters: "cv2.aruco.DetectorParameters"
) -> tuple[FoundMarker, ...]:
    """OpenCV's search with these parameters."""
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
    if ids is None:
        return ()
    return tuple(
        FoundMarker(int(marker_id), np.asarray(quad, dtype=np.float64).reshape(4, 2))
        for quad, marker_id in zip(corners, np.asarray(ids).reshape(-1), strict=True)
    )


def find_markers(
    image: Image, dictionary: "cv2.aruco.Dictionary", perimeter_min_px: float = 32.0
) -> tuple[FoundMarker, ...]:
    """Every marker of a dictionary in one grey image (h, w), corners as the contour gives them (about 0.7 px).

    Pixel convention: the centre of the top left pixel is (0, 0). A picture of less than 12 px shows none.
    """
    if min(image.shape) < IMAGE_SIDE_MIN_PX:  # a place that a smaller picture no longer has
        return ()
    return detect_markers(image, dictionary, search_parameters(max(image.shape), perimeter_min_px))


def find_inverted(
    image: Image, dictionary: "cv2.aruco.Dictionary", perimeter_min_px: float = 32.0
) -> tuple[FoundMarker, ...]:
    """Markers printed white on black, which no search for black on white finds."""
    return find_markers(np.asarray(255 - image, np.uint8), dictionary, perimeter_min_px)


def same_place(one: FoundMarker, other: FoundMarker) -> bool:
    """Whether two finds are the same printed marker."""
    if one.marker_id != other.marker_id:
        return False
    size = float(np.linalg.norm(one.corners_px[2] - one.corners_px[0]))
    apart = float(np.linalg.norm(one.corners_px.mean(axis=0) - other.corners_px.mean(axis=0)))
    return apart < DUPLICATE_DISTANCE_MAX_FRAC * size


def refined_marker(
    marker: FoundMarker, image: Image, dictionary: "cv2.aruco.Dictionary", camera: StereoCamera | None
) -> FoundMarker:
    """The marker with sub-pixel corners; coarse ones where something lies over its border, or it has no margin."""
    fit, corners = refine_corners(image, marker.corners_px, cells_along_side(dictionary), camera)
    cells = marker_cells(dictionary, marker.marker_id)
    if fit is SideFit.CLEAN and border_covered(
        image, corners, printed_pattern(cells), float(np.abs(side_sags(camera, corners)).max())
    ):
        fit, corners = SideFit.COVERED, marker.corners_px
    if fit is SideFit.COVERED and sides_without_margin(image, marker.corners_px, cells) >= MARGINLESS_SIDES_MIN:
        fit = SideFit.NO_MARGIN
    return FoundMarker(marker.marker_id, corners, fit)
