"""What is done to a film before the odometry sees it: pairs dropped, a blackout, a hand in the picture."""

from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np

from benchmarks.vision.odometry.film import Film
from server.vision.contracts import Image

Disturbance = Literal["none", "every 4th", "blackout", "hand"]
DISTURBANCES: tuple[str, ...] = get_args(Disturbance)
BLACKOUT_S = (3.0, 5.0)
HAND_S = (2.0, 6.0)
HAND_FRAC = 0.36  # of the image's width and more where the fingers are: about a third of its area
HAND_PX_S = 40.0  # it does not keep still


@dataclass(frozen=True, slots=True)
class Showing:
    """Which pairs of a film are shown, and what happens to them."""

    film: Film
    disturbance: Disturbance

    @property
    def numbers(self) -> range:
        """Pairs shown."""
        return range(0, len(self.film.jpegs), 4 if self.disturbance == "every 4th" else 1)

    def seconds(self, number: int) -> float:
        """Time of a pair since the first."""
        return 1e-9 * (self.film.t_exposure_ns[number] - self.film.t_exposure_ns[0])

    def pair(self, number: int) -> tuple[Image, Image]:
        """Left and right eye as disturbed."""
        left, right = self.film.pair(number)
        t_s = self.seconds(number)
        if self.disturbance == "blackout" and BLACKOUT_S[0] <= t_s < BLACKOUT_S[1]:
            return np.zeros_like(left), np.zeros_like(right)
        if self.disturbance == "hand" and HAND_S[0] <= t_s < HAND_S[1]:
            shift = HAND_PX_S * np.sin(3.0 * t_s)
            return _with_hand(left, 20.0 + shift, t_s), _with_hand(right, -60.0 + shift, t_s)
        return left, right


def _with_hand(image: Image, shift_px: float, t_s: float) -> Image:
    """A hand from the right: palm, four fingers, skin with folds that move along, nearer than the wall."""
    height, width = image.shape
    cover = np.zeros_like(image)
    edge = width * (1.0 - HAND_FRAC) + shift_px
    cv2.rectangle(cover, (round(edge), round(0.08 * height)), (width, round(0.92 * height)), 255, -1)
    for finger in range(4):
        y = round(height * (0.2 + 0.2 * finger) + 15.0 * np.sin(2.0 * t_s + finger))
        cv2.line(cover, (round(edge - 0.1 * width), y), (width, y), 255, 90)
    skin = _skin(height, width)
    moved = cv2.warpAffine(
        skin, np.array([[1.0, 0.0, shift_px], [0.0, 1.0, 20.0 * np.sin(2.0 * t_s)]]), (width, height)
    )
    return np.where(cover > 0, np.asarray(moved, np.uint8), image)


def _skin(height: int, width: int) -> Image:
    rng = np.random.default_rng(5)
    folds = cv2.GaussianBlur(rng.normal(0.0, 1.0, (height, width)).astype(np.float32), (0, 0), 3.0)
    return np.clip(150.0 + 25.0 * folds / folds.std(), 0, 255).astype(np.uint8)
