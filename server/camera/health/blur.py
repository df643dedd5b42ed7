"""Blur: against the scene's own running level of sharpness, and in pixels at the sides of the markers.

A printed side is a step; how wide it is in the picture is the blur, whatever the scene. The running level finds blur
where no marker is in view.
"""

import numpy as np
from numba import njit

from server.camera.health.findings import FaultCode, Finding, Pair
from server.camera.health.thumbnail import EyeCells
from server.vision.contracts import NO_WHITE_MARGIN_REASON, Array, Image, MarkerView
from server.vision.quadrilateral import grey_at

SHARPNESS_SAMPLE_STEP_PX = 15  # has no factor in common with the grids that pictures are made of
SHARPNESS_PAIRS_MIN = 15
SHARPNESS_MEAN_WEIGHT = 0.03
SHARPNESS_MIN_FRAC = 0.3  # of the running mean; sharpness against contrast falls with the square of the blur
BLUR_MAX_PX = 1.8  # standard deviation; the eyes of a sharp camera have 0.5 to 0.9
BLUR_MAX_CELL_FRAC = 0.30  # of a printed cell: beyond, dark and bright cells run into each other
MARKER_CELLS_PER_SIDE = 6.0
EDGE_PROFILE_POSITIONS = (0.3, 0.5, 0.7)  # along a side
REACH_MAX_PX, PROFILE_STEP_PX = 7.0, 0.5
MARKER_SIDE_MIN_PX = 24.0
CONTRAST_MIN_GREY = 25.0
MARKER_VIEWS_PER_PAIR = 2


@njit(cache=True, nogil=True)
def _image_sharpness(image: Image, step: int) -> float:
    """Mean square of the Laplacian of 2 x 2 means, at every `step`-th place."""
    total, n = 0.0, 0
    for y in range(2, image.shape[0] - 3, step):
        for x in range(2, image.shape[1] - 3, step):
            value = 0
            for a in range(2):
                for b in range(2):
                    value -= 4 * int(image[y + a, x + b])
                    value += int(image[y + a - 2, x + b]) + int(image[y + a + 2, x + b])
                    value += int(image[y + a, x + b - 2]) + int(image[y + a, x + b + 2])
            total += value * value / 16.0
            n += 1
    return total / max(n, 1)


def sharpness(image: Image) -> float:
    """Mean square of the Laplacian at half size [grey levels^2]: falls when motion or focus blurs the image.

    Taken at one place in 64 of the half-size picture. Zero for anything but a grey picture.
    """
    if image.ndim != 2 or image.dtype != np.uint8 or min(image.shape) < 8:
        return 0.0
    return float(
        _image_sharpness(image, SHARPNESS_SAMPLE_STEP_PX if image.shape[0] >= 30 * SHARPNESS_SAMPLE_STEP_PX else 2)
    )


@njit(cache=True, nogil=True)
def _edge_width(image: Image, x: float, y: float, nx: float, ny: float, reach: float) -> float:
    """Standard deviation of the slope of the step along one profile [px]; NaN where there is no clean step."""
    n = int(2.0 * reach / PROFILE_STEP_PX) + 1
    height, width = image.shape
    for k in (-1.0, 1.0):
        u, v = x + k * reach * nx, y + k * reach * ny
        if not (u >= 0.0 and v >= 0.0 and u < width - 1 and v < height - 1):
            return np.nan
    grey = np.empty(n)
    for k in range(n):
        d = -reach + k * PROFILE_STEP_PX
        grey[k] = grey_at(image, x + d * nx, y + d * ny)
    dark, bright = 0.5 * (grey[0] + grey[1]), 0.5 * (grey[n - 1] + grey[n - 2])
    if bright - dark < CONTRAST_MIN_GREY:
        return np.nan
    mean, square, weight = 0.0, 0.0, 0.0
    for k in range(n - 1):
        share = (min(max(grey[k + 1], dark), bright) - min(max(grey[k], dark), bright)) / (bright - dark)
        d = -reach + (k + 0.5) * PROFILE_STEP_PX
        weight += share
        mean += share * d
        square += share * d * d
    if weight < 0.5:
        return np.nan
    mean /= weight
    return np.sqrt(max(square / weight - mean * mean, 0.0))


@njit(cache=True, nogil=True)
def side_blurs(image: Image, corners: Array) -> Array:
    """Blur at the four sides of a marker (4,) [px], each the median of three profiles; NaN where none is clean."""
    out = np.full(4, np.nan)
    for i in range(4):
        x0, y0 = corners[i, 0], corners[i, 1]
        dx, dy = corners[(i + 1) % 4, 0] - x0, corners[(i + 1) % 4, 1] - y0
        length = np.sqrt(dx * dx + dy * dy)
        if length < MARKER_SIDE_MIN_PX:
            continue
        reach = min(REACH_MAX_PX, 0.9 * length / MARKER_CELLS_PER_SIDE)
        found = np.full(3, np.nan)
        for k in range(3):
            found[k] = _edge_width(
                image,
                x0 + EDGE_PROFILE_POSITIONS[k] * dx,
                y0 + EDGE_PROFILE_POSITIONS[k] * dy,
                dy / length,
                -dx / length,
                reach,
            )
        if not np.isnan(found).any():
            out[i] = np.median(found)
    return out


class BlurMonitor:
    """Sharpness of the last pairs, and the blur at the markers of this one."""

    def __init__(self) -> None:
        self._levels: dict[str, tuple[float, int]] = {}
        self._turn = 0

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """Compare with the running level."""
        if pair.is_first:
            self._levels.clear()
        images = {"left": pair.frame.left, "right": pair.frame.right}
        for name, eye in pair.eyes:
            finding = self._against_level(name, images[name], eye)
            if finding is not None:
                return (finding,)
        return ()

    def _against_level(self, name: str, image: Image, eye: EyeCells) -> Finding | None:
        level = sharpness(image) / max(eye.spread_grey**2, 1.0)
        usual, count = self._levels.get(name, (0.0, 0))
        if count >= SHARPNESS_PAIRS_MIN and level < SHARPNESS_MIN_FRAC * usual:
            text = (
                f"the {name} eye is blurred: sharpness {100 * level / usual:.0f} % of its running level (limit "
                f"{100 * SHARPNESS_MIN_FRAC:.0f} %); wait until the boom rests, check focus and lens"
            )
            return Finding(FaultCode.BLURRED, text, forbids_odometry=False)
        self._levels[name] = usual + max(SHARPNESS_MEAN_WEIGHT, 1.0 / (count + 1)) * (level - usual), count + 1
        return None

    def at_markers(self, pair: Pair) -> tuple[Finding, ...]:
        """Measure some of the markers in this pair's observation."""
        seen = () if pair.observation is None else pair.observation.marker_views
        views = [view for view in seen if NO_WHITE_MARGIN_REASON not in view.reason]
        if not views:
            return ()
        self._turn += 1
        for number in range(min(MARKER_VIEWS_PER_PAIR, len(views))):
            finding = _view_blur(pair, views[(self._turn * MARKER_VIEWS_PER_PAIR + number) % len(views)])
            if finding is not None:
                return (finding,)
        return ()


def _view_blur(pair: Pair, view: MarkerView) -> Finding | None:
    eyes = (("left", pair.frame.left, view.corners_left_px), ("right", pair.frame.right, view.corners_right_px))
    for name, image, corners in eyes:
        if corners is None:
            continue
        blurs = side_blurs(image, np.ascontiguousarray(corners, dtype=np.float64))
        if np.isnan(blurs).all():
            continue
        blur_px = float(np.nanmax(blurs))
        side_px = float(np.min(np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)))
        limit_px = min(BLUR_MAX_PX, BLUR_MAX_CELL_FRAC * side_px / MARKER_CELLS_PER_SIDE)
        if blur_px > limit_px:
            text = (
                f"the {name} eye is blurred at marker {view.marker_id}: {blur_px:.1f} px (limit {limit_px:.1f} px); "
                "wait until the boom rests, focus, or shorten the exposure"
            )
            return Finding(FaultCode.BLURRED, text, forbids_odometry=False)
    return None
