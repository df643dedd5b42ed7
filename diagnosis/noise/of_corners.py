"""The noise of marker corners: each corner's own, and a shift that all corners of one frame share.

Why: where the arm stands 0.3 mm off its model, every corner of that picture moves together. Counted corner by corner
such a frame would speak with the weight of forty measurements, and any small effect that bends a few frames would win.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machine.remainder import Remainder
from machine.rotations import Array

CORNER_AXIS_COUNT = 2  # u, v


@dataclass(frozen=True, slots=True)
class CornerNoise:
    """Standard deviations of u and v [px]: of each corner (2,), and shared by the corners of one frame (2,)."""

    corner_sigma_px: Array
    frame_shared_sigma_px: Array

    def with_remainder(self, record: Remainder | None) -> "CornerNoise":
        """Raised by what a machine file's baseline leaves: `sigma` of each corner, `by_axis` shared."""
        if record is None:
            return self
        more = np.array(record.by_axis if len(record.by_axis) == CORNER_AXIS_COUNT else (0.0, 0.0))
        return CornerNoise(np.hypot(self.corner_sigma_px, record.sigma), np.hypot(self.frame_shared_sigma_px, more))

    def whiten(self, rows: Array, groups: NDArray[np.int64]) -> Array:
        """White residuals (sets, N) of residuals [px] in groups (N,) by `groups_of`.

        Model: covariance own^2 I + shared^2 11' within a group of n, whose inverse root takes from each row the share
               1 - own / sqrt(own^2 + n shared^2) of the group's mean.
        """
        count = np.bincount(groups)
        axis = np.arange(len(count)) % CORNER_AXIS_COUNT
        own = self.corner_sigma_px[axis]
        share = 1.0 - own / np.sqrt(own**2 + count * self.frame_shared_sigma_px[axis] ** 2)
        out = np.empty_like(rows)
        for k, row in enumerate(rows):
            mean = np.bincount(groups, weights=row) / np.maximum(count, 1)
            out[k] = (row - (share * mean)[groups]) / own[groups]
        return out


UNIT_CORNER_NOISE = CornerNoise(np.ones(CORNER_AXIS_COUNT), np.zeros(CORNER_AXIS_COUNT))  # residuals as they are


def groups_of(pixels: Array) -> NDArray[np.int64]:
    """Frame and axis of each corner that was seen (N,), of pixels (frames, ..., 2), NaN unseen."""
    frame = np.arange(len(pixels)).reshape(-1, *[1] * (pixels.ndim - 1))
    both = CORNER_AXIS_COUNT * frame + np.arange(CORNER_AXIS_COUNT)
    return np.broadcast_to(both, pixels.shape)[np.isfinite(pixels)].astype(np.int64)


def noise_of_visits(visits: list[Array], least: int) -> CornerNoise | None:
    """From corners (k, C, 2) of the same view seen k times, several views; None below `least` repeated corners."""
    own, shared, visited, corners = np.zeros(CORNER_AXIS_COUNT), np.zeros(CORNER_AXIS_COUNT), 0, 0
    for view in visits:
        seen = view[:, np.isfinite(view).all(axis=(0, 2))]
        k, n = seen.shape[:2]
        if k < 2 or n < 2:
            continue
        deviation = seen - seen.mean(axis=0)
        mean = deviation.mean(axis=1)
        within = ((deviation - mean[:, None]) ** 2).sum(axis=(0, 1))
        own += within
        shared += (mean**2).sum(axis=0) - within / (n * (n - 1))
        visited += k - 1
        corners += (k - 1) * (n - 1)
    if corners < least:
        return None
    return CornerNoise(np.sqrt(own / corners), np.sqrt(np.maximum(shared / visited, 0.0)))


def variances_of(raw: Array, groups: NDArray[np.int64]) -> tuple[Array, Array]:
    """Variances [px^2] of residuals (N,) [px] in groups (N,) by `groups_of`, of u and v: of each corner (2,), and what
    the corners of a frame share (2,), which chance can bring below 0.
    """
    count = np.maximum(np.bincount(groups), 1)
    mean = np.bincount(groups, weights=raw) / count
    within = np.bincount(groups, weights=(raw - mean[groups]) ** 2)
    axis = np.arange(len(count)) % CORNER_AXIS_COUNT
    own, shared = np.zeros(CORNER_AXIS_COUNT), np.zeros(CORNER_AXIS_COUNT)
    for a in range(CORNER_AXIS_COUNT):
        some = (axis == a) & (count > 1)
        own[a] = within[some].sum() / max(float((count[some] - 1).sum()), 1.0)
        shared[a] = np.mean(mean[some] ** 2 - own[a] / count[some]) if some.any() else 0.0
    return own, shared
