"""Coarse correspondence between two images: pyramidal KLT, checked forward and backward."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from server.vision.contracts import Array, Image

WINDOW_PX = 21
LEVELS = 4
RETURN_MAX_PX = 0.7  # a point must come back to within this
CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)


@dataclass(frozen=True, slots=True)
class Flow:
    """Points (n, 2) [px] in the second image, and which of them (n,) may be believed."""

    points_px: Array
    good: NDArray[np.bool_]


def flow(first: Image, second: Image, points_px: Array, guess_px: Array | None = None) -> Flow:
    """Where points of the first image are in the second.

    Args:    first, second: grey (h, w). points_px (n, 2). guess_px (n, 2): start, the same place if None.
    Source:  Lucas and Kanade 1981 in pyramids (Bouguet); forward-backward check of Kalal 2010.
    """
    if len(points_px) == 0:
        return Flow(np.zeros((0, 2)), np.zeros(0, dtype=bool))
    start = np.ascontiguousarray(points_px, dtype=np.float32).reshape(-1, 1, 2)
    guess = start.copy() if guess_px is None else np.ascontiguousarray(guess_px, dtype=np.float32).reshape(-1, 1, 2)
    there, forward = _klt(first, second, start, guess)
    back, backward = _klt(second, first, there, start.copy())
    returned = np.linalg.norm((back - start).reshape(-1, 2), axis=1)
    good = (forward.reshape(-1) == 1) & (backward.reshape(-1) == 1) & (returned < RETURN_MAX_PX)
    return Flow(there.reshape(-1, 2).astype(np.float64), good)


def _klt(first: Image, second: Image, points: np.ndarray, guess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        first,
        second,
        points,
        guess.copy(),
        winSize=(WINDOW_PX, WINDOW_PX),
        maxLevel=LEVELS,
        criteria=CRITERIA,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=1e-5,
    )
    return np.asarray(found), np.asarray(status)
