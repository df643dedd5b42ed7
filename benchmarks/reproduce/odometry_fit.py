"""Fits the odometry's noise to runs of the real one over rendered paths with an exact camera file."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import nnls

from benchmarks.reproduce.noise_model import OdometryNoise
from machine.rotations import Array, rotvec_from_rotation
from server.calibration.chords import arc_lengths

BEND_LENGTH_M = 0.10
_LAGS_M = (0.0, 0.01, 0.02, 0.04, 0.08, 0.15, 0.25, 0.40, 0.60, 0.85, 1.20)
_PAIRS_MAX = 400  # samples of a run that take part
RUNS_MIN = 3


class TooFewRunsError(ValueError):
    """Not enough rendered runs for a fit."""


@dataclass(frozen=True, slots=True)
class OdometryRunPair:
    """One run: odometry's and the true path of the left camera from the same start, (n, 4, 4)."""

    Ts_vo_cam: Array
    Ts_true: Array
    rate_hz: float


def fit_odometry_noise(runs: Sequence[OdometryRunPair]) -> OdometryNoise:
    """Noise of scale, walk, bend and jitter.

    Model:   scale by least squares per run; then the structure function of what is left, per axis, D(s) = E|e(a + s) -
             e(a)|^2 / 3 = 2 jitter^2 + 2 bend^2 (1 - exp(-s / length)) + walk^2 s, by non-negative least squares over
             bins of path s, the bend's length held at 0.1 m. Rotations: the same without bend.
    Args:    runs: at least 3, of more than 0.3 m each.
    Raises:  TooFewRunsError.
    """
    if len(runs) < RUNS_MIN:
        raise TooFewRunsError(f"{len(runs)} runs, at least {RUNS_MIN} needed; render more paths")
    scales, position_bins, turn_bins = [], [], []
    for run in runs:
        true, found = run.Ts_true[:, :3, 3], run.Ts_vo_cam[:, :3, 3]
        scale = float((found * true).sum() / (true**2).sum())
        scales.append(scale - 1.0)
        arc = arc_lengths(true)
        turns = np.array([
            rotvec_from_rotation(a[:3, :3] @ b[:3, :3].T) for a, b in zip(run.Ts_vo_cam, run.Ts_true, strict=True)
        ])  # fmt: skip
        position_bins.append(structure_function(arc, found - scale * true))
        turn_bins.append(structure_function(arc, turns))
    jitter, bend, walk = _fitted(np.nanmean(position_bins, axis=0), with_bend=True)
    turn_jitter, _, turn_walk = _fitted(np.nanmean(turn_bins, axis=0), with_bend=False)
    return OdometryNoise(
        scale_frac=float(np.sqrt(np.mean(np.square(scales)))),
        drift_m_sqrt_m=walk,
        bend_m=bend,
        bend_length_m=BEND_LENGTH_M,
        jitter_m=jitter,
        turn_drift_rad_sqrt_m=turn_walk,
        turn_jitter_rad=turn_jitter,
        rate_hz=float(np.mean([run.rate_hz for run in runs])),
    )


def lag_middles() -> Array:
    """Middle of each bin of path [m]."""
    edges = np.array(_LAGS_M)
    return 0.5 * (edges[:-1] + edges[1:])


def structure_function(arc_m: Array, errors: Array) -> Array:
    """Mean square difference per axis of errors (n, 3) over pairs of samples, by bins of path between them."""
    picks = np.unique(np.linspace(0, len(arc_m) - 1, _PAIRS_MAX).astype(int))
    s, e = arc_m[picks], errors[picks]
    apart = np.abs(s[:, None] - s[None, :])
    square = np.mean((e[:, None] - e[None, :]) ** 2, axis=2)
    upper = np.triu(np.ones_like(apart, dtype=bool), 1)
    bins = [upper & (apart >= low) & (apart < high) for low, high in pairwise(_LAGS_M)]
    return np.array([square[inside].mean() if inside.any() else np.nan for inside in bins])


def _fitted(structure: Array, with_bend: bool) -> tuple[float, float, float]:
    s = lag_middles()
    columns = [np.full_like(s, 2.0), 2.0 * (1.0 - np.exp(-s / BEND_LENGTH_M)) if with_bend else np.zeros_like(s), s]
    known = np.isfinite(structure)
    weights = 1.0 / np.maximum(structure[known], 1e-16)  # relative errors: every scale counts
    squares, _ = nnls(np.stack(columns, axis=1)[known] * weights[:, None], structure[known] * weights)
    jitter, bend, walk = np.sqrt(squares)
    return float(jitter), float(bend), float(walk)
