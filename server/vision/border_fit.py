"""Does a marker's black border lie where its printed cells say it is? A straight cover over the border looks clean."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from server.vision.contracts import Array, Image
from server.vision.edge_fit import side_length_min
from server.vision.quadrilateral import grey_at, of_unit_square

SAMPLES_PER_CELL = 4  # samples along and across a cell
BORDER_SHIFT_CELLS = 0.15  # how far a side is tried outward and inward
CELL_MIN_PX = 4.0  # smaller cells do not show their parts
MOVED_MIN_CELLS, MOVED_MIN_PX = 0.10, 0.8  # clean ones stay below 0.07 and 0.6, in shade and blur
NO_MATCH = -2.0


def printed_pattern(white: NDArray[np.bool_]) -> Array:
    """White cells (n, n) as the inner samples (k, k) see them, k = (n - 2) SAMPLES_PER_CELL: less their mean and their
    slope.

    Less their slope, so that light that falls off across the marker says nothing.
    """
    fine = np.kron(white[1:-1, 1:-1], np.ones((SAMPLES_PER_CELL, SAMPLES_PER_CELL))).astype(np.float64)
    along = _cell_sample_positions(len(white)) - 0.5
    fine -= fine.mean()
    for axis in (0, 1):
        slope = np.tensordot(along, fine, axes=(0, axis)).sum() / (len(along) * np.sum(along**2))
        fine -= slope * (along[:, None] if axis == 0 else along[None, :])
    return np.ascontiguousarray(fine)


def _cell_sample_positions(cells: int) -> Array:
    return np.asarray(
        (np.arange((cells - 2) * SAMPLES_PER_CELL) + 0.5) / (cells * SAMPLES_PER_CELL) + 1.0 / cells, dtype=np.float64
    )


@njit(cache=True, nogil=True)
def _pattern_correlation(image: Image, corners: Array, pattern: Array) -> float:
    """Correlation of the picture with the printed cells where corners (4, 2) put them, less the slope of the light."""
    k = pattern.shape[0]
    cells = k // SAMPLES_PER_CELL + 2
    good, place = of_unit_square(corners, 1e-9)
    if not good:
        return NO_MATCH
    a, b, c, d, e, f, g, h = place
    total, squares, along, across, product, pattern2, place2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for row in range(k):
        t = (row + 0.5) / (cells * SAMPLES_PER_CELL) + 1.0 / cells
        place2 += (t - 0.5) ** 2
        for column in range(k):
            s = (column + 0.5) / (cells * SAMPLES_PER_CELL) + 1.0 / cells
            w = g * s + h * t + 1.0
            grey = grey_at(image, (a * s + b * t + c) / w, (d * s + e * t + f) / w)
            if grey < 0.0:
                return NO_MATCH
            total += grey
            squares += grey * grey
            along += grey * (s - 0.5)
            across += grey * (t - 0.5)
            product += grey * pattern[row, column]
            pattern2 += pattern[row, column] ** 2
    left = squares - total * total / (k * k) - (along * along + across * across) / (k * place2)
    if left * pattern2 <= 0.0:
        return NO_MATCH
    return product / np.sqrt(left * pattern2)


@njit(cache=True, nogil=True)
def sides_moved_in(image: Image, corners: Array, pattern: Array) -> Array:
    """How far each side (4,) lies inside of where the printed cells put it [cells]; 0 where nothing can be said.

    Model:   the side's two corners are moved along the neighbouring sides, outward and inward; the vertex of the
             parabola through the three correlations. Of a side that was covered it lies outward.
    Args:    image: grey (h, w). corners (4, 2) [px], top left first, clockwise as printed. pattern: `printed_pattern`.
    """
    moved = np.zeros(4)
    cells = pattern.shape[0] // SAMPLES_PER_CELL + 2
    here = _pattern_correlation(image, corners, pattern)
    tried, found = np.empty((4, 2)), np.zeros(2)
    for side in range(4):
        i, j, before, behind = side, (side + 1) % 4, (side + 3) % 4, (side + 2) % 4
        for way in range(2):
            share = (1.0 - 2.0 * way) * BORDER_SHIFT_CELLS / cells
            tried[:] = corners
            for axis in range(2):
                tried[i, axis] += share * (corners[i, axis] - corners[before, axis])
                tried[j, axis] += share * (corners[j, axis] - corners[behind, axis])
            found[way] = _pattern_correlation(image, tried, pattern)
        if min(here, found[0], found[1]) <= NO_MATCH:
            continue
        bend = found[0] - 2.0 * here + found[1]
        if bend < -1e-9:
            moved[side] = min(
                max(0.5 * BORDER_SHIFT_CELLS * (found[1] - found[0]) / bend, -3.0 * BORDER_SHIFT_CELLS),
                3.0 * BORDER_SHIFT_CELLS,
            )
        elif found[0] > found[1]:
            moved[side] = 3.0 * BORDER_SHIFT_CELLS
    return moved


def border_covered(image: Image, corners_px: Array, pattern: Array, bow_px: float = 0.0) -> bool:
    """Whether something straight and white lies over a marker's border: a side is further in than its cells say.

    Args: as `sides_moved_in`. bow_px: how far the lens bows a side, which the cells follow and the corners do not.
    """
    cell_px = side_length_min(corners_px) / (pattern.shape[0] // SAMPLES_PER_CELL + 2)
    if not cell_px >= CELL_MIN_PX:
        return False
    moved = float(sides_moved_in(image, np.ascontiguousarray(corners_px, dtype=np.float64), pattern).max())
    return moved > MOVED_MIN_CELLS and moved * cell_px > MOVED_MIN_PX + bow_px


@njit(cache=True, nogil=True)
def sides_without_margin(image: Image, corners: Array, white: NDArray[np.bool_]) -> int:
    """How many sides (0 to 4) have no white half a cell outside of the black border.

    Model:   white ends halfway between the means of the cells printed white and black; a side has none where most of
             its places, half a cell out, are darker. Places beyond the picture say nothing.
    Args:    image: grey (h, w). corners (4, 2) [px], top left first, clockwise as printed. white (n, n): the cells.
    """
    n = white.shape[0]
    good, place = of_unit_square(corners, 1e-9)
    if not good:
        return 0
    a, b, c, d, e, f, g, h = place
    bright, dark, n_bright, n_dark = 0.0, 0.0, 0, 0
    for row in range(n):
        for column in range(n):
            s, t = (column + 0.5) / n, (row + 0.5) / n
            w = g * s + h * t + 1.0
            grey = grey_at(image, (a * s + b * t + c) / w, (d * s + e * t + f) / w)
            if grey < 0.0:
                continue
            if white[row, column]:
                bright, n_bright = bright + grey, n_bright + 1
            else:
                dark, n_dark = dark + grey, n_dark + 1
    if n_bright == 0 or n_dark == 0:
        return 0
    limit, bare = 0.5 * (bright / n_bright + dark / n_dark), 0
    for side in range(4):
        darker, seen = 0, 0
        for k in range(n):
            along = (k + 0.5) / n
            out = -0.5 / n if side in (0, 3) else 1.0 + 0.5 / n
            s, t = (along, out) if side in (0, 2) else (out, along)
            w = g * s + h * t + 1.0
            grey = grey_at(image, (a * s + b * t + c) / w, (d * s + e * t + f) / w)
            if grey >= 0.0:
                seen += 1
                darker += grey < limit
        bare += 2 * darker > seen and seen > 0
    return bare
