"""Sub-pixel corners of a dark square on white: an edge model fitted to the pixels along each side, sides intersected.

A corner of a blurred image is rounded, so a search for "the corner" is biased; the sides are long, straight and not.
"""

import math
from enum import Enum

import cv2
import numpy as np
from numba import njit
from scipy.special import ndtr

from machine.camera import undistort_to_rays
from machine.description import StereoCamera
from server.vision.contracts import Array, Image
from server.vision.small_algebra import solve_positive

BLUR_MIN_PX, BLUR_MAX_PX, BLUR_START_PX = 0.3, 3.0, 0.8
ITERATIONS_MAX = 10
CELL_MIN_PX = 1.6
COARSE_STATIONS, FINE_STATIONS = 24, 64  # pixel rows read across a side; of a long one every second or third
# Rms of the edge fit over its contrast; clean sides reach 0.035, covered ones start at 0.13
FIT_RESIDUAL_MAX_FRAC = 0.10
COARSE_PX, FINE_PX = 2e-2, 5e-4  # a fit ends when its ends move by less
_TABLE_END, _TABLE_PER_UNIT = 6.0, 256.0
_STEP = ndtr(np.arange(-_TABLE_END, _TABLE_END + 2.0 / _TABLE_PER_UNIT, 1.0 / _TABLE_PER_UNIT))  # good to 5e-7


def side_sags(camera: StereoCamera | None, corners_px: Array) -> Array:
    """How the lens bows each side of a square outward (4, 2) [px]: at its middle, and how lopsided; zeros without one.

    Model:   bow(t) = 4 t (1-t) (s + k (2t-1)), through the lens's true bow at a quarter and three quarters of the side.
    """
    if camera is None or not any(camera.distortion):
        return np.zeros((4, 2))
    corners, lens = np.ascontiguousarray(corners_px, dtype=np.float64), camera.distortion
    rays, out = undistort_to_rays(camera, corners), np.empty((4, 2))
    _compute_side_sags(corners, rays, np.array(lens), camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, out)
    return out


@njit(cache=True, nogil=True)
def _compute_side_sags(
    corners: Array, rays: Array, coefficients: Array, fx: float, fy: float, cx: float, cy: float, out: Array
) -> None:
    k1, k2, p1, p2, k3 = coefficients
    bow = np.empty(2)
    for i in range(4):
        j = (i + 1) % 4
        along_x, along_y = corners[j, 0] - corners[i, 0], corners[j, 1] - corners[i, 1]
        length = max(math.hypot(along_x, along_y), 1e-9)
        for k in range(2):
            t = 0.25 + 0.5 * k
            x = (1.0 - t) * rays[i, 0] + t * rays[j, 0]
            y = (1.0 - t) * rays[i, 1] + t * rays[j, 1]
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
            v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
            bow[k] = ((u * fx + cx - corners[i, 0]) * along_y - (v * fy + cy - corners[i, 1]) * along_x) / length
        out[i, 0] = (bow[0] + bow[1]) / 1.5  # 4 t (1-t) is 3/4 at both, 2t-1 is -+1/2
        out[i, 1] = (bow[1] - bow[0]) / 0.75


def corner_search(image: Image, corners_px: Array, cells: int) -> Array:
    """OpenCV's gradient corner search with a window of at most 0.6 cell; the start where it runs away."""
    cell = side_length_min(corners_px) / cells
    half = int(np.clip(0.6 * cell, 1, 7))
    start = np.ascontiguousarray(corners_px, dtype=np.float32).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.005)
    found = cv2.cornerSubPix(image, start.copy(), (half, half), (-1, -1), criteria).reshape(-1, 2)
    far = np.linalg.norm(found - corners_px, axis=1) > half + 1.0
    return np.where(far[:, None] | ~np.isfinite(found), corners_px, found).astype(np.float64)


@njit(cache=True, nogil=True)
def _collect_side_pixels(
    image: Image, start: Array, end: Array, bow: Array, half_px: float, trim: float, stations: int, pixels: Array
) -> tuple[int, float, float]:
    """Pixels of the band around a side: rows (t along, distance across, grey) into `pixels`; count, mean dark, bright.

    Walks along the longer of the side's two extents and reads the pixels across it; none nearer a corner than `trim`.
    """
    length = math.hypot(end[0] - start[0], end[1] - start[1])
    tx, ty = (end[0] - start[0]) / length, (end[1] - start[1]) / length
    nx, ny = ty, -tx  # corners run clockwise with y down: the outside is to the left of the way
    along_x = abs(tx) >= abs(ty)
    major, minor = (0, 1) if along_x else (1, 0)
    height, width = image.shape
    major_size, minor_size = (width, height) if along_x else (height, width)
    slope = (end[minor] - start[minor]) / (end[major] - start[major])
    reach = (half_px + abs(bow[0]) + abs(bow[1])) / max(abs(tx), abs(ty))
    skew = reach * min(abs(tx), abs(ty))  # how far along a pixel at the band's rim lies from its station
    low = max(math.ceil(min(start[major], end[major]) - skew), 0)
    high = min(math.floor(max(start[major], end[major]) + skew), major_size - 1)
    stride = max(math.ceil((high - low + 1) / stations), 1)
    count, n_inside, n_outside = 0, 0, 0
    inside, outside = 0.0, 0.0
    for m in range(low, high + 1, stride):
        centre = start[minor] + slope * (m - start[major])
        first = max(math.ceil(centre - reach), 0)
        last = min(math.floor(centre + reach), minor_size - 1)
        for k in range(first, last + 1):
            x, y = (m, k) if along_x else (k, m)
            t = ((x - start[0]) * tx + (y - start[1]) * ty) / length
            if t < trim or t > 1.0 - trim:
                continue
            d = (x - start[0]) * nx + (y - start[1]) * ny - 4.0 * t * (1.0 - t) * (bow[0] + bow[1] * (2.0 * t - 1.0))
            if abs(d) > half_px or count >= pixels.shape[0]:
                continue
            grey = float(image[y, x])
            pixels[count, 0], pixels[count, 1], pixels[count, 2] = t, d, grey
            count += 1
            if d < -0.5 * half_px:
                inside += grey
                n_inside += 1
            elif d > 0.5 * half_px:
                outside += grey
                n_outside += 1
    if n_inside == 0 or n_outside == 0:
        return 0, 0.0, 0.0
    return count, inside / n_inside, outside / n_outside


@njit(cache=True, nogil=True)
def _sum_up(pixels: Array, count: int, p: Array, information: Array, gradient: Array) -> float:
    """Normal equations of the edge model at p = (a, b, dark, bright, blur), in place; the sum of squares."""
    information[:], gradient[:] = 0.0, 0.0
    total = 0.0
    a, b, dark, contrast, per_blur = p[0], p[1], p[2], p[3] - p[2], 1.0 / p[4]
    row = np.empty(5)
    for i in range(count):
        t = pixels[i, 0]
        u = (pixels[i, 1] - a * (1.0 - t) - b * t) * per_blur
        at = (min(max(u, -_TABLE_END), _TABLE_END) + _TABLE_END) * _TABLE_PER_UNIT
        k = int(at)
        rise = _STEP[k + 1] - _STEP[k]
        phi = _STEP[k] + (at - k) * rise
        bell = rise * _TABLE_PER_UNIT * contrast * per_blur
        residual = dark + contrast * phi - pixels[i, 2]
        total += residual * residual
        row[0], row[1], row[2], row[3], row[4] = -bell * (1.0 - t), -bell * t, 1.0 - phi, phi, -bell * u
        for j in range(5):
            gradient[j] += row[j] * residual
            for m in range(j, 5):
                information[j, m] += row[j] * row[m]
    for j in range(5):
        for m in range(j):
            information[j, m] = information[m, j]
    return total


@njit(cache=True, nogil=True)
def _fit_side(
    image: Image, start: Array, end: Array, bow: Array, half_px: float, trim: float, stations: int, pixels: Array
) -> tuple[bool, float, float, float]:
    """Offsets of the side at its start and end along its outward normal, and the rms of the fit over its contrast.

    Model: grey(p) = dark + (bright - dark) * Phi(d / blur), d = n.(p - start) - a (1-t) - b t - bow(t).
    """
    count, dark, bright = _collect_side_pixels(image, start, end, bow, half_px, trim, stations, pixels)
    if count < 12 or bright - dark < 8.0:
        return False, 0.0, 0.0, 0.0
    p = np.array([0.0, 0.0, dark, bright, BLUR_START_PX])
    information, gradient = np.empty((5, 5)), np.empty(5)
    new_information, new_gradient = np.empty((5, 5)), np.empty(5)
    done_px = COARSE_PX if stations == COARSE_STATIONS else FINE_PX
    total = _sum_up(pixels, count, p, information, gradient)
    damping = 1e-4
    for _ in range(ITERATIONS_MAX):
        for j in range(5):
            information[j, j] *= 1.0 + damping
        step = solve_positive(information, -gradient)
        trial = p + step
        trial[4] = min(max(trial[4], BLUR_MIN_PX), BLUR_MAX_PX)
        new_total = _sum_up(pixels, count, trial, new_information, new_gradient)
        if new_total <= total:
            p, total = trial, new_total
            information, new_information = new_information, information
            gradient, new_gradient = new_gradient, gradient
            damping = max(damping * 0.2, 1e-7)
            if abs(step[0]) < done_px and abs(step[1]) < done_px:
                break
        else:
            for j in range(5):
                information[j, j] /= 1.0 + damping
            damping *= 10.0
    if abs(p[0]) > half_px or abs(p[1]) > half_px:
        return False, 0.0, 0.0, 0.0
    return True, p[0], p[1], math.sqrt(total / count) / max(p[3] - p[2], 1.0)


@njit(cache=True, nogil=True)
def _intersect_lines(a0: Array, a1: Array, b0: Array, b1: Array, out: Array) -> None:
    dax, day, dbx, dby = a1[0] - a0[0], a1[1] - a0[1], b1[0] - b0[0], b1[1] - b0[1]
    cross = dax * dby - day * dbx
    if abs(cross) < 1e-9:
        out[:] = np.nan
        return
    s = ((b0[0] - a0[0]) * dby - (b0[1] - a0[1]) * dbx) / cross
    out[0], out[1] = a0[0] + s * dax, a0[1] + s * day


@njit(cache=True, nogil=True)
def _refine_corners(
    image: Image, corners: Array, bows_px: Array, half_px: float, stations: int
) -> tuple[bool, Array, float]:
    starts, ends = np.empty((4, 2)), np.empty((4, 2))
    pixels = np.empty((int((stations + 8) * (4.0 * half_px + 8.0)), 3))
    worst = 0.0
    for i in range(4):
        start, end = corners[i], corners[(i + 1) % 4]
        length = math.hypot(end[0] - start[0], end[1] - start[1])
        if not length >= 4.0:
            return False, corners, 0.0
        trim = min(0.25, (half_px + 1.0) / length)
        good, a, b, rms = _fit_side(image, start, end, bows_px[i], half_px, trim, stations, pixels)
        if not good:
            return False, corners, 0.0
        nx, ny = (end[1] - start[1]) / length, -(end[0] - start[0]) / length
        starts[i, 0], starts[i, 1] = start[0] + a * nx, start[1] + a * ny
        ends[i, 0], ends[i, 1] = end[0] + b * nx, end[1] + b * ny
        worst = max(worst, rms)
    refined = np.empty((4, 2))
    for i in range(4):
        _intersect_lines(starts[i - 1], ends[i - 1], starts[i], ends[i], refined[i])
    return bool(np.isfinite(refined).all()), refined, worst


def side_length_min(corners_px: Array) -> float:
    """Shortest side of a quadrilateral (4, 2) [px]."""
    return _shortest_side(np.ascontiguousarray(corners_px, dtype=np.float64))


@njit(cache=True, nogil=True)
def _shortest_side(corners: Array) -> float:
    shortest = np.inf
    for i in range(4):
        j = (i + 1) % 4
        length = math.hypot(corners[j, 0] - corners[i, 0], corners[j, 1] - corners[i, 1])
        if not length >= shortest:  # also a length that is not a number
            shortest = length
    return shortest


class SideFit(Enum):
    """How fitting the sides of a marker ended."""

    CLEAN = "clean"
    TOO_SMALL = "too_small"  # too few pixels per cell for a band around the side
    COVERED = "covered"  # a side is not a clean edge: something lies over it, or light falls across it
    NO_MARGIN = "no_margin"  # the same, because the print has no white around its black border


def fit_corners(image: Image, corners_px: Array, cells: int, sags_px: Array) -> tuple[SideFit, Array]:
    """Corners of a dark square by its four fitted sides; the start where they are not clean.

    Model:   each side: grey = dark + (bright - dark) Phi(d / blur), d the distance from a line that follows the lens's
             known bow 4 t (1-t) (s + k (2t-1)); five parameters by LM over the pixels of a band around it. Twice: the
             second band lies on the first result.
    Args:    image: grey (h, w). corners_px: start (4, 2) [px], clockwise as seen. cells: cells along the side, border
             included. sags_px (4, 2): s and k of each side, outward [px], as `side_sags`; (4,) stands for k = 0.
    Returns: how it ended, and corners (4, 2) [px] in the image's own pixel convention.
    """
    shortest = side_length_min(corners_px)
    cell = shortest / cells
    if not np.isfinite(shortest) or cell < CELL_MIN_PX:
        return SideFit.TOO_SMALL, corners_px
    bows = sags_px if sags_px.ndim == 2 else np.column_stack([sags_px, np.zeros(4)])
    bows = np.ascontiguousarray(bows, dtype=np.float64)
    current, roughness = np.ascontiguousarray(corners_px, dtype=np.float64), 0.0
    for half_px, stations in (
        (min(max(0.8 * cell, 1.6), 5.0), COARSE_STATIONS),
        (min(max(0.7 * cell, 1.5), 3.5), FINE_STATIONS),
    ):
        good, current, roughness = _refine_corners(image, current, bows, half_px, stations)
        if not good:
            return SideFit.COVERED, corners_px
    moved = float(np.max(np.abs(current - corners_px)))
    if roughness > FIT_RESIDUAL_MAX_FRAC or moved > max(2.5, 0.6 * cell):
        return SideFit.COVERED, corners_px
    return SideFit.CLEAN, current


def refine_corners(
    image: Image, corners_px: Array, cells: int, camera: StereoCamera | None = None
) -> tuple[SideFit, Array]:
    """Refined corners (4, 2) [px] of one marker, OpenCV order; from the corner search alone where sides are not clean.

    Model:   stage 1 corner search to about 0.3 px, stage 2 sides fitted with an error-function edge and intersected.
    Args:    image: grey (h, w). corners_px: detector's corners (4, 2). cells: cells along a side with its border.
             camera: for the bow the lens gives the sides; None where there is no lens to correct.
    """
    height, width = image.shape
    start = np.clip(np.asarray(corners_px, dtype=np.float64), 0.0, [width - 1.0, height - 1.0])
    coarse = corner_search(image, start, cells)
    sags = side_sags(camera, coarse)
    fit, corners = fit_corners(image, coarse, cells, sags)
    if fit is SideFit.COVERED:  # the search may have run to an inner corner; the contour did not
        again, from_contour = fit_corners(image, start, cells, sags)
        if again is SideFit.CLEAN:
            return again, from_contour
    return fit, corners
