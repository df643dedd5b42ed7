"""Features of an image: corners worth tracking, places recognised in another image, and repetitions in itself."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from server.vision.contracts import Array, Image

BORDER_PX = 14  # a patch and its gradient must fit in
CORNER_QUALITY_MIN_FRAC = 0.003  # of the image's strongest corner
# Smaller eigenvalue of the gradient matrix, cv2's scale: sensor noise of 2 grey levels gives 5e-6
CORNER_STRENGTH_MIN = 2e-5
CORNER_BLOCK_PX = 5
COLUMNS, ROWS = 8, 5  # of the image's coarse cells
N_IMAGE_CELLS = COLUMNS * ROWS
CORNER_SPACING_FRAC = 0.6  # of a cell, to points that are tracked already


def allowed_mask(shape: tuple[int, int], polygons_px: Sequence[Array]) -> Image:
    """255 where features may lie (h, w): away from the border and outside all polygons (k, 2) [px]."""
    mask = np.zeros(shape, np.uint8)
    mask[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = 255
    for polygon in polygons_px:
        cv2.fillPoly(mask, [np.round(polygon).astype(np.int32).reshape(-1, 1, 2)], 0)
    return mask


def allowed_masks(shape: tuple[int, int], polygons_px: tuple[Sequence[Array], Sequence[Array]]) -> tuple[Image, Image]:
    """`allowed_mask` of the left and the right eye."""
    return allowed_mask(shape, polygons_px[0]), allowed_mask(shape, polygons_px[1])


def inside_mask(mask: Image, points_px: Array) -> NDArray[np.bool_]:
    """Which points (n, 2) lie on allowed pixels."""
    with np.errstate(invalid="ignore"):
        columns = np.nan_to_num(np.round(points_px), nan=-1.0, posinf=-1.0, neginf=-1.0).clip(-1, 1e6).astype(int)
    height, width = mask.shape
    good = (columns[:, 0] >= 0) & (columns[:, 0] < width) & (columns[:, 1] >= 0) & (columns[:, 1] < height)
    good[good] = mask[columns[good, 1], columns[good, 0]] > 0
    return good


def spread_corners(image: Image, mask: Image, count: int, occupied_px: Array) -> Array:
    """At most one strongest Shi-Tomasi corner per cell of a grid of about `count` cells, (n, 2) [px, whole numbers].

    Args:    image: grey (h, w). mask: 255 where corners may lie. occupied_px: points (m, 2) that keep corners away.
    Source:  Shi and Tomasi 1994; one per cell, so that no textured spot draws all of them.
    """
    height, width = image.shape
    cell = max(8, int(np.sqrt(height * width / count)))
    free = mask.copy()
    for x, y in np.round(occupied_px).astype(int):
        cv2.circle(free, (int(x), int(y)), max(4, int(CORNER_SPACING_FRAC * cell)), 0, -1)
    strength = np.asarray(cv2.cornerMinEigenVal(image, CORNER_BLOCK_PX, ksize=3))
    strength = np.where(free > 0, strength, 0.0)
    rows, columns = height // cell, width // cell
    cells = strength[: rows * cell, : columns * cell].reshape(rows, cell, columns, cell).transpose(0, 2, 1, 3)
    cells = cells.reshape(rows, columns, cell * cell)
    best = cells.argmax(axis=2)
    peak = np.take_along_axis(cells, best[:, :, None], axis=2)[:, :, 0]
    row, column = np.nonzero(peak > max(CORNER_QUALITY_MIN_FRAC * float(peak.max(initial=0.0)), CORNER_STRENGTH_MIN))
    place = best[row, column]
    return np.stack([column * cell + place % cell, row * cell + place // cell], axis=1).astype(np.float64)


def texture_grey(image: Image, points_px: Array, half_px: int = 7) -> float:
    """Median over the points (n, 2) [px] of the standard deviation of grey about each; 0 without points."""
    height, width = image.shape
    columns, rows = np.round(points_px).astype(int).T.reshape(2, -1)
    inside = (columns >= half_px) & (rows >= half_px) & (columns < width - half_px) & (rows < height - half_px)
    if not inside.any():
        return 0.0
    offsets = np.arange(-half_px, half_px + 1, 2)
    across, down = (
        columns[inside, None, None] + offsets[None, None, :],
        rows[inside, None, None] + offsets[None, :, None],
    )
    return float(np.median(image[down, across].std(axis=(1, 2))))


def cell_numbers(points_px: Array, shape: tuple[int, int]) -> NDArray[np.int64]:
    """Which of the image's coarse cells, 0 to 39, each point (n, 2) [px] lies in."""
    height, width = shape
    x = np.clip(points_px[:, 0] * COLUMNS / width, 0, COLUMNS - 1).astype(np.int64)
    y = np.clip(points_px[:, 1] * ROWS / height, 0, ROWS - 1).astype(np.int64)
    return y * COLUMNS + x


def covered_cell_count(points_px: Array, shape: tuple[int, int]) -> int:
    """How many of the image's coarse cells hold a point."""
    return len(np.unique(cell_numbers(points_px, shape)))


ORB_FEATURES_MAX = 1200
MATCH_RATIO_MAX = 0.85  # of the best distance to the second best
SELF_MATCH_SCALE = 0.5  # at which a picture is compared with itself
CORRELATION_LOBE_PX = 4  # at that scale: nearer, a picture resembles itself whatever it shows
REPETITION_PEAK_MIN_FRAC = 0.8  # of the strongest repetition: its neighbours on the same lattice
REPETITIONS_MAX = 4  # nearest repetitions
UNIQUE_RATIO_MAX = 0.8  # of the best dissimilarity to the second best: below, the best is unique (Lowe 2004)


def clear_matches(words: NDArray[Any], others: NDArray[Any], norm: int, ratio_max: float) -> "list[cv2.DMatch]":
    """Each word's nearest other word, where the second nearest is clearly farther (Lowe 2004)."""
    found = cv2.BFMatcher(norm).knnMatch(words, others, k=2)
    return [pair[0] for pair in found if len(pair) == 2 and pair[0].distance < ratio_max * pair[1].distance]


def recognise(first: Image, mask_first: Image, second: Image, mask_second: Image) -> tuple[Array, Array]:
    """Places (n, 2) [px] of the first image and where they seem to be in the second; many may be wrong.

    Source:  Rublee et al. 2011 (ORB); ratio test of Lowe 2004.
    """
    none = np.zeros((0, 2))
    orb = cv2.ORB.create(nfeatures=ORB_FEATURES_MAX, fastThreshold=10)
    places, descriptors = [], []
    for image, mask in ((first, mask_first), (second, mask_second)):
        points, found = orb.detectAndCompute(image, mask)
        if found is None or len(points) < 2:
            return none, none
        places.append(np.array([point.pt for point in points], dtype=np.float64))
        descriptors.append(found)
    good = clear_matches(descriptors[0], descriptors[1], cv2.NORM_HAMMING, MATCH_RATIO_MAX)
    chosen = np.array([(match.queryIdx, match.trainIdx) for match in good], dtype=np.int64).reshape(-1, 2)
    return places[0][chosen[:, 0]], places[1][chosen[:, 1]]


def repeats(image: Image, along_rows: bool = False) -> Array:
    """Ways (k, 2) [px] by which a picture may repeat itself, the nearest first; few or none where it does not.

    Model:   normalised correlation of its middle half, each way, with the whole: local maxima besides the main one.
    """
    small = cv2.resize(image, None, fx=SELF_MATCH_SCALE, fy=SELF_MATCH_SCALE, interpolation=cv2.INTER_AREA)
    top, left = small.shape[0] // 4, small.shape[1] // 4
    middle = small[top : small.shape[0] - top, left : small.shape[1] - left]
    if along_rows:
        small, top = small[top : small.shape[0] - top], 0
    likeness = np.asarray(cv2.matchTemplate(small, middle, cv2.TM_CCOEFF_NORMED))
    peaks = likeness >= np.asarray(cv2.dilate(likeness, np.ones((2 * CORRELATION_LOBE_PX + 1,) * 2, np.uint8)))
    ways = np.argwhere(peaks & (likeness > 0.0))[:, ::-1] - [left, top]
    heights = likeness[ways[:, 1] + top, ways[:, 0] + left]
    apart = np.linalg.norm(ways, axis=1)
    ways, heights = ways[apart > CORRELATION_LOBE_PX], heights[apart > CORRELATION_LOBE_PX]
    ways = ways[heights >= REPETITION_PEAK_MIN_FRAC * heights.max(initial=0.0)]
    return np.asarray(
        ways[np.argsort(np.linalg.norm(ways, axis=1))][:REPETITIONS_MAX] / SELF_MATCH_SCALE, dtype=np.float64
    )
