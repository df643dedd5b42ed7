"""Are the eyes the camera file's: not swapped, rows alike, no bow of the lens left? By spots matched in many pairs."""

from collections import deque
from collections.abc import Sequence

import cv2
import numpy as np
from numba import njit

from machine.camera import undistort_to_rays
from machine.description import StereoCamera
from server.camera.health.findings import FaultCode, Finding, Pair
from server.vision.contracts import Array, Image

COARSE_PATCH_HALF_PX = 4  # of a coarse patch [thumbnail px]
COLUMN_SHIFT_MAX_THUMB_PX = 40  # thumbnail px: 320 px, a spot at 0.2 m
ROW_SHIFT_MAX_THUMB_PX = 2  # thumbnail px: 16 px
FINE_PATCH_HALF_PX = 12
FINE_ROWS, FINE_COLS = 7, 7
TEXTURE_MIN_GREY = 5.0
COARSE_MIN, FINE_MIN = 0.85, 0.85  # correlation
BEST_CORRELATION_MARGIN = 0.08  # the best place must beat every other that is not its neighbour by this


@njit(cache=True, nogil=True)
def _coarse_patch_shift(left: Image, right: Image, i: int, j: int) -> tuple[bool, int, int]:
    """Row and column shift (right minus left) of the best correlation of a patch; False where it is not clear."""
    rows, cols = right.shape
    n = (2 * COARSE_PATCH_HALF_PX + 1) ** 2
    total, squares = 0.0, 0.0
    for a in range(-COARSE_PATCH_HALF_PX, COARSE_PATCH_HALF_PX + 1):
        for b in range(-COARSE_PATCH_HALF_PX, COARSE_PATCH_HALF_PX + 1):
            g = float(left[i + a, j + b])
            total += g
            squares += g * g
    spread = squares - total * total / n
    if spread < n * TEXTURE_MIN_GREY**2:
        return False, 0, 0
    scores = np.full((2 * ROW_SHIFT_MAX_THUMB_PX + 1, 2 * COLUMN_SHIFT_MAX_THUMB_PX + 1), -1.0)
    best, best_row, best_col = -1.0, 0, 0
    for r in range(-ROW_SHIFT_MAX_THUMB_PX, ROW_SHIFT_MAX_THUMB_PX + 1):
        if i + r < COARSE_PATCH_HALF_PX or i + r >= rows - COARSE_PATCH_HALF_PX:
            continue
        for s in range(-COLUMN_SHIFT_MAX_THUMB_PX, COLUMN_SHIFT_MAX_THUMB_PX + 1):
            if j + s < COARSE_PATCH_HALF_PX or j + s >= cols - COARSE_PATCH_HALF_PX:
                continue
            t, q, c = 0.0, 0.0, 0.0
            for a in range(-COARSE_PATCH_HALF_PX, COARSE_PATCH_HALF_PX + 1):
                for b in range(-COARSE_PATCH_HALF_PX, COARSE_PATCH_HALF_PX + 1):
                    g = float(right[i + r + a, j + s + b])
                    t += g
                    q += g * g
                    c += g * left[i + a, j + b]
            other = q - t * t / n
            if other < 0.1 * spread:
                continue
            score = (c - t * total / n) / np.sqrt(spread * other)
            scores[r + ROW_SHIFT_MAX_THUMB_PX, s + COLUMN_SHIFT_MAX_THUMB_PX] = score
            if score > best:
                best, best_row, best_col = score, r, s
    if best < COARSE_MIN:
        return False, 0, 0
    for r in range(-ROW_SHIFT_MAX_THUMB_PX, ROW_SHIFT_MAX_THUMB_PX + 1):
        for s in range(-COLUMN_SHIFT_MAX_THUMB_PX, COLUMN_SHIFT_MAX_THUMB_PX + 1):
            far = abs(r - best_row) > 1 or abs(s - best_col) > 2
            if (
                far
                and scores[r + ROW_SHIFT_MAX_THUMB_PX, s + COLUMN_SHIFT_MAX_THUMB_PX] > best - BEST_CORRELATION_MARGIN
            ):
                return False, 0, 0
    return True, best_row, best_col


@njit(cache=True, nogil=True)
def _patch_correlation(left: Image, right: Image, y: int, x: int, v: int, u: int, stride: int) -> float:
    t, q, total, squares, c, n = 0.0, 0.0, 0.0, 0.0, 0.0, 0
    for a in range(-FINE_PATCH_HALF_PX, FINE_PATCH_HALF_PX + 1, stride):
        for b in range(-FINE_PATCH_HALF_PX, FINE_PATCH_HALF_PX + 1, stride):
            f, g = float(left[y + a, x + b]), float(right[v + a, u + b])
            total += f
            squares += f * f
            t += g
            q += g * g
            c += f * g
            n += 1
    spread = (squares - total * total / n) * (q - t * t / n)
    return (c - t * total / n) / np.sqrt(spread) if spread > 0.0 else -1.0


@njit(cache=True, nogil=True)
def _parabola_peak_offset(low: float, mid: float, high: float) -> float:
    """Offset of a parabola's top through three equally spaced values."""
    bend = low - 2.0 * mid + high
    return 0.5 * (low - high) / bend if bend < -1e-9 else 0.0


@njit(cache=True, nogil=True)
def match_spot(left: Image, right: Image, thumb_left: Image, thumb_right: Image, step: int, i: int, j: int) -> Array:
    """Where a spot of the left eye lies in the right one.

    Model:   normalised correlation: coarse over the thumbnails, both signs of disparity; then over full pixels around
             it, at half the density first; a parabola through the best and its neighbours.
    Args:    thumb_*: mean greys of squares of `step` px. i, j: the spot on the thumbnail.
    Returns: u_left, v_left, u_right, v_right [raw px]; NaN where the spot is plain, hidden, or alike to another.
    """
    none = np.full(4, np.nan)
    clear, row, col = _coarse_patch_shift(thumb_left, thumb_right, i, j)
    if not clear:
        return none
    y, x = i * step + step // 2, j * step + step // 2
    v, u = y + row * step, x + col * step
    margin = FINE_PATCH_HALF_PX + 2
    if y < margin or x < margin or y + margin >= left.shape[0] or x + margin >= left.shape[1]:
        return none
    if v < margin + FINE_ROWS or v + margin + FINE_ROWS >= right.shape[0]:
        return none
    if u < margin + FINE_COLS or u + margin + FINE_COLS >= right.shape[1]:
        return none
    best, best_v, best_u = -1.0, v, u
    for a in range(-FINE_ROWS + 1, FINE_ROWS, 2):
        for b in range(-FINE_COLS + 1, FINE_COLS, 2):
            score = _patch_correlation(left, right, y, x, v + a, u + b, 3)
            if score > best:
                best, best_v, best_u = score, v + a, u + b
    around = np.empty((5, 5))
    for a in range(-2, 3):
        for b in range(-2, 3):
            around[a + 2, b + 2] = _patch_correlation(left, right, y, x, best_v + a, best_u + b, 1)
    top, p, q = -1.0, 2, 2
    for a in range(1, 4):
        for b in range(1, 4):
            if around[a, b] > top:
                top, p, q = around[a, b], a, b
    if top < FINE_MIN:
        return none
    none[0], none[1] = x, y
    none[2] = best_u + q - 2 + _parabola_peak_offset(around[p, q - 1], top, around[p, q + 1])
    none[3] = best_v + p - 2 + _parabola_peak_offset(around[p - 1, q], top, around[p + 1, q])
    return none


GRID_ROWS, GRID_COLS = 7, 12
SPOTS_EVERY, SPOTS = 6, 3  # pairs; spots tried in such a pair
BURST_SPOTS_MAX = 40  # spots tried in one pair when one of them is odd, until so many match ...
BURST_MATCHES_WANTED = 12
BURST_MATCHES_MIN = 6  # ... and this many must match for a verdict
MATCH_BUFFER_SIZE = 96
SWAPPED_DISPARITY_MIN_PX = 2.0
SWAPPED_MATCHES_MIN_FRAC = 0.8
ROW_OFFSET_MAX_PX = 2.5  # median
DISTORTION_MAX_PX = 0.7  # root mean square over the spots, of what a bow explains
DISTORTION_SIGMAS_MIN = 8.0
DISTORTION_MATCHES_MIN = 40
DISTORTION_OUTLIER_PX = 8.0  # off the median row difference: a false match


class RigMonitor:
    """A spot now and then is enough while all is well; an odd one brings many in the same pair, which decide."""

    def __init__(self, camera: StereoCamera | None) -> None:
        self._camera = camera
        self._next = self._pairs = 0
        self._kept: deque[Array] = deque(maxlen=MATCH_BUFFER_SIZE)
        self._burst = True

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """Match some more spots; many of them at the start and while something is wrong."""
        if self._camera is None:
            return ()
        if pair.is_first:
            self._kept.clear()
            self._burst = True
        self._pairs += 1
        if not self._burst and self._pairs % SPOTS_EVERY:
            return ()
        thumbs = (
            _area_thumb(pair.frame.left, pair.thumbnail_step_px),
            _area_thumb(pair.frame.right, pair.thumbnail_step_px),
        )
        spots = [] if self._burst else self._matched(pair, thumbs, SPOTS, SPOTS)
        if self._burst or any(_is_misaligned_spot(spot, self._camera) for spot in spots):
            return self._examine_single_pair(pair, thumbs, self._camera)
        return _distortion_findings(self._kept, self._camera) if spots else ()

    def _examine_single_pair(
        self, pair: Pair, thumbs: tuple[Image, Image], camera: StereoCamera
    ) -> tuple[Finding, ...]:
        """Many spots of this pair alone; what was kept from a rig that was another is forgotten."""
        spots = self._matched(pair, thumbs, BURST_SPOTS_MAX, BURST_MATCHES_WANTED)
        findings = _misalignment_findings(spots, camera) if len(spots) >= BURST_MATCHES_MIN else ()
        self._burst = bool(findings)
        if findings:
            self._kept.clear()
            return findings
        return _distortion_findings(self._kept, camera)

    def _matched(self, pair: Pair, thumbs: tuple[Image, Image], tries: int, enough: int) -> list[Array]:
        """Rays x, y of the next spots that show themselves in both eyes, left and right (4,)."""
        rows, cols = thumbs[0].shape
        if self._camera is None or min(rows, cols) < 4 * COARSE_PATCH_HALF_PX:
            return []
        spots: list[Array] = []
        for _ in range(tries):
            self._next = (self._next + 31) % (GRID_ROWS * GRID_COLS)  # 31 and 84 have no common factor: all are visited
            row, col = divmod(self._next, GRID_COLS)
            i = COARSE_PATCH_HALF_PX + 1 + round(row * (rows - 2 * COARSE_PATCH_HALF_PX - 3) / (GRID_ROWS - 1))
            j = COARSE_PATCH_HALF_PX + 1 + round(col * (cols - 2 * COARSE_PATCH_HALF_PX - 3) / (GRID_COLS - 1))
            found = match_spot(pair.frame.left, pair.frame.right, *thumbs, pair.thumbnail_step_px, i, j)
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


def _is_misaligned_spot(spot: Array, camera: StereoCamera) -> bool:
    swapped = (spot[0] - spot[2]) * camera.fx_px < -SWAPPED_DISPARITY_MIN_PX
    return bool(swapped or abs(spot[1] - spot[3]) * camera.fy_px > ROW_OFFSET_MAX_PX)


def _misalignment_findings(spots: Sequence[Array], camera: StereoCamera) -> tuple[Finding, ...]:
    """Swapped, or rows that differ, by the spots of one pair."""
    rays = np.array(spots)
    disparities = (rays[:, 0] - rays[:, 2]) * camera.fx_px
    if float(np.mean(disparities < -SWAPPED_DISPARITY_MIN_PX)) >= SWAPPED_MATCHES_MIN_FRAC:
        median_px = float(np.median(disparities))
        text = f"disparity {median_px:.0f} px is negative; left and right eye are swapped: exchange them"
        return (Finding(FaultCode.EYES_SWAPPED, text),)
    rows_px = float(np.median(np.abs(rays[:, 1] - rays[:, 3])) * camera.fy_px)
    if rows_px <= ROW_OFFSET_MAX_PX:
        return ()
    text = (
        f"rows of the two eyes differ by {rows_px:.1f} px (limit {ROW_OFFSET_MAX_PX:g} px); the images are not "
        "rectified as the camera file says, or the rig was bumped: load the file of this stream, or recalibrate"
    )
    return (Finding(FaultCode.ROWS_DIFFER, text),)


def _distortion_findings(kept: Sequence[Array], camera: StereoCamera) -> tuple[Finding, ...]:
    """A bow k left in the rows: y_left - y_right = k y (x_left^2 - x_right^2), the lens model's first order."""
    if len(kept) < DISTORTION_MATCHES_MIN:
        return ()
    spots = np.array(kept)
    rows = (spots[:, 1] - spots[:, 3]) * camera.fy_px
    pattern = spots[:, 1] * (spots[:, 0] ** 2 - spots[:, 2] ** 2) * camera.fy_px
    near = np.abs(rows - np.median(rows)) < DISTORTION_OUTLIER_PX
    rows, pattern = rows[near] - np.median(rows[near]), pattern[near] - np.median(pattern[near])
    weight = float(pattern @ pattern)
    if weight == 0.0:
        return ()
    bow = float(pattern @ rows) / weight
    effect_px = abs(bow) * np.sqrt(weight / len(rows))
    rest_px = float(np.sqrt(np.mean((rows - bow * pattern) ** 2)))
    if effect_px <= DISTORTION_MAX_PX or abs(bow) < DISTORTION_SIGMAS_MIN * max(rest_px, 0.1) / np.sqrt(weight):
        return ()
    rectified = camera.distortion[0] * bow < 0.0
    what = "the images are rectified, but the file states raw" if rectified else "the images are not rectified"
    text = (
        f"rows of the two eyes differ by {effect_px:.1f} px in a lens's pattern (limit {DISTORTION_MAX_PX:g} px; k1 is "
        f"off by {bow:+.2f}); {what}, or it is another camera's file: load the file of this stream"
    )
    return (Finding(FaultCode.NOT_AS_CALIBRATED, text),)
