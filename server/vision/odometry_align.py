"""Fine correspondence: each keyframe patch, warped as the geometry predicts, is laid onto the new image."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from server.vision.contracts import Array, Image
from server.vision.small_algebra import solve_positive

HALF_PX = 7
ITERATIONS_MAX = 15
STEP_MIN_PX = 0.003
AWAY_MAX_PX = 4.0  # from the guess; farther is another place
CORRELATION_MIN = 0.85


@dataclass(frozen=True, slots=True)
class Alignment:
    """Points (n, 2) [px] in the new image, their zero-mean normalised correlation (n,), and which are good (n,)."""

    points_px: Array
    correlation: Array
    good: NDArray[np.bool_]


@njit(cache=True, nogil=True, fastmath=True)
def _grey(image: Image, x: float, y: float) -> float:
    column, row = int(x), int(y)
    a, b = x - column, y - row
    upper = (1.0 - a) * image[row, column] + a * image[row, column + 1]
    lower = (1.0 - a) * image[row + 1, column] + a * image[row + 1, column + 1]
    return (1.0 - b) * upper + b * lower


@njit(cache=True, nogil=True, fastmath=True)
def _template(image: Image, x: float, y: float, warp: Array, patch: Array) -> bool:
    """Patch with a rim of one pixel, sampled through the warp; False where it leaves the image."""
    height, width = image.shape
    reach = HALF_PX + 1
    span_x = reach * (abs(warp[0, 0]) + abs(warp[0, 1]))
    span_y = reach * (abs(warp[1, 0]) + abs(warp[1, 1]))
    if not (x - span_x >= 0.0 and x + span_x < width - 1 and y - span_y >= 0.0 and y + span_y < height - 1):
        return False
    for j in range(-reach, reach + 1):
        for i in range(-reach, reach + 1):
            u = x + warp[0, 0] * i + warp[0, 1] * j
            v = y + warp[1, 0] * i + warp[1, 1] * j
            patch[j + reach, i + reach] = _grey(image, u, v)
    return True


@njit(cache=True, nogil=True, fastmath=True)
def _align_one(image: Image, patch: Array, x: float, y: float, gradients: Array) -> tuple[float, float, float]:
    """Inverse compositional translation with gain and offset of the light; correlation -1 where it fails."""
    height, width = image.shape
    size = 2 * HALF_PX + 1
    mean, count = 0.0, size * size
    for j in range(size):
        for i in range(size):
            mean += patch[j + 1, i + 1]
            gradients[j, i, 0] = 0.5 * (patch[j + 1, i + 2] - patch[j + 1, i])
            gradients[j, i, 1] = 0.5 * (patch[j + 2, i + 1] - patch[j, i + 1])
    mean /= count
    h = np.zeros((4, 4))
    for j in range(size):
        for i in range(size):
            g0, g1, g2 = gradients[j, i, 0], gradients[j, i, 1], patch[j + 1, i + 1] - mean
            h[0, 0] += g0 * g0
            h[0, 1] += g0 * g1
            h[0, 2] += g0 * g2
            h[0, 3] += g0
            h[1, 1] += g1 * g1
            h[1, 2] += g1 * g2
            h[1, 3] += g1
            h[2, 2] += g2 * g2
    variance = h[2, 2]
    h[3, 3] = count
    for j in range(4):
        h[j, j] += 1e-3
        for i in range(j):
            h[j, i] = h[i, j]
    if variance < count * 4.0:
        return x, y, -1.0
    gain, offset, correlation = 1.0, 0.0, -1.0
    b = np.zeros(4)
    for _ in range(ITERATIONS_MAX):
        if not (x >= HALF_PX and x < width - HALF_PX - 1 and y >= HALF_PX and y < height - HALF_PX - 1):
            return x, y, -1.0
        b[:] = 0.0
        sum_grey, sum_square, sum_product = 0.0, 0.0, 0.0
        for j in range(size):
            for i in range(size):
                grey = _grey(image, x + i - HALF_PX, y + j - HALF_PX)
                centred = patch[j + 1, i + 1] - mean
                error = grey - (gain * centred + mean + offset)
                b[0] += gradients[j, i, 0] * error
                b[1] += gradients[j, i, 1] * error
                b[2] += centred * error
                b[3] += error
                sum_grey += grey
                sum_square += grey * grey
                sum_product += grey * centred
        step = solve_positive(h, b)
        x -= step[0] / gain
        y -= step[1] / gain
        gain = min(max(gain + step[2], 0.3), 3.0)
        offset += step[3]
        spread = sum_square - sum_grey * sum_grey / count
        correlation = sum_product / np.sqrt(max(spread * variance, 1e-9))
        if abs(step[0]) < STEP_MIN_PX and abs(step[1]) < STEP_MIN_PX:
            break
    return x, y, correlation


@njit(cache=True, nogil=True)
def _align(reference: Image, points: Array, warps: Array, image: Image, guesses: Array) -> tuple[Array, Array]:
    found, correlations = guesses.copy(), np.full(len(points), -1.0)
    size = 2 * HALF_PX + 1
    patch, gradients = np.empty((size + 2, size + 2)), np.empty((size, size, 2))
    for k in range(len(points)):
        if _template(reference, points[k, 0], points[k, 1], warps[k], patch):
            x, y, correlation = _align_one(image, patch, guesses[k, 0], guesses[k, 1], gradients)
            found[k, 0], found[k, 1], correlations[k] = x, y, correlation
    return found, correlations


def align(reference: Image, points_px: Array, warps: Array, image: Image, guesses_px: Array) -> Alignment:
    """Sub-pixel places of reference patches in a new image.

    Model:   min over (x, gain, offset) of sum over d of (I(x + d) - gain T(d) - offset)^2, T(d) = I_ref(x_ref + W d),
             inverse compositional Gauss-Newton.
    Args:    reference, image: grey (h, w). points_px (n, 2) in the reference; warps (n, 2, 2) = d(reference px) /
             d(new px); guesses_px (n, 2) to within about 3 px.
    Source:  Baker and Matthews 2004; linear change of light as in Hager and Belhumeur 1998.
    """
    found, correlation = _align(
        reference,
        np.ascontiguousarray(points_px, dtype=np.float64),
        np.ascontiguousarray(warps, dtype=np.float64),
        image,
        np.ascontiguousarray(guesses_px, dtype=np.float64),
    )
    near = np.linalg.norm(found - guesses_px, axis=1) < AWAY_MAX_PX
    return Alignment(found, correlation, (correlation > CORRELATION_MIN) & near)
