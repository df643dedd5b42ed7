"""Are the eyes the camera file's: not swapped, rows alike, no bow of the lens left? By spots matched in many pairs."""

from collections import deque
from collections.abc import Sequence

import cv2
import numpy as np

from machine.camera import undistort_to_rays
from machine.description import StereoCamera
from server.camera.health.findings import FaultCode, Finding
from server.camera.health.matching import HALF, match_spot
from server.camera.health.pair import Pair
from server.vision.contracts import Array, Image

GRID_ROWS, GRID_COLS = 7, 12
SPOTS_EVERY, SPOTS = 6, 3  # pairs; spots tried in such a pair
BURST_TRIES = 40  # spots tried in one pair when one of them is odd, until so many match ...
BURST_ENOUGH = 12
BURST_NEEDED = 6  # ... and this many must match for a verdict
KEPT = 96
SWAPPED_MIN_PX = 2.0
SWAPPED_FRAC = 0.8
ROWS_MAX_PX = 2.5  # median
BOW_MAX_PX = 0.7  # root mean square over the spots, of what a bow explains
BOW_SIGMAS = 8.0
BOW_NEEDED = 40
BOW_OUTLIER_PX = 8.0  # off the median row difference: a false match


class RigMonitor:
    """A spot now and then is enough while all is well; an odd one brings many in the same pair, which decide."""

    def __init__(self, camera: StereoCamera | None) -> None:
        self._camera = camera
        self._next = self._pairs = 0
        self._kept: deque[Array] = deque(maxlen=KEPT)
        self._burst = True

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """Match some more spots; many of them at the start and while something is wrong."""
        if self._camera is None:
            return ()
        if pair.first:
            self._kept.clear()
            self._burst = True
        self._pairs += 1
        if not self._burst and self._pairs % SPOTS_EVERY:
            return ()
        thumbs = _area_thumb(pair.frame.left, pair.step), _area_thumb(pair.frame.right, pair.step)
        spots = [] if self._burst else self._matched(pair, thumbs, SPOTS, SPOTS)
        if self._burst or any(_odd(spot, self._camera) for spot in spots):
            return self._examine(pair, thumbs, self._camera)
        return _bow(self._kept, self._camera) if spots else ()

    def _examine(self, pair: Pair, thumbs: tuple[Image, Image], camera: StereoCamera) -> tuple[Finding, ...]:
        """Many spots of this pair alone; what was kept from a rig that was another is forgotten."""
        spots = self._matched(pair, thumbs, BURST_TRIES, BURST_ENOUGH)
        findings = _verdict(spots, camera) if len(spots) >= BURST_NEEDED else ()
        self._burst = bool(findings)
        if findings:
            self._kept.clear()
            return findings
        return _bow(self._kept, camera)

    def _matched(self, pair: Pair, thumbs: tuple[Image, Image], tries: int, enough: int) -> list[Array]:
        """Rays x, y of the next spots that show themselves in both eyes, left and right (4,)."""
        rows, cols = thumbs[0].shape
        if self._camera is None or min(rows, cols) < 4 * HALF:
            return []
        spots: list[Array] = []
        for _ in range(tries):
            self._next = (self._next + 31) % (GRID_ROWS * GRID_COLS)  # 31 and 84 have no common factor: all are visited
            row, col = divmod(self._next, GRID_COLS)
            i = HALF + 1 + round(row * (rows - 2 * HALF - 3) / (GRID_ROWS - 1))
            j = HALF + 1 + round(col * (cols - 2 * HALF - 3) / (GRID_COLS - 1))
            found = match_spot(pair.frame.left, pair.frame.right, *thumbs, pair.step, i, j)
            if np.isfinite(found[0]):
                spots.append(undistort_to_rays(self._camera, found.reshape(2, 2)).reshape(4))
                if len(spots) == enough:
                    break
        self._kept.extend(spots)
        return spots


def _area_thumb(image: Image, step: int) -> Image:
    """A small picture of mean greys: unlike samples of single pixels it looks the same between two pixels."""
    size = image.shape[1] // step, image.shape[0] // step
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _odd(spot: Array, camera: StereoCamera) -> bool:
    swapped = (spot[0] - spot[2]) * camera.fx_px < -SWAPPED_MIN_PX
    return bool(swapped or abs(spot[1] - spot[3]) * camera.fy_px > ROWS_MAX_PX)


def _verdict(spots: Sequence[Array], camera: StereoCamera) -> tuple[Finding, ...]:
    """Swapped, or rows that differ, by the spots of one pair."""
    rays = np.array(spots)
    disparities = (rays[:, 0] - rays[:, 2]) * camera.fx_px
    if float(np.mean(disparities < -SWAPPED_MIN_PX)) >= SWAPPED_FRAC:
        median_px = float(np.median(disparities))
        text = f"disparity {median_px:.0f} px is negative; left and right eye are swapped: exchange them"
        return (Finding(FaultCode.EYES_SWAPPED, text),)
    rows_px = float(np.median(np.abs(rays[:, 1] - rays[:, 3])) * camera.fy_px)
    if rows_px <= ROWS_MAX_PX:
        return ()
    text = (
        f"rows of the two eyes differ by {rows_px:.1f} px (limit {ROWS_MAX_PX:g} px); the images are not rectified as "
        "the camera file says, or the rig was bumped: load the file of this stream, or recalibrate"
    )
    return (Finding(FaultCode.ROWS_DIFFER, text),)


def _bow(kept: Sequence[Array], camera: StereoCamera) -> tuple[Finding, ...]:
    """A bow k left in the rows: y_left - y_right = k y (x_left^2 - x_right^2), the lens model's first order."""
    if len(kept) < BOW_NEEDED:
        return ()
    spots = np.array(kept)
    rows = (spots[:, 1] - spots[:, 3]) * camera.fy_px
    pattern = spots[:, 1] * (spots[:, 0] ** 2 - spots[:, 2] ** 2) * camera.fy_px
    near = np.abs(rows - np.median(rows)) < BOW_OUTLIER_PX
    rows, pattern = rows[near] - np.median(rows[near]), pattern[near] - np.median(pattern[near])
    weight = float(pattern @ pattern)
    if weight == 0.0:
        return ()
    bow = float(pattern @ rows) / weight
    effect_px = abs(bow) * np.sqrt(weight / len(rows))
    rest_px = float(np.sqrt(np.mean((rows - bow * pattern) ** 2)))
    if effect_px <= BOW_MAX_PX or abs(bow) < BOW_SIGMAS * max(rest_px, 0.1) / np.sqrt(weight):
        return ()
    rectified = camera.distortion[0] * bow < 0.0
    what = "the images are rectified, but the file states raw" if rectified else "the images are not rectified"
    text = (
        f"rows of the two eyes differ by {effect_px:.1f} px in a lens's pattern (limit {BOW_MAX_PX:g} px; k1 is off by "
        f"{bow:+.2f}); {what}, or it is another camera's file: load the file of this stream"
    )
    return (Finding(FaultCode.NOT_AS_CALIBRATED, text),)
