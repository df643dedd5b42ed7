"""The same spot in both eyes, for a few spots of every pair: coarsely on thumbnails, then to a fraction of a pixel."""

import numpy as np
from numba import njit

from server.vision.contracts import Array, Image

HALF = 4  # of a coarse patch [thumbnail px]
SHIFT_MAX = 40  # thumbnail px: 320 px, a spot at 0.2 m
ROWS_MAX = 2  # thumbnail px: 16 px
FINE_HALF = 12
FINE_ROWS, FINE_COLS = 7, 7
TEXTURE_MIN_GREY = 5.0
COARSE_MIN, FINE_MIN = 0.85, 0.85  # correlation
SECOND_MARGIN = 0.08  # the best place must beat every other that is not its neighbour by this


@njit(cache=True, nogil=True)
def _coarse(left: Image, right: Image, i: int, j: int) -> tuple[bool, int, int]:
    """Row and column shift (right minus left) of the best correlation of a patch; False where it is not clear."""
    rows, cols = right.shape
    n = (2 * HALF + 1) ** 2
    total, squares = 0.0, 0.0
    for a in range(-HALF, HALF + 1):
        for b in range(-HALF, HALF + 1):
            g = float(left[i + a, j + b])
            total += g
            squares += g * g
    spread = squares - total * total / n
    if spread < n * TEXTURE_MIN_GREY**2:
        return False, 0, 0
    scores = np.full((2 * ROWS_MAX + 1, 2 * SHIFT_MAX + 1), -1.0)
    best, best_row, best_col = -1.0, 0, 0
    for r in range(-ROWS_MAX, ROWS_MAX + 1):
        if i + r < HALF or i + r >= rows - HALF:
            continue
        for s in range(-SHIFT_MAX, SHIFT_MAX + 1):
            if j + s < HALF or j + s >= cols - HALF:
                continue
            t, q, c = 0.0, 0.0, 0.0
            for a in range(-HALF, HALF + 1):
                for b in range(-HALF, HALF + 1):
                    g = float(right[i + r + a, j + s + b])
                    t += g
                    q += g * g
                    c += g * left[i + a, j + b]
            other = q - t * t / n
            if other < 0.1 * spread:
                continue
            score = (c - t * total / n) / np.sqrt(spread * other)
            scores[r + ROWS_MAX, s + SHIFT_MAX] = score
            if score > best:
                best, best_row, best_col = score, r, s
    if best < COARSE_MIN:
        return False, 0, 0
    for r in range(-ROWS_MAX, ROWS_MAX + 1):
        for s in range(-SHIFT_MAX, SHIFT_MAX + 1):
            far = abs(r - best_row) > 1 or abs(s - best_col) > 2
            if far and scores[r + ROWS_MAX, s + SHIFT_MAX] > best - SECOND_MARGIN:
                return False, 0, 0
    return True, best_row, best_col


@njit(cache=True, nogil=True)
def _correlation(left: Image, right: Image, y: int, x: int, v: int, u: int, stride: int) -> float:
    t, q, total, squares, c, n = 0.0, 0.0, 0.0, 0.0, 0.0, 0
    for a in range(-FINE_HALF, FINE_HALF + 1, stride):
        for b in range(-FINE_HALF, FINE_HALF + 1, stride):
            f, g = float(left[y + a, x + b]), float(right[v + a, u + b])
            total += f
            squares += f * f
            t += g
            q += g * g
            c += f * g
            n += 1
    spread = (squares - total * total / n) * (q - t * t / n)
    return (c - t * total / n) / np.sqrt(spread) if spread > 0.0 else -1.0


@njit(cache=True, nogil=True)
def _peak(low: float, mid: float, high: float) -> float:
    """Offset of a parabola's top through three equally spaced values."""
    bend = low - 2.0 * mid + high
    return 0.5 * (low - high) / bend if bend < -1e-9 else 0.0


@njit(cache=True, nogil=True)
def match_spot(left: Image, right: Image, thumb_left: Image, thumb_right: Image, step: int, i: int, j: int) -> Array:
    """Where a spot of the left eye lies in the right one.

    Model:   normalised correlation: coarse over the thumbnails, both signs of disparity; then over full pixels around
             it, at half the density first; a parabola through the best and its neighbours.
    Args:    thumb_*: mean greys of squares of `step` px. i, j: the spot on the thumbnail.
    Returns: u_left, v_left, u_right, v_right [raw px]; NaN where the spot is plain, hidden, or alike to another.
    """
    none = np.full(4, np.nan)
    clear, row, col = _coarse(thumb_left, thumb_right, i, j)
    if not clear:
        return none
    y, x = i * step + step // 2, j * step + step // 2
    v, u = y + row * step, x + col * step
    margin = FINE_HALF + 2
    if y < margin or x < margin or y + margin >= left.shape[0] or x + margin >= left.shape[1]:
        return none
    if v < margin + FINE_ROWS or v + margin + FINE_ROWS >= right.shape[0]:
        return none
    if u < margin + FINE_COLS or u + margin + FINE_COLS >= right.shape[1]:
        return none
    best, best_v, best_u = -1.0, v, u
    for a in range(-FINE_ROWS + 1, FINE_ROWS, 2):
        for b in range(-FINE_COLS + 1, FINE_COLS, 2):
            score = _correlation(left, right, y, x, v + a, u + b, 3)
            if score > best:
                best, best_v, best_u = score, v + a, u + b
    around = np.empty((5, 5))
    for a in range(-2, 3):
        for b in range(-2, 3):
            around[a + 2, b + 2] = _correlation(left, right, y, x, best_v + a, best_u + b, 1)
    top, p, q = -1.0, 2, 2
    for a in range(1, 4):
        for b in range(1, 4):
            if around[a, b] > top:
                top, p, q = around[a, b], a, b
    if top < FINE_MIN:
        return none
    none[0], none[1] = x, y
    none[2] = best_u + q - 2 + _peak(around[p, q - 1], top, around[p, q + 1])
    none[3] = best_v + p - 2 + _peak(around[p - 1, q], top, around[p + 1, q])
    return none
