"""The same spots in both eyes, without trust in the rig: rows may differ, disparity may have either sign. Pure."""

from collections.abc import Sequence

import cv2
import numpy as np

from machine.rotations import Array
from server.vision.contracts import Image

FEATURES = 1500
RATIO_MAX = 0.75  # of the best match's distance to the second best's
ROWS_MAX_FRAC = 0.15  # of the height: a rig off by more shows in no sensible picture
WINDOW_PX = 15
REFINED_MAX_PX = 2.5
FEW = 8


def match_eyes(left: Image, right: Image) -> Array:
    """Matched spots (n, 4): u, v in the left eye, u, v in the right [raw px], to about 0.05 px.

    Model:   SIFT at half size, best match both ways and clearly better than the second; then the right eye's place is
             refined by Lucas and Kanade's alignment of the patch at full size, once in each direction.
    """
    finder = cv2.SIFT.create(nfeatures=FEATURES, contrastThreshold=0.02)
    keys_left, words_left = finder.detectAndCompute(_half(left), None)
    keys_right, words_right = finder.detectAndCompute(_half(right), None)
    if len(keys_left) < FEW or len(keys_right) < FEW:
        return np.zeros((0, 4))
    there, back = _nearest(words_left, words_right), _nearest(words_right, words_left)
    pairs = [(i, j) for i, j in there.items() if back.get(j) == i]
    if len(pairs) < FEW:
        return np.zeros((0, 4))
    from_px = _full_px([keys_left[i].pt for i, _ in pairs])
    to_px = _full_px([keys_right[j].pt for _, j in pairs])
    near = np.abs(from_px[:, 1] - to_px[:, 1]) < ROWS_MAX_FRAC * left.shape[0]
    return _refined(left, right, from_px[near], to_px[near])


def _half(image: Image) -> Image:
    return np.asarray(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)


def _full_px(half_px: Sequence[Sequence[float]]) -> np.ndarray:
    """From the halved picture's pixels to the whole one's: a pixel's edges scale, not its centre."""
    return (2.0 * (np.array(half_px, np.float32) + 0.5) - 0.5).astype(np.float32)


def _nearest(words: np.ndarray, others: np.ndarray) -> dict[int, int]:
    """Index of the clearly nearest other word."""
    found = cv2.BFMatcher(cv2.NORM_L2).knnMatch(words, others, k=2)
    return {
        pair[0].queryIdx: pair[0].trainIdx
        for pair in found
        if len(pair) == 2 and pair[0].distance < RATIO_MAX * pair[1].distance
    }


def _refined(left: Image, right: Image, from_px: np.ndarray, to_px: np.ndarray) -> Array:
    if not len(from_px):
        return np.zeros((0, 4))
    there, good = _align(left, right, from_px, to_px)
    back, also = _align(right, left, there, from_px)
    kept = (
        good
        & also
        & (np.linalg.norm(there - to_px, axis=1) < REFINED_MAX_PX)
        & (np.linalg.norm(back - from_px, axis=1) < 0.3)
    )
    return np.hstack([from_px[kept], there[kept]]).astype(float)


def _align(one: Image, other: Image, at: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found, good, _ = cv2.calcOpticalFlowPyrLK(
        np.ascontiguousarray(one),
        np.ascontiguousarray(other),
        at.reshape(-1, 1, 2),
        start.copy().reshape(-1, 1, 2),
        winSize=(WINDOW_PX, WINDOW_PX),
        maxLevel=0,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.005),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return found.reshape(-1, 2), good.ravel().astype(bool)
