"""Corners worth tracking, spread over the image, and where not to look."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from server.vision.contracts import Array, Image

BORDER_PX = 14  # a patch and its gradient must fit in
QUALITY_FRAC = 0.003  # of the image's strongest corner
STRENGTH_MIN = 2e-5  # smaller eigenvalue of the gradient matrix, cv2's scale: sensor noise of 2 grey levels gives 5e-6
BLOCK_PX = 5
COLUMNS, ROWS = 8, 5  # of the image's coarse cells
N_CELLS = COLUMNS * ROWS
SPACING_FRAC = 0.6  # of a cell, to points that are tracked already


def allowed_mask(shape: tuple[int, int], polygons_px: Sequence[Array]) -> Image:
    """255 where features may lie (h, w): away from the border and outside all polygons (k, 2) [px]."""
    mask = np.zeros(shape, np.uint8)
    mask[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = 255
    for polygon in polygons_px:
        cv2.fillPoly(mask, [np.round(polygon).astype(np.int32).reshape(-1, 1, 2)], 0)
    return mask


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
        cv2.circle(free, (int(x), int(y)), max(4, int(SPACING_FRAC * cell)), 0, -1)
    strength = np.asarray(cv2.cornerMinEigenVal(image, BLOCK_PX, ksize=3))
    strength = np.where(free > 0, strength, 0.0)
    rows, columns = height // cell, width // cell
    cells = strength[: rows * cell, : columns * cell].reshape(rows, cell, columns, cell).transpose(0, 2, 1, 3)
    cells = cells.reshape(rows, columns, cell * cell)
    best = cells.argmax(axis=2)
    peak = np.take_along_axis(cells, best[:, :, None], axis=2)[:, :, 0]
    row, column = np.nonzero(peak > max(QUALITY_FRAC * float(peak.max(initial=0.0)), STRENGTH_MIN))
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


def coverage(points_px: Array, shape: tuple[int, int]) -> int:
    """How many of the image's coarse cells hold a point."""
    return len(np.unique(cell_numbers(points_px, shape)))
