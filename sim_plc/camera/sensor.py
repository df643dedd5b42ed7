"""Lens and sensor model: motion blur, point spread, noise, clipping to 8 bits."""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.rotations import Array
from sim_plc.camera.texture import Grey

_BANK_SIZE = 1 << 22
_BANK_UNITS = 23.71  # bank values per standard deviation: +-5.3 sd fit into int8; odd, so that sums meet no ties
_READ_SHARE = 0.3  # part of the variance at mid grey that does not grow with brightness
_MIN_MOTION_PX = 0.25  # shorter streaks vanish in the point spread
_SHORT_STREAK_PX = 2.0  # below, a 3 x 3 kernel carries the streak's exact second moments
_KERNEL_OVERSAMPLE = 64


def noise_bank(rng: np.random.Generator) -> NDArray[np.int8]:
    """Standard normal noise in units of 1 / 23.71 standard deviation."""
    noise = rng.standard_normal(_BANK_SIZE, dtype=np.float32) * np.float32(_BANK_UNITS)
    return np.clip(np.rint(noise), -127, 127).astype(np.int8)


@njit(cache=True, nogil=True, fastmath=True)
def _add_noise(image: Grey, bank: NDArray[np.int8], start: int, gain: float, floor: float, slope: float) -> None:
    flat = image.reshape(-1)
    noise = bank[start : start + flat.size]
    g, a, b = np.float32(gain), np.float32(floor), np.float32(slope)
    for k in range(flat.size):
        grey = np.float32(flat[k])
        value = grey + g * np.float32(noise[k]) * np.sqrt(a + b * grey) + np.float32(0.5)
        flat[k] = np.uint8(min(max(value, np.float32(0.0)), np.float32(255.0)))


def add_noise(image: Grey, bank: NDArray[np.int8], noise_grey: float, rng: np.random.Generator) -> None:
    """Noise in place: read noise plus shot noise (root of the grey), `noise_grey` in all at mid grey; clipped."""
    if noise_grey == 0.0:
        return
    start = int(rng.integers(0, bank.size - image.size))
    _add_noise(image, bank, start, noise_grey / _BANK_UNITS, _READ_SHARE, (1.0 - _READ_SHARE) / 128.0)


def point_spread(image: Grey, psf_px: float) -> Grey:
    """Gaussian blur of standard deviation `psf_px`."""
    if psf_px == 0.0:
        return image
    size = 2 * int(np.ceil(3.0 * psf_px)) + 1
    blurred = cv2.GaussianBlur(image, (size, size), psf_px, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blurred, np.uint8)


def _short_streak(streak_px: Array) -> NDArray[np.float32]:
    """3 x 3 kernel with the second moments of an even streak, d d^T / 12."""
    xx, xy, yy = streak_px[0] ** 2 / 12.0, streak_px[0] * streak_px[1] / 12.0, streak_px[1] ** 2 / 12.0
    kernel = [[xy / 4, yy / 2, -xy / 4], [xx / 2, 1.0 - xx - yy, xx / 2], [-xy / 4, yy / 2, xy / 4]]
    return np.array(kernel, np.float32)


def streak_kernel(streak_px: Array) -> NDArray[np.float32]:
    """Filter of an even, centred, straight streak (du, dv) [px]; sums to one."""
    if np.hypot(*streak_px) < _SHORT_STREAK_PX:
        return _short_streak(streak_px)
    reach = int(np.ceil(0.5 * np.abs(streak_px).max())) + 1
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
    for f in (np.arange(_KERNEL_OVERSAMPLE) + 0.5) / _KERNEL_OVERSAMPLE - 0.5:
        u, v = f * streak_px[0] + reach, f * streak_px[1] + reach
        i, j = int(v), int(u)
        a, b = v - i, u - j
        kernel[i : i + 2, j : j + 2] += [[(1 - a) * (1 - b), (1 - a) * b], [a * (1 - b), a * b]]
    return kernel / kernel.sum()


def motion_blur(image: Grey, streak_px: Array) -> Grey:
    """The picture smeared evenly along one streak; unchanged when the streak is shorter than 0.25 px."""
    if not np.hypot(*streak_px) > _MIN_MOTION_PX:
        return image
    smeared = cv2.filter2D(image, -1, streak_kernel(streak_px), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(smeared, np.uint8)
