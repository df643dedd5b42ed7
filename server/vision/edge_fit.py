"""Sub-pixel corners of a dark square on white: an edge model fitted to the pixels along each side, sides intersected.

A corner of a blurred image is rounded, so a search for "the corner" is biased; the sides are long, straight and not.
"""

import math
from enum import Enum

import numpy as np
from numba import njit

from server.vision.contracts import Array, Image
from server.vision.small_algebra import solve_positive

BLUR_MIN_PX, BLUR_MAX_PX = 0.3, 3.0
ITERATIONS_MAX = 12
CELL_MIN_PX = 1.6
ROUGHNESS_MAX_FRAC = 0.10  # rms of the edge fit over its contrast; clean sides reach 0.035, covered ones start at 0.13


@njit(cache=True)
def _fit_side(
    image: Image, start: Array, end: Array, sag_px: float, half_px: float, trim: float
) -> tuple[bool, float, float, float]:
    """Offsets of the side at its start and end along its outward normal, and the rms of the fit over its contrast.

    Model: grey(p) = dark + (bright - dark) * Phi(d / blur), d = n.(p - start) - a (1-t) - b t - 4 sag t (1-t).
    """
    length = math.hypot(end[0] - start[0], end[1] - start[1])
    tx, ty = (end[0] - start[0]) / length, (end[1] - start[1]) / length
    nx, ny = ty, -tx  # corners run clockwise with y down: the outside is to the left of the way
    height, width = image.shape
    margin = half_px + 1.5 + abs(sag_px)
    x_low = max(int(min(start[0], end[0]) - margin), 0)
    x_high = min(int(max(start[0], end[0]) + margin) + 1, width - 1)
    y_low = max(int(min(start[1], end[1]) - margin), 0)
    y_high = min(int(max(start[1], end[1]) + margin) + 1, height - 1)
    count_max = (x_high - x_low + 1) * (y_high - y_low + 1)
    if count_max <= 0:
        return False, 0.0, 0.0, 0.0
    along, across, grey = np.empty(count_max), np.empty(count_max), np.empty(count_max)
    count = 0
    for y in range(y_low, y_high + 1):
        for x in range(x_low, x_high + 1):
            t = ((x - start[0]) * tx + (y - start[1]) * ty) / length
            if t < trim or t > 1.0 - trim:
                continue
            d = (x - start[0]) * nx + (y - start[1]) * ny - 4.0 * sag_px * t * (1.0 - t)
            if abs(d) <= half_px:
                along[count], across[count], grey[count] = t, d, image[y, x]
                count += 1
    if count < 12:
        return False, 0.0, 0.0, 0.0
    inside, outside, n_inside, n_outside = 0.0, 0.0, 0, 0
    for i in range(count):
        if across[i] < -0.5 * half_px:
            inside += grey[i]
            n_inside += 1
        elif across[i] > 0.5 * half_px:
            outside += grey[i]
            n_outside += 1
    if n_inside == 0 or n_outside == 0 or outside / n_outside - inside / n_inside < 8.0:
        return False, 0.0, 0.0, 0.0
    p = np.array([0.0, 0.0, inside / n_inside, outside / n_outside, 0.8])  # a, b, dark, bright, blur
    damping, total = 1e-4, np.inf
    row = np.empty(5)
    trial = p.copy()
    information, gradient = np.zeros((5, 5)), np.zeros(5)
    for _ in range(ITERATIONS_MAX):
        new_information, new_gradient, new_total = np.zeros((5, 5)), np.zeros(5), 0.0
        for i in range(count):
            u = (across[i] - trial[0] * (1.0 - along[i]) - trial[1] * along[i]) / trial[4]
            phi = 0.5 * (1.0 + math.erf(u * 0.7071067811865476))
            bell = 0.3989422804014327 * math.exp(-0.5 * u * u) * (trial[3] - trial[2]) / trial[4]
            residual = trial[2] + (trial[3] - trial[2]) * phi - grey[i]
            row[0], row[1] = -bell * (1.0 - along[i]), -bell * along[i]
            row[2], row[3], row[4] = 1.0 - phi, phi, -bell * u
            new_total += residual * residual
            for j in range(5):
                new_gradient[j] += row[j] * residual
                for k in range(5):
                    new_information[j, k] += row[j] * row[k]
        if new_total <= total:
            gain = total - new_total
            p, total, information, gradient = trial, new_total, new_information, new_gradient
            damping = max(damping * 0.2, 1e-7)
            if gain < 1e-5 * total:
                break
        else:
            damping *= 10.0
        damped = information.copy()
        for j in range(5):
            damped[j, j] += damping * information[j, j] + 1e-9
        step = solve_positive(damped, -gradient)
        trial = p + step
        trial[4] = min(max(trial[4], BLUR_MIN_PX), BLUR_MAX_PX)
    if abs(p[0]) > half_px or abs(p[1]) > half_px:
        return False, 0.0, 0.0, 0.0
    contrast = max(p[3] - p[2], 1.0)
    return True, p[0], p[1], math.sqrt(total / count) / contrast


@njit(cache=True)
def _intersect(a0: Array, a1: Array, b0: Array, b1: Array) -> Array:
    da, db = a1 - a0, b1 - b0
    cross = da[0] * db[1] - da[1] * db[0]
    if abs(cross) < 1e-9:
        return np.full(2, np.nan)
    s = ((b0[0] - a0[0]) * db[1] - (b0[1] - a0[1]) * db[0]) / cross
    return a0 + s * da


@njit(cache=True)
def _refine(image: Image, corners: Array, sags_px: Array, half_px: float, trim: float) -> tuple[bool, Array, float]:
    starts, ends = np.empty((4, 2)), np.empty((4, 2))
    worst = 0.0
    for i in range(4):
        start, end = corners[i], corners[(i + 1) % 4]
        length = math.hypot(end[0] - start[0], end[1] - start[1])
        if length < 4.0:
            return False, corners, 0.0
        good, a, b, rms = _fit_side(image, start, end, sags_px[i], half_px, trim)
        if not good:
            return False, corners, 0.0
        normal = np.array([(end[1] - start[1]) / length, -(end[0] - start[0]) / length])
        starts[i], ends[i] = start + a * normal, end + b * normal
        worst = max(worst, rms)
    refined = np.empty((4, 2))
    for i in range(4):
        refined[i] = _intersect(starts[i - 1], ends[i - 1], starts[i], ends[i])
    return bool(np.isfinite(refined).all()), refined, worst


def side_length_min(corners_px: Array) -> float:
    """Shortest side of a quadrilateral (4, 2) [px]."""
    return float(np.min(np.linalg.norm(corners_px - np.roll(corners_px, -1, axis=0), axis=1)))


class SideFit(Enum):
    """How fitting the sides of a marker ended."""

    CLEAN = "clean"
    TOO_SMALL = "too_small"  # too few pixels per cell for a band around the side
    COVERED = "covered"  # a side is no clean edge: something lies over it, or light falls across it


def fit_corners(image: Image, corners_px: Array, cells: int, sags_px: Array) -> tuple[SideFit, Array]:
    """Corners of a dark square by its four fitted sides; the start where they are not clean.

    Model:   each side: grey = dark + (bright - dark) Phi(d / blur), d the distance from a line that follows the lens's
             known sag; five parameters by LM over the pixels of a band around it. Twice: the second band lies on the
             first result.
    Args:    image: grey (h, w). corners_px: start (4, 2) [px], clockwise as seen. cells: cells along the side, border
             included. sags_px (4,): how far the lens bows each side outward at its middle [px].
    Returns: how it ended, and corners (4, 2) [px] in the image's own pixel convention.
    """
    shortest = side_length_min(corners_px)
    cell = shortest / cells
    if not np.isfinite(shortest) or cell < CELL_MIN_PX:
        return SideFit.TOO_SMALL, corners_px
    current, roughness = corners_px, 0.0
    for half_px in (min(max(0.8 * cell, 1.6), 5.0), min(max(0.7 * cell, 1.5), 3.5)):
        trim = min(0.25, (half_px + 1.0) / shortest)
        good, current, roughness = _refine(
            image, np.ascontiguousarray(current, dtype=np.float64), sags_px, half_px, trim
        )
        if not good:
            return SideFit.COVERED, corners_px
    moved = float(np.max(np.abs(current - corners_px)))
    if roughness > ROUGHNESS_MAX_FRAC or moved > max(2.5, 0.6 * cell):
        return SideFit.COVERED, corners_px
    return SideFit.CLEAN, current
