"""A pair at an eighth of its size, and what its cells show: all that the cheap monitors need, read in one pass.

The full pictures are only read, one line in eight; the buffers are made once and filled in turn.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from server.vision.contracts import Array, Image

THUMB_ROWS = 90  # wanted; a picture of 720 rows is read in every 8th
THUMBNAIL_UNITS_PER_GREY = 4.0  # thumbnail values are sums of 2 x 2 pixels
CELL_ROWS, CELL_COLS = 9, 16
CHANGE_CLIP_GREY = 12.0  # a change beyond this is content that moved, not light
IMAGE_SIDE_MIN_PX = 8
MEAN, STD, WHITE, CHANGE, GAIN, ENERGY, ENERGY_BEFORE, COMMON, SAME = range(9)
N_CELL_STATISTICS = 9
WHITE_GREY = 250

Thumb = NDArray[np.int16]


@njit(cache=True, nogil=True)
def _fill_thumbnails(image: Image, step: int, grey: Thumb, fine: Thumb) -> None:
    """Sums of 2 x 2 pixels, and their mixed second difference: sensor noise without the picture's own edges."""
    for i in range(grey.shape[0]):
        y = i * step
        for j in range(grey.shape[1]):
            x = j * step
            a, b = np.int16(image[y, x]), np.int16(image[y, x + 1])
            c, d = np.int16(image[y + 1, x]), np.int16(image[y + 1, x + 1])
            grey[i, j] = a + b + c + d
            fine[i, j] = a - b - c + d


@njit(cache=True, nogil=True)
def _compute_cell_statistics(
    grey: Thumb, fine: Thumb, grey_before: Thumb, fine_before: Thumb, white: int, out: Array
) -> None:
    """Fields of every cell (9, 16, 9): see `EyeCells`."""
    rows, cols = grey.shape
    cell_rows, cell_cols = out.shape[0], out.shape[1]
    clip = CHANGE_CLIP_GREY * THUMBNAIL_UNITS_PER_GREY
    for p in range(cell_rows):
        top, low = p * rows // cell_rows, (p + 1) * rows // cell_rows
        for q in range(cell_cols):
            left, right = q * cols // cell_cols, (q + 1) * cols // cell_cols
            total, squares, n_white, change, gain = 0, 0, 0, 0, 0.0
            energy, before, common, same = 0, 0, 0, 0
            for i in range(top, low):
                for j in range(left, right):
                    g, f, f0 = int(grey[i, j]), int(fine[i, j]), int(fine_before[i, j])
                    d = g - int(grey_before[i, j])
                    total += g
                    squares += g * g
                    n_white += g >= white
                    change += abs(d)
                    gain += min(max(float(d), -clip), clip)
                    energy += f * f
                    before += f0 * f0
                    common += f * f0
                    same += d == 0 and f == f0
            n = max((low - top) * (right - left), 1)
            mean = total / n
            out[p, q, 0] = mean / 4.0
            out[p, q, 1] = np.sqrt(max(squares / n - mean * mean, 0.0)) / 4.0
            out[p, q, 2] = n_white / n
            out[p, q, 3] = change / n / 4.0
            out[p, q, 4] = gain / n / 4.0
            out[p, q, 5] = energy / n
            out[p, q, 6] = before / n
            out[p, q, 7] = common / n
            out[p, q, 8] = same / n


@njit(cache=True, nogil=True)
def _row_steps(grey: Thumb, out: Array) -> int:
    """Mean absolute step from row to row [grey levels]; returns how many rows at the bottom are one grey."""
    rows, cols = grey.shape
    for i in range(rows - 1):
        total = 0
        for j in range(cols):
            total += abs(int(grey[i + 1, j]) - int(grey[i, j]))
        out[i] = total / cols / 4.0
    count = 0
    for i in range(rows - 1, -1, -1):
        low = high = grey[i, 0]
        for j in range(1, cols):
            low, high = min(low, grey[i, j]), max(high, grey[i, j])
        if high - low > 2:
            break
        count += 1
    return count


@njit(cache=True, nogil=True)
def _grey_standard_deviation(cells: Array) -> float:
    """Between and within cells."""
    n = cells.shape[0] * cells.shape[1]
    total, squares = 0.0, 0.0
    for p in range(cells.shape[0]):
        for q in range(cells.shape[1]):
            total += cells[p, q, 0]
            squares += cells[p, q, 0] ** 2 + cells[p, q, 1] ** 2
    return np.sqrt(max(squares / n - (total / n) ** 2, 0.0))


@njit(cache=True, nogil=True)
def eyes_alike(fine: Thumb, other: Thumb, energy_min: float, cells_min: int, quantile: float) -> float:
    """Correlation of two fine patterns at the same places, in cells: this quantile of them; NaN where too few do."""
    rows, cols = fine.shape
    found, n = np.empty(CELL_ROWS * CELL_COLS), 0
    for p in range(CELL_ROWS):
        for q in range(CELL_COLS):
            a, b, c, size = 0, 0, 0, 0
            for i in range(p * rows // CELL_ROWS, (p + 1) * rows // CELL_ROWS):
                for j in range(q * cols // CELL_COLS, (q + 1) * cols // CELL_COLS):
                    f, g = int(fine[i, j]), int(other[i, j])
                    a, b, c, size = a + f * f, b + g * g, c + f * g, size + 1
            if min(a, b) > energy_min * size:
                found[n] = c / np.sqrt(float(a) * float(b))
                n += 1
    return np.sort(found[:n])[int(quantile * n)] if n >= cells_min else np.nan


@dataclass(slots=True)
class EyeCells:
    """One eye of one pair at a glance, compared with the pair before. Grey levels 0 to 255.

    `cell_statistics` (9, 16, 9): mean, standard deviation, share of white, mean absolute and mean clipped change since
    the pair before, energy of the fine pattern now and before, their product, share of unchanged places.
    """

    grey_thumbnail: Thumb
    fine_pattern: Thumb
    cell_statistics: Array
    row_steps: Array  # mean absolute step from each thumbnail row to the next (rows - 1,)
    one_grey_rows: int  # at the bottom
    spread_grey: float  # root mean square of all contrast

    def cell_field(self, number: int) -> Array:
        """One field of all cells (9, 16)."""
        return self.cell_statistics[:, :, number]


class EyeMemory:
    """Two thumbnails of one eye, filled in turn."""

    def __init__(self) -> None:
        self._shape: tuple[int, int] = (0, 0)
        self._step = 1
        self._turn = 0
        self._grey: tuple[Thumb, Thumb] = (np.zeros((0, 0), np.int16), np.zeros((0, 0), np.int16))
        self._fine = self._grey
        self._cells = np.zeros((CELL_ROWS, CELL_COLS, N_CELL_STATISTICS))
        self._rows = np.zeros(0)

    @property
    def thumbnail_step_px(self) -> int:
        """Pixels per thumbnail pixel."""
        return self._step

    def look(self, image: Image) -> EyeCells:
        """Take in the next picture; valid until the next but one."""
        if image.shape != self._shape:
            self._allocate_buffers((int(image.shape[0]), int(image.shape[1])))
        self._turn = 1 - self._turn
        grey, fine = self._grey[self._turn], self._fine[self._turn]
        _fill_thumbnails(image, self._step, grey, fine)
        _compute_cell_statistics(
            grey, fine, self._grey[1 - self._turn], self._fine[1 - self._turn], 4 * WHITE_GREY, self._cells
        )
        one_grey = _row_steps(grey, self._rows)
        return EyeCells(grey, fine, self._cells, self._rows, one_grey, _grey_standard_deviation(self._cells))

    def _allocate_buffers(self, shape: tuple[int, int]) -> None:
        self._shape = shape
        self._step = max(1, shape[0] // THUMB_ROWS)
        size = (shape[0] - 2) // self._step + 1, (shape[1] - 2) // self._step + 1
        self._rows = np.zeros(size[0] - 1)
        self._grey = np.zeros(size, np.int16), np.zeros(size, np.int16)
        self._fine = np.zeros(size, np.int16), np.zeros(size, np.int16)
