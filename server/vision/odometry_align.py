"""Fine correspondence: each keyframe patch, warped as the geometry predicts, is laid onto the new image."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from server.vision.contracts import Array, Image
from server.vision.small_algebra import solve_positive

PATCH_HALF_PX = 7
PATCH_SIZE_PX = 2 * PATCH_HALF_PX + 1
WARPED_PATCH_HALF_MAX_PX = 32  # of half a warped patch
ITERATIONS_MAX = 15
CONVERGED_STEP_PX = 0.003
ALIGNMENT_SHIFT_MAX_PX = 4.0  # from the guess; farther is another place
PATCH_CORRELATION_MIN = 0.85
Greys = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Alignment:
    """Points (n, 2) [px] in the new image, their zero-mean normalised correlation (n,), and which are good (n,)."""

    points_px: Array
    correlation: Array
    valid: NDArray[np.bool_]


@njit(cache=True, nogil=True, fastmath=True)
def _sample_warped_patch(image: Image, x: float, y: float, warp: Array, patch: Greys) -> bool:
    """Patch with a rim of one pixel, sampled through the warp; False where it leaves the image or is torn apart."""
    height, width = image.shape
    reach = PATCH_HALF_PX + 1
    span_x = reach * (abs(warp[0, 0]) + abs(warp[0, 1]))
    span_y = reach * (abs(warp[1, 0]) + abs(warp[1, 1]))
    if not (x - span_x >= 0.0 and x + span_x < width - 1 and y - span_y >= 0.0 and y + span_y < height - 1):
        return False
    if span_x > WARPED_PATCH_HALF_MAX_PX or span_y > WARPED_PATCH_HALF_MAX_PX:
        return False
    left, top = (
        int(x) - WARPED_PATCH_HALF_MAX_PX - 1,
        int(y) - WARPED_PATCH_HALF_MAX_PX - 1,
    )  # so that all is positive, and exact in float32
    x0, y0 = np.float32(x - left), np.float32(y - top)
    xx, xy = np.float32(warp[0, 0]), np.float32(warp[0, 1])
    yx, yy = np.float32(warp[1, 0]), np.float32(warp[1, 1])
    for j in range(2 * reach + 1):
        for i in range(2 * reach + 1):
            u = x0 + xx * np.float32(i - reach) + xy * np.float32(j - reach)
            v = y0 + yx * np.float32(i - reach) + yy * np.float32(j - reach)
            column, row = np.int32(u), np.int32(v)
            a, b = u - np.float32(column), v - np.float32(row)
            k, m = top + row, left + column
            upper = np.float32(image[k, m]) + a * (np.float32(image[k, m + 1]) - np.float32(image[k, m]))
            lower = np.float32(image[k + 1, m]) + a * (np.float32(image[k + 1, m + 1]) - np.float32(image[k + 1, m]))
            patch[j, i] = upper + b * (lower - upper)
    return True


@njit(cache=True, nogil=True, fastmath=True)
def _align_one(
    image: Image, patch: Greys, x: float, y: float, across: Greys, down: Greys, middle: Greys, grey: Greys
) -> tuple[float, float, float]:
    """Inverse compositional translation with gain and offset of the light; correlation -1 where it fails.

    across, down, middle, grey (225,) float32: room for the patch's gradients, its grey about the mean, and the image's.
    """
    height, width = image.shape
    size, count = PATCH_SIZE_PX, PATCH_SIZE_PX * PATCH_SIZE_PX
    one, half = np.float32(1.0), np.float32(0.5)
    mean = np.float32(0.0)
    for j in range(size):
        for i in range(size):
            middle[j * size + i] = patch[j + 1, i + 1]
            across[j * size + i] = half * (patch[j + 1, i + 2] - patch[j + 1, i])
            down[j * size + i] = half * (patch[j + 2, i + 1] - patch[j, i + 1])
            mean += patch[j + 1, i + 1]
    mean /= np.float32(count)
    h = np.zeros((4, 4))
    h00, h01, h02, h03 = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
    h11, h12, h13, h22 = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for i in range(count):
        middle[i] -= mean
        h00 += across[i] * across[i]
        h01 += across[i] * down[i]
        h02 += across[i] * middle[i]
        h03 += across[i]
        h11 += down[i] * down[i]
        h12 += down[i] * middle[i]
        h13 += down[i]
        h22 += middle[i] * middle[i]
    h[0, 0], h[0, 1], h[0, 2], h[0, 3] = h00, h01, h02, h03
    h[1, 1], h[1, 2], h[1, 3], h[2, 2], h[3, 3] = h11, h12, h13, h22, count
    variance = h[2, 2]
    for j in range(4):
        h[j, j] += 1e-3
        for i in range(j):
            h[j, i] = h[i, j]
    if variance < count * 4.0:
        return x, y, -1.0
    gain, offset, correlation = 1.0, 0.0, -1.0
    b = np.zeros(4)
    for _ in range(ITERATIONS_MAX):
        if not (
            x >= PATCH_HALF_PX
            and x < width - PATCH_HALF_PX - 1
            and y >= PATCH_HALF_PX
            and y < height - PATCH_HALF_PX - 1
        ):
            return x, y, -1.0
        column, row = int(x) - PATCH_HALF_PX, int(y) - PATCH_HALF_PX
        right, below = np.float32(x - int(x)), np.float32(y - int(y))  # the same for the whole patch
        w00, w01 = (one - right) * (one - below), right * (one - below)
        w10, w11 = (one - right) * below, right * below
        for j in range(size):
            for i in range(size):
                upper = w00 * image[row + j, column + i] + w01 * image[row + j, column + i + 1]
                lower = w10 * image[row + j + 1, column + i] + w11 * image[row + j + 1, column + i + 1]
                grey[j * size + i] = upper + lower
        b0, b1, b2, b3 = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
        square, product = np.float32(0.0), np.float32(0.0)
        scale, shift = np.float32(gain), np.float32(offset)
        for i in range(count):
            centred = grey[i] - mean
            error = centred - scale * middle[i] - shift
            b0 += across[i] * error
            b1 += down[i] * error
            b2 += middle[i] * error
            b3 += error
            square += centred * centred
            product += centred * middle[i]
        b[0], b[1], b[2], b[3] = b0, b1, b2, b3
        total = b3 + count * offset  # the patch's grey about its mean adds up to nothing
        step = solve_positive(h, b)
        x -= step[0] / gain
        y -= step[1] / gain
        gain = min(max(gain + step[2], 0.3), 3.0)
        offset += step[3]
        spread = square - total * total / count
        correlation = product / np.sqrt(max(spread * variance, 1e-9))
        if abs(step[0]) < CONVERGED_STEP_PX and abs(step[1]) < CONVERGED_STEP_PX:
            break
    return x, y, correlation


@njit(cache=True, nogil=True)
def _align_patches(reference: Image, points: Array, warps: Array, image: Image, guesses: Array) -> tuple[Array, Array]:
    found, correlations = guesses.copy(), np.full(len(points), -1.0)
    patch = np.empty((PATCH_SIZE_PX + 2, PATCH_SIZE_PX + 2), np.float32)
    across = np.empty(PATCH_SIZE_PX * PATCH_SIZE_PX, np.float32)
    down, middle, grey = np.empty_like(across), np.empty_like(across), np.empty_like(across)
    for k in range(len(points)):
        if _sample_warped_patch(reference, points[k, 0], points[k, 1], warps[k], patch):
            x, y, correlation = _align_one(image, patch, guesses[k, 0], guesses[k, 1], across, down, middle, grey)
            found[k, 0], found[k, 1], correlations[k] = x, y, correlation
    return found, correlations


def align_reference_patches(
    reference: Image, points_px: Array, warps: Array, image: Image, guesses_px: Array
) -> Alignment:
    """Sub-pixel places of reference patches in a new image.

    Model:   min over (x, gain, offset) of sum over d of (I(x + d) - gain T(d) - offset)^2, T(d) = I_ref(x_ref + W d),
             inverse compositional Gauss-Newton.
    Args:    reference, image: grey (h, w). points_px (n, 2) in the reference; warps (n, 2, 2) = d(reference px) /
             d(new px); guesses_px (n, 2) to within about 3 px.
    Source:  Baker and Matthews 2004; linear change of light as in Hager and Belhumeur 1998.
    """
    found, correlation = _align_patches(
        reference,
        np.ascontiguousarray(points_px, dtype=np.float64),
        np.ascontiguousarray(warps, dtype=np.float64),
        image,
        np.ascontiguousarray(guesses_px, dtype=np.float64),
    )
    near = np.linalg.norm(found - guesses_px, axis=1) < ALIGNMENT_SHIFT_MAX_PX
    return Alignment(found, correlation, (correlation > PATCH_CORRELATION_MIN) & near)
