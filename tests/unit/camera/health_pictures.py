"""Stereo pairs for the tests of health: a wall seen by two eyes, with a sensor's noise, as the stream sends it."""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np

from machine.description import StereoCamera
from server.camera.contracts import StereoFrame
from server.camera.sources.side_by_side import split_side_by_side
from server.vision.contracts import Image

MS = 1_000_000
PERIOD_MS = 33
LATENCY_MS = 40
WIDTH, HEIGHT = 1280, 720
DISPARITY_PX = 48  # 1.3 m
MARGIN_PX = 200

CAMERA = StereoCamera(
    width_px=WIDTH,
    height_px=HEIGHT,
    fx_px=528.0,
    fy_px=528.0,
    cx_px=639.5,
    cy_px=359.5,
    distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
    baseline_m=0.12,
    rate_hz=30.0,
    rectified=True,
)


@lru_cache(maxsize=2)
def wall(seed: int = 1, contrast: float = 1.0) -> Image:
    """A wall larger than the picture, with structure at all scales."""
    rng = np.random.default_rng(seed)
    shape = HEIGHT + MARGIN_PX, WIDTH + 2 * MARGIN_PX
    total = np.zeros(shape, np.float32)
    for size_px, height in ((4, 14.0), (16, 18.0), (64, 16.0), (240, 12.0)):
        coarse = rng.standard_normal((shape[0] // size_px + 3, shape[1] // size_px + 3)).astype(np.float32)
        fine = cv2.resize(coarse, None, fx=size_px, fy=size_px, interpolation=cv2.INTER_CUBIC)
        total += height * fine[: shape[0], : shape[1]]
    return np.clip(118.0 + contrast * total, 6, 250).astype(np.uint8)


@lru_cache(maxsize=1)
def noise_bank() -> np.ndarray:
    """Standard normal noise, long enough for a picture from anywhere in its first half."""
    return np.random.default_rng(0).standard_normal(2 * WIDTH * HEIGHT, np.float32)


def seen(wall: Image, at_px: tuple[int, int], noise_grey: float, starts: tuple[int, ...]) -> tuple[Image, Image]:
    """Left and right as the sensor gives them; `starts`: where each eye's noise is read from the bank."""
    both = []
    for shift, start in zip((0, DISPARITY_PX), starts, strict=True):
        left, top = MARGIN_PX + at_px[0] + shift, MARGIN_PX // 2 + at_px[1]
        noise = noise_bank()[start : start + WIDTH * HEIGHT].reshape(HEIGHT, WIDTH)
        behind = wall[top : top + HEIGHT, left : left + WIDTH]
        both.append(np.clip(behind + np.float32(noise_grey) * noise + 0.5, 0, 255).astype(np.uint8))
    return both[0], both[1]


def sent(left: Image, right: Image, quality: int | None) -> Image:
    """Both side by side, through the stream's compression."""
    picture = np.hstack([left, right])
    if quality is None:
        return picture
    good, jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not good:
        raise ValueError("picture cannot be encoded")
    return np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_GRAYSCALE), np.uint8)


@lru_cache(maxsize=48)
def good_picture(
    seed: int, contrast: float, at_px: tuple[int, int], noise_grey: float, starts: tuple[int, ...], quality: int | None
) -> Image:
    """What a camera sends. Cameras of the same seed send the same: made once for all tests (20 ms each)."""
    picture = sent(*seen(wall(seed, contrast), at_px, noise_grey, starts), quality)
    picture.setflags(write=False)
    return picture


class Camera:
    """Gives the next pair of a camera that looks at a wall; `at_px`: where, so that the caller can move it."""

    def __init__(self, noise_grey: float = 1.5, quality: int | None = 95, seed: int = 1, contrast: float = 1.0) -> None:
        self.seed, self.contrast = seed, contrast
        self.noise_grey, self.quality = noise_grey, quality
        self.rng = np.random.default_rng(seed)
        self.number = 0
        self.at_px = (0, 0)

    def _starts(self) -> tuple[int, ...]:
        return tuple(int(self.rng.integers(0, WIDTH * HEIGHT)) for _ in range(2))

    def eyes(self) -> tuple[Image, Image]:
        """Left and right as the sensor gives them."""
        return seen(wall(self.seed, self.contrast), self.at_px, self.noise_grey, self._starts())

    def frame(self, left: Image, right: Image) -> StereoFrame:
        """The frame that the server reads of these pictures; the next stamp."""
        return self.stamped(sent(left, right, self.quality))

    def stamped(self, picture: Image) -> StereoFrame:
        """The frame of a picture that was sent; the next stamp."""
        self.number += 1
        t_ns = self.number * PERIOD_MS * MS
        return StereoFrame(*split_side_by_side(picture), t_ns, t_ns + LATENCY_MS * MS, self.number)

    def next(self) -> StereoFrame:
        """The next good pair."""
        return self.stamped(
            good_picture(self.seed, self.contrast, self.at_px, self.noise_grey, self._starts(), self.quality)
        )


def walk(n: int, reach_px: int = 80) -> Iterator[tuple[int, int]]:
    """Places of a smooth way to and fro."""
    for number in range(n):
        angle = 2.0 * np.pi * number / 60.0
        yield round(reach_px * np.sin(angle)), round(0.4 * reach_px * np.sin(2.0 * angle))


def moved_stamp(frame: StereoFrame, ms: float) -> StereoFrame:
    """The same pair, its stamp shifted."""
    return replace(frame, t_exposure_ns=frame.t_exposure_ns + round(ms * MS))
