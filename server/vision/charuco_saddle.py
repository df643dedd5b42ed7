"""A chess corner to a few hundredths of a pixel: both edges through it fitted jointly, the markers left out.

A search for the saddle by gradients needs a round window, which the markers in the white squares keep small; the edges
are long, and all information on the corner lies within some pixels of them.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from server.vision.contracts import Array, Image
from server.vision.small_algebra import solve_positive

EDGE_LENGTH_FRAC = 0.45  # of a square: how far the edges are followed
EDGE_LENGTH_MAX_PX = 14.0
EDGE_BAND_HALF_WIDTH_PX = 3.0  # on each side of an edge
MARKER_GUARD_PX = 1.5  # kept from a marker's side: its blur
BLUR_MIN_PX, BLUR_MAX_PX = 0.3, 3.0
ITERATIONS_MAX = 12
PIXELS_MIN = 24
N_PARAMETERS = 7  # x, y, both edges' angles, grey in the middle, half the contrast, blur
SQRT_HALF = 0.7071067811865476


@njit(cache=True, nogil=True)
def _gather_edge_pixels(
    image: Image, x0: float, y0: float, J: Array, dark_first: bool, gap_frac: float, pixels: Array
) -> tuple[int, float]:
    """Pixels (u, v, grey) near the two edges, and their number; the share of the wanted places inside the image.

    `J` (2, 2): pixels per square along the board's right and down. `gap_frac`: white between square and marker.
    """
    det = J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]
    size_x, size_y = math.hypot(J[0, 0], J[1, 0]), math.hypot(J[0, 1], J[1, 1])
    if not abs(det) > 1e-9:
        return 0, 0.0
    across_x, across_y = abs(det) / size_y, abs(det) / size_x  # px per square, square to the edges
    arm_x, arm_y = (
        min(EDGE_LENGTH_FRAC, EDGE_LENGTH_MAX_PX / size_x),
        min(EDGE_LENGTH_FRAC, EDGE_LENGTH_MAX_PX / size_y),
    )
    reach_u = abs(J[0, 0]) * arm_x + abs(J[0, 1]) * arm_y
    reach_v = abs(J[1, 0]) * arm_x + abs(J[1, 1]) * arm_y
    height, width = image.shape
    count, wanted = 0, 0
    for v in range(math.ceil(y0 - reach_v), math.floor(y0 + reach_v) + 1):
        for u in range(math.ceil(x0 - reach_u), math.floor(x0 + reach_u) + 1):
            right = (J[1, 1] * (u - x0) - J[0, 1] * (v - y0)) / det
            down = (J[0, 0] * (v - y0) - J[1, 0] * (u - x0)) / det
            if abs(right) > arm_x or abs(down) > arm_y:
                continue
            off_x, off_y = abs(right) * across_x, abs(down) * across_y
            if min(off_x, off_y) > EDGE_BAND_HALF_WIDTH_PX:
                continue
            dark = (right * down > 0.0) == dark_first
            near_marker = (
                off_x > gap_frac * across_x - MARKER_GUARD_PX and off_y > gap_frac * across_y - MARKER_GUARD_PX
            )
            if not dark and near_marker and (off_x > 1.5 or off_y > 1.5):
                continue
            wanted += 1
            if 0 <= u < width and 0 <= v < height and count < len(pixels):
                pixels[count, 0], pixels[count, 1], pixels[count, 2] = u, v, image[v, u]
                count += 1
    return count, count / max(wanted, 1)


@njit(cache=True, nogil=True)
def _saddle_normal_equations(pixels: Array, count: int, p: Array, information: Array, gradient: Array) -> float:
    """Normal equations in place and the sum of squares.

    Model: grey = p4 + p5 E(d1 / p6) E(d2 / p6), E(t) = erf(t / sqrt 2), d the distances from the two edges through
    (p0, p1) with directions p2 (board's right) and p3 (board's down).
    """
    information[:], gradient[:] = 0.0, 0.0
    total = 0.0
    c1, s1, c2, s2 = math.cos(p[2]), math.sin(p[2]), math.cos(p[3]), math.sin(p[3])
    row = np.empty(N_PARAMETERS)
    for i in range(count):
        du, dv = pixels[i, 0] - p[0], pixels[i, 1] - p[1]
        d1, d2 = -s1 * du + c1 * dv, s2 * du - c2 * dv  # below the one, right of the other
        t1, t2 = d1 / p[6], d2 / p[6]
        e1, e2 = math.erf(t1 * SQRT_HALF), math.erf(t2 * SQRT_HALF)
        bell1 = p[5] * e2 * 0.7978845608028654 * math.exp(-0.5 * t1 * t1) / p[6]
        bell2 = p[5] * e1 * 0.7978845608028654 * math.exp(-0.5 * t2 * t2) / p[6]
        residual = p[4] + p[5] * e1 * e2 - pixels[i, 2]
        row[0], row[1] = bell1 * s1 - bell2 * s2, -bell1 * c1 + bell2 * c2
        row[2], row[3] = bell1 * (-c1 * du - s1 * dv), bell2 * (c2 * du + s2 * dv)
        row[4], row[5], row[6] = 1.0, e1 * e2, -bell1 * t1 - bell2 * t2
        total += residual * residual
        for j in range(N_PARAMETERS):
            gradient[j] += row[j] * residual
            for k in range(j, N_PARAMETERS):
                information[j, k] += row[j] * row[k]
    for j in range(N_PARAMETERS):
        for k in range(j):
            information[j, k] = information[k, j]
    return total


@njit(cache=True, nogil=True)
def _least_squares(pixels: Array, count: int, p: Array) -> tuple[Array, float]:
    """Levenberg-Marquardt from `p`: parameters and sum of squares."""
    information, gradient = np.zeros((N_PARAMETERS, N_PARAMETERS)), np.zeros(N_PARAMETERS)
    new_information, new_gradient = np.zeros((N_PARAMETERS, N_PARAMETERS)), np.zeros(N_PARAMETERS)
    total = _saddle_normal_equations(pixels, count, p, information, gradient)
    damping = 1e-3
    for _ in range(ITERATIONS_MAX):
        damped = information.copy()
        for j in range(N_PARAMETERS):
            damped[j, j] += damping * information[j, j] + 1e-9
        trial = p + solve_positive(damped, -gradient)
        trial[6] = min(max(trial[6], BLUR_MIN_PX), BLUR_MAX_PX)
        new_total = _saddle_normal_equations(pixels, count, trial, new_information, new_gradient)
        if new_total <= total:
            done = total - new_total < 1e-4 * total
            p, total = trial, new_total
            information[:], gradient[:] = new_information, new_gradient
            damping = max(0.2 * damping, 1e-7)
            if done:
                break
        else:
            damping *= 10.0
            if damping > 1e8:
                break
    return p, total


@njit(cache=True, nogil=True)
def fit_saddle(image: Image, start: Array, J: Array, dark_first: bool, gap_frac: float) -> Array:
    """One chess corner: (x, y [px], roughness, contrast [grey], blur [px]); NaN where nothing can be fitted.

    Model:   two edges through one point, grey = middle + half contrast * E(d1 / blur) E(d2 / blur); seven parameters by
             LM over the pixels of two bands; twice, the second bands lie on the first result.
    Args:    image: grey (h, w). start (2,) [px]. J (2, 2): pixels per square along the board's right and down.
             dark_first: whether the square up and left is black. gap_frac: white between square and marker, of a
             square.
    Returns: (5,). Roughness is the rms of the fit over the contrast; the contrast is negative where black and white are
             the other way round than asked.
    """
    failed = np.full(5, np.nan)
    pixels = np.empty((int(4.0 * (2.0 * EDGE_LENGTH_MAX_PX + 2.0) * (2.0 * EDGE_BAND_HALF_WIDTH_PX + 3.0)), 3))
    p = np.empty(N_PARAMETERS)
    p[0], p[1] = start[0], start[1]
    p[2], p[3] = math.atan2(J[1, 0], J[0, 0]), math.atan2(J[1, 1], J[0, 1])
    p[6] = 1.2
    total, count = 0.0, 0
    for k in range(2):
        count, inside = _gather_edge_pixels(image, p[0], p[1], J, dark_first, gap_frac, pixels)
        if count < PIXELS_MIN or inside < 0.9:
            return failed
        if k == 0:
            low, high = pixels[:count, 2].min(), pixels[:count, 2].max()
            p[4], p[5] = 0.5 * (low + high), 0.4 * (high - low) * (-1.0 if dark_first else 1.0)
        p, total = _least_squares(pixels, count, p)
        if not (abs(p[0] - start[0]) + abs(p[1] - start[1]) < 0.7 * (abs(J[0, 0]) + abs(J[1, 0]))):
            return failed
    contrast = -2.0 * p[5] if dark_first else 2.0 * p[5]
    roughness = math.sqrt(total / count) / max(abs(contrast), 1.0)
    return np.array([p[0], p[1], roughness, contrast, p[6]])


@njit(cache=True, nogil=True)
def fit_saddles(image: Image, starts: Array, Js: Array, dark_first: NDArray[np.bool_], gap_frac: float) -> Array:
    """`fit_saddle` for many corners: (n, 5)."""
    found = np.full((len(starts), 5), np.nan)
    for i in range(len(starts)):
        if np.isfinite(starts[i]).all() and np.isfinite(Js[i]).all():
            found[i] = fit_saddle(image, starts[i], Js[i], dark_first[i], gap_frac)
    return found
