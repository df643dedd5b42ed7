"""Is this square still the marker it was? Its printed cells, read where the corners say they are."""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from server.vision.contracts import Array, Image

CONTRAST_MIN_GREY = 12.0  # between the cells printed white and those printed black
QUIET_CELLS = 1  # the black border
NO_MATCH = 1000


def marker_cells(dictionary: "cv2.aruco.Dictionary", marker_id: int) -> NDArray[np.bool_]:
    """Which cells are white (n, n), the black border included, row 0 at the top as printed."""
    n = int(dictionary.markerSize) + 2 * QUIET_CELLS
    drawn = cv2.aruco.generateImageMarker(dictionary, marker_id, n, borderBits=QUIET_CELLS)
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
    height, width = image.shape
    # Heckbert 1989, unit square (0,0) (1,0) (1,1) (0,1) to a quadrilateral
    x0, y0, x1, y1 = corners[0, 0], corners[0, 1], corners[1, 0], corners[1, 1]
    x2, y2, x3, y3 = corners[2, 0], corners[2, 1], corners[3, 0], corners[3, 1]
    dx1, dx2, dx3 = x1 - x2, x3 - x2, x0 - x1 + x2 - x3
    dy1, dy2, dy3 = y1 - y2, y3 - y2, y0 - y1 + y2 - y3
    det = dx1 * dy2 - dx2 * dy1
    if abs(det) < 1e-9:
        return NO_MATCH
    g = (dx3 * dy2 - dx2 * dy3) / det
    h = (dx1 * dy3 - dx3 * dy1) / det
    a, b = x1 - x0 + g * x1, x3 - x0 + h * x3
    d, e = y1 - y0 + g * y1, y3 - y0 + h * y3
    grey = np.zeros((n, n))
    for row in range(n):
        for column in range(n):
            for k in range(5):
                s = (column + 0.5 + (0.2 if k == 1 else -0.2 if k == 2 else 0.0)) / n
                t = (row + 0.5 + (0.2 if k == 3 else -0.2 if k == 4 else 0.0)) / n
                w = g * s + h * t + 1.0
                x, y = (a * s + b * t + x0) / w, (d * s + e * t + y0) / w
                if not (x >= 0.0 and y >= 0.0 and x < width - 1 and y < height - 1):
                    return NO_MATCH
                i, j = int(x), int(y)
                u, v = x - i, y - j
                top = (1.0 - u) * image[j, i] + u * image[j, i + 1]
                low = (1.0 - u) * image[j + 1, i] + u * image[j + 1, i + 1]
                grey[row, column] += 0.2 * ((1.0 - v) * top + v * low)
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
