"""Dirt on one lens: a dark, soft spot that stays where it is in one eye while the scene moves past it.

Over many pairs in motion the scene averages out and the spot remains, in the mean grey and as a place that changes less
than its surroundings. What sits on the camera's own machine (the tool) stays as well, but both eyes see it. A dark
stone at the place that an approach heads for looks the same for a while: so this is a notice and forbids nothing. Where
dirt lies over a marker, its sides are not clean and the marker is not used.
"""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from server.camera.health.findings import FaultCode, Finding, Pair
from server.camera.health.thumbnail import CHANGE, EyeCells, Thumb
from server.vision.contracts import Image

Map = NDArray[np.float32]

MOTION_CHANGE_MIN_GREY = 3.0  # mean change of a picture from pair to pair: less is rest
RUNNING_MEAN_WEIGHT = 0.02
MOVING_PAIRS_MIN = 60  # in motion
CHECK_INTERVAL_PAIRS = 20
SURROUNDINGS_SIZE_PX = 31  # thumbnail px
SPOT_DARKENING_MIN_FRAC = 0.15
SPOT_CHANGE_MAX_FRAC = 0.6  # change at the spot against its surroundings
SPOT_AREA_MIN_PX = 20  # thumbnail px: 36 px square in the picture
SPOT_AREA_MAX_FRAC = 0.05
BORDER_PX = 4


@njit(cache=True, nogil=True)
def _update_running_averages(grey: Thumb, before: Thumb, weight: float, mean: Map, change: Map) -> None:
    for i in range(grey.shape[0]):
        for j in range(grey.shape[1]):
            mean[i, j] += weight * (0.25 * grey[i, j] - mean[i, j])
            change[i, j] += weight * (0.25 * abs(int(grey[i, j]) - int(before[i, j])) - change[i, j])


class _EyeStatistics:
    """Mean grey and mean change of one eye while the scene moves."""

    def __init__(self) -> None:
        self.mean: Map = np.zeros((0, 0), np.float32)
        self.change: Map = np.zeros((0, 0), np.float32)
        self.before: Thumb = np.zeros((0, 0), np.int16)
        self.count = 0

    def learn(self, eye: EyeCells) -> None:
        if self.mean.shape != eye.grey_thumbnail.shape:
            self.mean = np.zeros(eye.grey_thumbnail.shape, np.float32)
            self.change = np.zeros(eye.grey_thumbnail.shape, np.float32)
            self.before = eye.grey_thumbnail.copy()
            self.count = 0
        elif float(eye.cell_field(CHANGE).mean()) > MOTION_CHANGE_MIN_GREY:
            self.count += 1
            _update_running_averages(
                eye.grey_thumbnail, self.before, max(RUNNING_MEAN_WEIGHT, 1.0 / self.count), self.mean, self.change
            )
        self.before[:] = eye.grey_thumbnail

    def spot_candidate_mask(self) -> Image:
        """Where the mean is darker and the change smaller than all around, as 0 and 1."""
        size = (SURROUNDINGS_SIZE_PX, SURROUNDINGS_SIZE_PX)
        mean_around = cv2.blur(self.mean, size, borderType=cv2.BORDER_REFLECT)
        change_around = cv2.blur(self.change, size, borderType=cv2.BORDER_REFLECT)
        darker = self.mean < (1.0 - SPOT_DARKENING_MIN_FRAC) * mean_around
        quieter = self.change < SPOT_CHANGE_MAX_FRAC * change_around
        return np.asarray(darker & quieter, np.uint8)


class SpotMonitor:
    """Both eyes' maps; judged now and then, the verdict stands in between."""

    def __init__(self) -> None:
        self._eyes = {"left": _EyeStatistics(), "right": _EyeStatistics()}
        self._number = 0
        self._verdict: tuple[Finding, ...] = ()

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """Learn from this pair; every so often look for spots."""
        if pair.is_first:
            self._eyes = {"left": _EyeStatistics(), "right": _EyeStatistics()}
            self._verdict = ()
        for name, eye in pair.eyes:
            self._eyes[name].learn(eye)
        self._number += 1
        if self._number % CHECK_INTERVAL_PAIRS == 0:
            self._verdict = self._lens_spot_findings(pair.thumbnail_step_px)
        return self._verdict

    def _lens_spot_findings(self, step: int) -> tuple[Finding, ...]:
        left, right = self._eyes["left"], self._eyes["right"]
        if min(left.count, right.count) < MOVING_PAIRS_MIN or left.mean.shape != right.mean.shape:
            return ()
        suspects = {name: eye.spot_candidate_mask() for name, eye in self._eyes.items()}
        findings = []
        for name, other in (("left", "right"), ("right", "left")):
            spot = _largest_unmatched_spot(suspects[name], suspects[other], leftwards=name == "left")
            if spot is not None:
                findings.append(_dirty_lens_finding(name, spot, step))
        return tuple(findings)


def _largest_unmatched_spot(suspect: Image, other: Image, leftwards: bool) -> tuple[int, float, float] | None:
    """Area and middle (x, y) of the largest spot that has no partner in the other eye's rows."""
    count, _, stats, middles = cv2.connectedComponentsWithStats(suspect.astype(np.uint8), connectivity=8)
    best: tuple[int, float, float] | None = None
    rows, cols = suspect.shape
    for number in range(1, count):
        left, top, width, height, area = (int(value) for value in stats[number])
        if (
            area < SPOT_AREA_MIN_PX
            or area > SPOT_AREA_MAX_FRAC * suspect.size
            or (best is not None and area <= best[0])
        ):
            continue
        if left < BORDER_PX or top < BORDER_PX or left + width > cols - BORDER_PX or top + height > rows - BORDER_PX:
            continue
        moved = other[top : top + height, : left + width] if leftwards else other[top : top + height, left:]
        if int(moved.sum()) > area // 3:
            continue
        best = area, float(middles[number][0]), float(middles[number][1])
    return best


def _dirty_lens_finding(name: str, spot: tuple[int, float, float], step: int) -> Finding:
    area, x, y = spot
    text = (
        f"a spot on the {name} lens at ({x * step:.0f}, {y * step:.0f}) px, {step * area**0.5:.0f} px wide (limit "
        f"{step * SPOT_AREA_MIN_PX**0.5:.0f} px), stays while the scene moves; wipe the lens"
    )
    return Finding(FaultCode.DIRTY_LENS, text, forbids_look=False, forbids_odometry=False)
