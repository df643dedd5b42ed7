"""Light that changes from pair to pair: flicker, and an exposure that changes while the rows are read out.

The change of every cell is clipped, so that moved content hardly counts, and taken against its grey: a gain.
"""

from collections import deque

import numpy as np
from numba import njit

from server.camera.health.findings import FaultCode, Finding
from server.camera.health.pair import Pair
from server.camera.health.thumbnail import GAIN, MEAN
from server.vision.contracts import Array

FLICKER_WINDOW = 12
FLICKER_MAX_FRAC = 0.04  # root mean square of the gain from pair to pair
STEP_MAX_FRAC = 0.06  # from one picture to the next, once
TURNS_MIN = 5  # of 10 possible: a lamp switched once or an exposure that settles does not flicker
UNEVEN_MAX_FRAC = 0.06  # gain of the rows' bands against each other
UNEVEN_ROUGH_MAX_FRAC = 0.5  # of the cells in a band against the band: light is alike along a row, content is not
DARK_GREY = 8.0


class LightMonitor:
    """Gains of the last pairs, both eyes together."""

    def __init__(self) -> None:
        self._gains: deque[float] = deque(maxlen=FLICKER_WINDOW)

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """Compare the light of this pair with the light of those before."""
        if pair.first:
            self._gains.clear()
            return ()
        gain, spread, rough = _gains(pair.left.cells, pair.right.cells)
        self._gains.append(gain)
        return (*self._flicker(), *_uneven(spread, rough))

    def _flicker(self) -> tuple[Finding, ...]:
        step = self._gains[-1]
        if abs(step) > STEP_MAX_FRAC:
            text = (
                f"brightness changed by {100 * step:+.0f} % from one picture to the next (limit "
                f"{100 * STEP_MAX_FRAC:.0f} %); fix the exposure by hand, keep the light steady"
            )
            return (Finding(FaultCode.FLICKER, text, forbids_odometry=False),)
        if len(self._gains) < FLICKER_WINDOW // 2:
            return ()
        gains = np.array(self._gains)
        size = float(np.sqrt(np.mean(gains**2)))
        turns = int(np.sum(gains[1:] * gains[:-1] < 0.0))
        if size <= FLICKER_MAX_FRAC or turns < TURNS_MIN * (len(gains) - 2) / (FLICKER_WINDOW - 2):
            return ()
        text = (
            f"brightness flickers by {100 * size:.0f} % from picture to picture (limit {100 * FLICKER_MAX_FRAC:.0f} "
            "%); set the exposure to a multiple of the mains' half period (10 or 8.3 ms) or change the lamp"
        )
        return (Finding(FaultCode.FLICKER, text, forbids_odometry=False),)


@njit(cache=True, nogil=True)
def _gains(left: Array, right: Array) -> tuple[float, float, float]:
    """Change of light as a fraction: median of all cells; spread of the bands' medians; median distance from those."""
    rows, cols = left.shape[0], left.shape[1]
    gains = np.empty((rows, 2 * cols))
    for p in range(rows):
        for q in range(cols):
            gains[p, q] = left[p, q, GAIN] / max(left[p, q, MEAN], DARK_GREY)
            gains[p, cols + q] = right[p, q, GAIN] / max(right[p, q, MEAN], DARK_GREY)
    bands = np.empty(rows)
    for p in range(rows):
        bands[p] = np.sort(gains[p])[cols]
    middle = np.sort(gains.copy().reshape(-1))[rows * cols]
    for p in range(rows):
        for q in range(2 * cols):
            gains[p, q] = abs(gains[p, q] - bands[p])
    rough = np.sort(gains.copy().reshape(-1))[rows * cols]
    return float(middle), float(bands.max() - bands.min()), float(rough)


def _uneven(spread: float, rough: float) -> tuple[Finding, ...]:
    if spread <= UNEVEN_MAX_FRAC or rough > UNEVEN_ROUGH_MAX_FRAC * spread:
        return ()
    text = (
        f"exposure changes within the picture by {100 * spread:.0f} % (limit {100 * UNEVEN_MAX_FRAC:.0f} %); "
        "fix the exposure by hand, or change a lamp that flickers"
    )
    return (Finding(FaultCode.UNEVEN_EXPOSURE, text, forbids_odometry=False),)
