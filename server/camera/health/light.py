"""Black, white and empty pictures, flicker, and an exposure that changes while the rows are read out."""

from collections import deque

import numpy as np
from numba import njit

from server.camera.health.findings import FaultCode, Finding, Pair
from server.camera.health.thumbnail import GAIN, MEAN, STD, WHITE, EyeCells
from server.vision.contracts import Array

BLACK_GREY = 16.0  # a cell no brighter than this ...
BLACK_STD_GREY = 4.0  # ... and without structure is black; video black is 16
BLACK_CELLS_MAX_FRAC = 0.5
SATURATED_MAX_FRAC = 0.5
CONTRAST_STD_MIN_GREY = 2.0  # spread of all cells and within them: less is one plain surface
EYE_CONTRAST_RATIO_MIN = 0.2  # the spread of one eye against the other's


class ExposureMonitor:
    """Looks at one pair only: nothing to remember."""

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """Black, saturated or without contrast."""
        black = [_black_frac(eye) for _, eye in pair.eyes]
        if min(black) > BLACK_CELLS_MAX_FRAC:
            return (_both_black(min(black)),)
        if max(black) > BLACK_CELLS_MAX_FRAC:
            return (_one_black("left" if black[0] > BLACK_CELLS_MAX_FRAC else "right", max(black)),)
        white = [float(eye.cell_field(WHITE).mean()) for _, eye in pair.eyes]
        if max(white) > SATURATED_MAX_FRAC:
            return (_saturation_finding("left" if white[0] >= white[1] else "right", white),)
        return _low_contrast_findings(pair)


def _black_frac(eye: EyeCells) -> float:
    return float(np.mean((eye.cell_field(MEAN) < BLACK_GREY) & (eye.cell_field(STD) < BLACK_STD_GREY)))


def _both_black(share: float) -> Finding:
    extent = "both eyes are black" if share > 0.95 else f"{100 * share:.0f} % of both eyes is black"
    limit = f"(limit {100 * BLACK_CELLS_MAX_FRAC:.0f} %)"
    return Finding(FaultCode.BLACK, f"{extent} {limit}; check exposure, lens cap and light")


def _one_black(eye: str, share: float) -> Finding:
    extent = f"the {eye} eye is black" if share > 0.95 else f"{100 * share:.0f} % of the {eye} eye is black"
    return Finding(FaultCode.EYE_GONE, f"{extent} (limit {100 * BLACK_CELLS_MAX_FRAC:.0f} %); check its lens and cable")


def _saturation_finding(eye: str, white: list[float]) -> Finding:
    name = "both eyes are" if min(white) > SATURATED_MAX_FRAC else f"the {eye} eye is"
    share = f"{100 * max(white):.0f} % of its pixels (limit {100 * SATURATED_MAX_FRAC:.0f} %)"
    return Finding(FaultCode.SATURATED, f"{name} saturated: {share}; lower the exposure or shade the lamp")


def _low_contrast_findings(pair: Pair) -> tuple[Finding, ...]:
    spread = [eye.spread_grey for _, eye in pair.eyes]
    if max(spread) < CONTRAST_STD_MIN_GREY:
        text = (
            f"no contrast in either eye: {max(spread):.1f} grey levels (limit {CONTRAST_STD_MIN_GREY:g}); check "
            "lenses, fog and light"
        )
        return (Finding(FaultCode.NO_CONTRAST, text),)
    low = min(spread)
    if low < CONTRAST_STD_MIN_GREY and low < EYE_CONTRAST_RATIO_MIN * max(spread):
        eye = "left" if spread[0] < spread[1] else "right"
        text = (
            f"the {eye} eye shows nothing: contrast {low:.1f} grey levels (limit {CONTRAST_STD_MIN_GREY:g}), the other "
            f"eye {max(spread):.1f}; check its lens and cable"
        )
        return (Finding(FaultCode.EYE_GONE, text),)
    return ()


FLICKER_WINDOW = 12
FLICKER_MAX_FRAC = 0.04  # root mean square of the gain from pair to pair
BRIGHTNESS_STEP_MAX_FRAC = 0.06  # from one picture to the next, once
FLICKER_REVERSALS_MIN = 5  # of 10 possible: a lamp switched once or an exposure that settles does not flicker
UNEVEN_EXPOSURE_MAX_FRAC = 0.06  # gain of the rows' bands against each other
UNEVEN_ROUGHNESS_MAX_FRAC = 0.5  # of the cells in a band against the band: light is alike along a row, content is not
GAIN_MEAN_MIN_GREY = 8.0


class LightMonitor:
    """Gains of the last pairs, both eyes together."""

    def __init__(self) -> None:
        self._gains: deque[float] = deque(maxlen=FLICKER_WINDOW)

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """Compare the light of this pair with the light of those before."""
        if pair.is_first:
            self._gains.clear()
            return ()
        gain, spread, rough = _brightness_change_measures(
            pair.left_cells.cell_statistics, pair.right_cells.cell_statistics
        )
        self._gains.append(gain)
        return (*self._flicker_findings(), *_uneven_exposure_findings(spread, rough))

    def _flicker_findings(self) -> tuple[Finding, ...]:
        step = self._gains[-1]
        if abs(step) > BRIGHTNESS_STEP_MAX_FRAC:
            text = (
                f"brightness changed by {100 * step:+.0f} % from one picture to the next (limit "
                f"{100 * BRIGHTNESS_STEP_MAX_FRAC:.0f} %); fix the exposure by hand, keep the light steady"
            )
            return (Finding(FaultCode.FLICKER, text, forbids_odometry=False),)
        if len(self._gains) < FLICKER_WINDOW // 2:
            return ()
        gains = np.array(self._gains)
        size = float(np.sqrt(np.mean(gains**2)))
        turns = int(np.sum(gains[1:] * gains[:-1] < 0.0))
        if size <= FLICKER_MAX_FRAC or turns < FLICKER_REVERSALS_MIN * (len(gains) - 2) / (FLICKER_WINDOW - 2):
            return ()
        text = (
            f"brightness flickers by {100 * size:.0f} % from picture to picture (limit {100 * FLICKER_MAX_FRAC:.0f} "
            "%); set the exposure to a multiple of the mains' half period (10 or 8.3 ms) or change the lamp"
        )
        return (Finding(FaultCode.FLICKER, text, forbids_odometry=False),)


@njit(cache=True, nogil=True)
def _brightness_change_measures(left: Array, right: Array) -> tuple[float, float, float]:
    """Change of light as a fraction: median of all cells; spread of the bands' medians; median distance from those."""
    rows, cols = left.shape[0], left.shape[1]
    gains = np.empty((rows, 2 * cols))
    for p in range(rows):
        for q in range(cols):
            gains[p, q] = left[p, q, GAIN] / max(left[p, q, MEAN], GAIN_MEAN_MIN_GREY)
            gains[p, cols + q] = right[p, q, GAIN] / max(right[p, q, MEAN], GAIN_MEAN_MIN_GREY)
    bands = np.empty(rows)
    for p in range(rows):
        bands[p] = np.sort(gains[p])[cols]
    middle = np.sort(gains.copy().reshape(-1))[rows * cols]
    for p in range(rows):
        for q in range(2 * cols):
            gains[p, q] = abs(gains[p, q] - bands[p])
    rough = np.sort(gains.copy().reshape(-1))[rows * cols]
    return float(middle), float(bands.max() - bands.min()), float(rough)


def _uneven_exposure_findings(spread: float, rough: float) -> tuple[Finding, ...]:
    if spread <= UNEVEN_EXPOSURE_MAX_FRAC or rough > UNEVEN_ROUGHNESS_MAX_FRAC * spread:
        return ()
    text = (
        f"exposure changes within the picture by {100 * spread:.0f} % (limit {100 * UNEVEN_EXPOSURE_MAX_FRAC:.0f} %); "
        "fix the exposure by hand, or change a lamp that flickers"
    )
    return (Finding(FaultCode.UNEVEN_EXPOSURE, text, forbids_odometry=False),)
