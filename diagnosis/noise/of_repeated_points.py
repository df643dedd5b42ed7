"""The noise of points tracked in motion, from repeats of one command laid over each other.

What an arm does wrong it does again in every repeat: only the tracker's scatter and its drift differ.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from machine.rotations import Array

REPEAT_SAMPLES_MIN = 8  # of one point in each repeat
# Of the usual time between two samples of a point: where repeats are sampled in between
SAMPLE_MATCH_MAX_PERIODS = 0.51
DRIFT_TO_SCATTER_RATIO_MAX = 2.0  # of the scatter: trackers drift by about as much as they scatter
DRIFT_FALSE_ALARM_RATE = 1e-3  # how often repeats' means of a tracker without drift are taken to drift


@dataclass(frozen=True, slots=True)
class RepeatedPoints:
    """Standard deviations (3,) [m]: `point_sigma_m`, of one sample, drift and all, from `sigma_dof` differences;
    `drift_m`, of a repeat's mean beyond what scatter explains, 0 where that can be chance.
    """

    point_sigma_m: Array
    drift_m: Array
    sigma_dof: int

    @property
    def scatters(self) -> bool:
        """Whether no more than a tracker's drift lies between repeats: no link grows between two looks at it."""
        drift = float((self.drift_m**2).sum())
        return drift <= DRIFT_TO_SCATTER_RATIO_MAX**2 * (float((self.point_sigma_m**2).sum()) - drift)


def repeated_points(
    residual: Array, which: NDArray[np.int64], when: Array, repeats: tuple[tuple[tuple[float, float, float], ...], ...]
) -> RepeatedPoints | None:
    """The noise of residuals (m, 3) [m] of points `which` (m,) at `when` (m,) [s]; None without samples to compare.

    Args:  repeats: of each command that was driven again, each run's start of the segment, first and last instant [s].
    Model: r_k(t) = f(t) + d_k + e: deviations from the repeats' mean at one time since the start, (K - 1) m free ones.
           The mean of a repeat's deviations scatters by own / sqrt(m), and by the drift.
    """
    squares, free = np.zeros(3), 0
    of_means, by_scatter, free_means = np.zeros(3), 0.0, 0
    for runs in repeats:
        deviations = [
            d
            for point in np.unique(which)
            if (d := _point_run_deviations(residual, which == point, when, runs)) is not None
        ]
        if not deviations:
            continue
        for deviation in deviations:
            squares += (deviation**2).sum(axis=(0, 1))
            free += (len(deviation) - 1) * deviation.shape[1]
        # All points of a tracker drift together.
        means = np.mean([deviation.mean(axis=1) for deviation in deviations], axis=0)
        of_means += (means**2).sum(axis=0)
        by_scatter += (len(means) - 1) / sum(deviation.shape[1] for deviation in deviations)
        free_means += len(means) - 1
    if not free:
        return None
    variance = squares / free
    expected = by_scatter / free_means * variance
    beyond = (of_means.sum() / free_means - expected.sum()) if free_means else 0.0
    by_chance = float(chi2.isf(DRIFT_FALSE_ALARM_RATE, 3 * free_means)) / (3 * free_means) * float(expected.sum())
    drifts = of_means.sum() / free_means > by_chance
    drift = np.sqrt(np.maximum(of_means / free_means - expected, 0.0)) if drifts and beyond > 0.0 else np.zeros(3)
    return RepeatedPoints(np.sqrt(variance), drift, free)


def _point_run_deviations(
    residual: Array, here: NDArray[np.bool_], when: Array, runs: tuple[tuple[float, float, float], ...]
) -> Array | None:
    """One point's deviations (K, m, 3) from the mean of K runs; None where a run has too few samples of it."""
    series = []
    for start_s, first_s, last_s in runs:
        rows = np.nonzero(here & (when >= first_s) & (when <= last_s))[0]
        series.append((when[rows] - start_s, residual[rows]))
    if min(len(t) for t, _ in series) < REPEAT_SAMPLES_MIN:
        return None
    at = series[0][0]
    usual = float(np.median(np.diff(at)))
    kept, taken = np.ones(len(at), dtype=bool), []
    for t, values in series:
        right = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
        nearest = np.where(np.abs(t[right] - at) < np.abs(t[right - 1] - at), right, right - 1)
        kept &= np.abs(t[nearest] - at) <= SAMPLE_MATCH_MAX_PERIODS * usual
        taken.append(values[nearest])
    if kept.sum() < REPEAT_SAMPLES_MIN:
        return None
    together = np.stack(taken)[:, kept]
    return together - together.mean(axis=0)
