"""Medians and percentiles with bootstrap intervals, and the paired comparison of two methods."""

from dataclasses import dataclass

import numpy as np

from machine.rotations import Array

RESAMPLES = 2000


@dataclass(frozen=True, slots=True)
class Interval:
    """A figure and its 95 % bootstrap interval."""

    value: float
    low: float
    high: float


def percentile_interval(values: Array, percent: float, seed: int = 0) -> Interval:
    """Percentile of values (n,), infinite ones (refused) included as worst, with its bootstrap interval."""
    draws = _draws(len(values), seed)
    resampled = _percentile(values[draws], percent)
    return Interval(float(_percentile(values[None], percent)[0]), *_ends(resampled))


def ratio_interval(values: Array, others: Array, percent: float, seed: int = 0) -> Interval:
    """Percentile of values over that of others, both (n,) on the same cases, resampled together."""
    draws = _draws(len(values), seed)
    resampled = _percentile(values[draws], percent) / _percentile(others[draws], percent)
    value = _percentile(values[None], percent)[0] / _percentile(others[None], percent)[0]
    return Interval(float(value), *_ends(resampled))


def _draws(n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, n, (RESAMPLES, n))


def _percentile(rows: Array, percent: float) -> Array:
    """Of each row, by the nearest rank: no arithmetic between infinite values."""
    rank = min(int(np.ceil(percent / 100.0 * rows.shape[1])), rows.shape[1]) - 1
    return np.partition(rows, rank, axis=1)[:, rank]


def _ends(resampled: Array) -> tuple[float, float]:
    ordered = np.sort(resampled)
    return float(ordered[int(0.025 * len(ordered))]), float(ordered[int(0.975 * len(ordered)) - 1])
