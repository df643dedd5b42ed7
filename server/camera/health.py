"""Are these images what a working stereo camera gives? Anything else forbids their use in a look."""

import zlib

import cv2
import numpy as np

from server.camera.contracts import StereoFrame
from server.vision.contracts import Image

SAMPLE_STEP = 8  # every 8th row and column is enough to tell black, white and frozen
BLACK_P95_GREY = 16  # brightest 5 % darker than this: nothing is seen
WHITE_GREY = 250
WHITE_FRAC = 0.6  # more saturated pixels than this: no contrast is left


class ImageHealth:
    """Remembers the pair before, since a frozen camera shows only in comparison."""

    def __init__(self) -> None:
        self._before: tuple[int, int, int, int] | None = None  # connection, stamp, left sum, right sum

    def check(self, frame: StereoFrame) -> tuple[str, ...]:
        """Warnings about this pair; empty when it is fit for use."""
        left, right = _sample(frame.left), _sample(frame.right)
        warnings = [*_exposure_warnings(left, right)]
        now = (frame.connection, frame.t_exposure_ns, zlib.crc32(left.tobytes()), zlib.crc32(right.tobytes()))
        if self._before is not None and self._before[0] == frame.connection:
            warnings += _change_warnings(self._before, now)
        self._before = now
        return tuple(warnings)


def _sample(image: Image) -> Image:
    return np.ascontiguousarray(image[::SAMPLE_STEP, ::SAMPLE_STEP])


def _change_warnings(before: tuple[int, int, int, int], now: tuple[int, int, int, int]) -> list[str]:
    warnings: list[str] = []
    if now[1] < before[1]:
        warnings.append(f"camera stamps run backwards by {(before[1] - now[1]) / 1e6:.1f} ms")
    elif now[1] == before[1]:
        warnings.append("camera frozen: its stamp does not advance")
    for eye, index in (("left", 2), ("right", 3)):
        if now[index] == before[index]:
            warnings.append(f"camera frozen: the {eye} image repeats")
    return warnings


def _exposure_warnings(left: Image, right: Image) -> list[str]:
    black = [float(np.percentile(eye, 95)) < BLACK_P95_GREY for eye in (left, right)]
    if all(black):
        return ["both eyes are black; check exposure, lens cap and light"]
    if any(black):
        return [f"the {'left' if black[0] else 'right'} eye is black; check its lens and cable"]
    white = [float(np.mean(eye >= WHITE_GREY)) for eye in (left, right)]
    if max(white) > WHITE_FRAC:
        return [f"{100 * max(white):.0f} % of an eye is saturated (limit {100 * WHITE_FRAC:.0f} %); lower the exposure"]
    return []


def sharpness(image: Image) -> float:
    """Mean square of the Laplacian at half size [grey levels^2]: falls when motion or focus blurs the image."""
    half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return float(np.mean(np.square(cv2.Laplacian(half, cv2.CV_32F))))
