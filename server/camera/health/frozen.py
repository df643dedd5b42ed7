"""The same picture again under a new stamp: exactly, or as it comes out of another round of compression.

Every picture of a living sensor carries noise of its own. So what is compared is the fine pattern, in which the noise
is largest against the scene: at rest the scene repeats, the noise does not. In a repeated picture nearly all of the
fine pattern is the old one, everywhere, also where the scene is plain.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from server.camera.health.findings import FaultCode, Finding, Pair
from server.camera.health.light import CONTRAST_STD_MIN_GREY
from server.camera.health.thumbnail import EyeCells, eyes_alike
from server.vision.contracts import Array

TEXTURE_ENERGY_MIN = 1.0  # of a cell's fine pattern: less is compressed away, nothing to compare
COMPARED_CELLS_MIN = 10
FLAT_CELLS_QUANTILE = 0.2  # the plainest fifth of the picture: there the noise rules
# Living pictures at rest: 0.45 to 0.93 for noise of 2 to 0.5 grey levels; recompressed: from 0.96
FROZEN_CORRELATION_MIN = 0.955
FROZEN_CHANGE_MAX_GREY = 0.65
FROZEN_CHANGE_MAX_FRAC = 0.6  # where a stream's own noise at rest is known: so much less change ...
FROZEN_DIFFERENCE_MAX_FRAC = 0.5  # ... and so much less difference of the fine pattern does not come from rest
LEARNED_PAIRS_MIN = 10
RUNNING_MEAN_WEIGHT = 0.1
REST_CORRELATION_MIN = 0.3
BRIGHTNESS_CHANGE_FRAC = 0.1
COPIED_EYE_CORRELATION_MIN = 0.5  # of the two eyes; living eyes have nothing of their noise in common


@dataclass(slots=True)
class _AtRest:
    """How this eye's pictures differ while nothing moves: learnt from good pairs."""

    mean_correlation: float = 0.0
    change_grey: float = 0.0
    mean_brightness_grey: float = 0.0
    n_pairs: int = 0

    def learn(self, alike: float, change_grey: float, brightness: float) -> None:
        """Take a good pair at rest into the running means; a new light means a new noise."""
        if abs(brightness - self.mean_brightness_grey) > BRIGHTNESS_CHANGE_FRAC * self.mean_brightness_grey:
            self.n_pairs = 0
        weight = max(RUNNING_MEAN_WEIGHT, 1.0 / (self.n_pairs + 1))
        self.mean_correlation += weight * (alike - self.mean_correlation)
        self.change_grey += weight * (change_grey - self.change_grey)
        self.mean_brightness_grey += weight * (brightness - self.mean_brightness_grey)
        self.n_pairs += 1

    def is_too_similar(self, alike: float, change_grey: float, brightness: float) -> bool:
        """Whether so little difference is too little for this camera."""
        if (
            self.n_pairs < LEARNED_PAIRS_MIN
            or abs(brightness - self.mean_brightness_grey) > BRIGHTNESS_CHANGE_FRAC * self.mean_brightness_grey
        ):
            return alike > FROZEN_CORRELATION_MIN and change_grey < FROZEN_CHANGE_MAX_GREY
        different = 1.0 - self.mean_correlation
        cleaner = change_grey < FROZEN_CHANGE_MAX_FRAC * self.change_grey
        return cleaner and 1.0 - alike < FROZEN_DIFFERENCE_MAX_FRAC * different


class FrozenMonitor:
    """Repeated pictures, in both eyes or in one; and one eye that is a copy of the other."""

    def __init__(self) -> None:
        self._at_rest = {"left": _AtRest(), "right": _AtRest()}

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """Compare with the pair before, and the eyes with each other."""
        comparable = not pair.is_first or pair.is_resumed
        found = [text for text in (self._repeat(name, eye) for name, eye in pair.eyes) if text] if comparable else []
        findings = [Finding(FaultCode.FROZEN, text) for text in found]
        copied = _copied_eye_finding(pair)
        return (*findings, copied) if copied is not None else tuple(findings)

    def _repeat(self, name: str, eye: EyeCells) -> str:
        if eye.spread_grey < CONTRAST_STD_MIN_GREY:  # black or empty: said elsewhere
            return ""
        likeness = _similarity_to_previous(
            eye.cell_statistics, TEXTURE_ENERGY_MIN, COMPARED_CELLS_MIN, FLAT_CELLS_QUANTILE
        )
        same, alike, change_grey, brightness = likeness
        if same == 1.0:
            return f"camera frozen: the {name} image repeats under a new stamp; restart the camera, check its cable"
        if np.isnan(alike):
            return ""
        at_rest = self._at_rest[name]
        if at_rest.is_too_similar(alike, change_grey, brightness):
            return (
                f"camera frozen: the {name} image repeats but for its compression (noise {100 * alike:.0f} % the same, "
                f"change {change_grey:.2f} grey levels); restart the camera, check its cable"
            )
        if alike > REST_CORRELATION_MIN:
            at_rest.learn(alike, change_grey, brightness)
        return ""


@njit(cache=True, nogil=True)
def _similarity_to_previous(
    cells: Array, energy_min: float, cells_min: int, quantile: float
) -> tuple[float, float, float, float]:
    """Share of unchanged places; correlation of the fine pattern with the one before in the plainest cells (NaN where
    too few cells have one); mean absolute change; mean grey."""
    found, n, same, change, mean = np.empty(cells.shape[0] * cells.shape[1]), 0, 0.0, 0.0, 0.0
    for p in range(cells.shape[0]):
        for q in range(cells.shape[1]):
            mean += cells[p, q, 0]
            change += cells[p, q, 3]
            same += cells[p, q, 8]
            if min(cells[p, q, 5], cells[p, q, 6]) > energy_min:
                found[n] = cells[p, q, 7] / np.sqrt(cells[p, q, 5] * cells[p, q, 6])
                n += 1
    alike = np.sort(found[:n])[int(quantile * n)] if n >= cells_min else np.nan
    return same / found.size, alike, change / found.size, mean / found.size


def _copied_eye_finding(pair: Pair) -> Finding | None:
    if min(eye.spread_grey for _, eye in pair.eyes) < CONTRAST_STD_MIN_GREY:
        return None
    alike = float(
        eyes_alike(
            pair.left_cells.fine_pattern,
            pair.right_cells.fine_pattern,
            TEXTURE_ENERGY_MIN,
            COMPARED_CELLS_MIN,
            FLAT_CELLS_QUANTILE,
        )
    )
    if not alike >= COPIED_EYE_CORRELATION_MIN:
        return None
    text = (
        f"both eyes show the same picture (noise {100 * alike:.0f} % the same, limit "
        f"{100 * COPIED_EYE_CORRELATION_MIN:.0f} %); "
        "one eye is gone: check cables and the stream's layout"
    )
    return Finding(FaultCode.EYE_COPIED, text)
