"""Is this square still the marker it was? Its printed cells, read where the corners say they are."""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from server.vision.contracts import Array, Image
from server.vision.quadrilateral import grey_at, of_unit_square

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
