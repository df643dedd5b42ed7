"""A printed square as the picture shows it: where its places lie, and how grey the picture is there."""

import numpy as np
from numba import njit

from server.vision.contracts import Array, Image


@njit(cache=True, nogil=True)
def of_unit_square(corners: Array, det_min: float) -> tuple[bool, Array]:
    """(a, b, c, d, e, f, g, h): (s, t) of the unit square (0,0) (1,0) (1,1) (0,1) lies at x = (a s + b t + c) / w,
    y = (d s + e t + f) / w, w = g s + h t + 1; False where the corners (4, 2) span nothing.

    Source: Heckbert 1989, section 2.2.3.
    """
    x0, y0, x1, y1 = corners[0, 0], corners[0, 1], corners[1, 0], corners[1, 1]
    x2, y2, x3, y3 = corners[2, 0], corners[2, 1], corners[3, 0], corners[3, 1]
    dx1, dx2, dx3 = x1 - x2, x3 - x2, x0 - x1 + x2 - x3
    dy1, dy2, dy3 = y1 - y2, y3 - y2, y0 - y1 + y2 - y3
    out = np.zeros(8)
    det = dx1 * dy2 - dx2 * dy1
    if abs(det) < det_min:
        return False, out
    g = (dx3 * dy2 - dx2 * dy3) / det
    h = (dx1 * dy3 - dx3 * dy1) / det
    out[0], out[1], out[2] = x1 - x0 + g * x1, x3 - x0 + h * x3, x0
    out[3], out[4], out[5] = y1 - y0 + g * y1, y3 - y0 + h * y3, y0
    out[6], out[7] = g, h
    return True, out


@njit(cache=True, nogil=True)
def grey_at(image: Image, x: float, y: float) -> float:
    """Grey between the pixels [px]; below 0 outside of the picture."""
    height, width = image.shape
    if not (x >= 0.0 and y >= 0.0 and x < width - 1 and y < height - 1):
        return -1.0
    i, j = int(x), int(y)
    u, v = x - i, y - j
    top = (1.0 - u) * image[j, i] + u * image[j, i + 1]
    low = (1.0 - u) * image[j + 1, i] + u * image[j + 1, i + 1]
    return (1.0 - v) * top + v * low
