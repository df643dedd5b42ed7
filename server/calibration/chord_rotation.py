"""Rotation, scale and clock offset together, from all chords jointly; the noise levels come from the data itself."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machine.rotations import rotation_from_rotvec
from server.calibration.chord_step import ChordStep, PairedTracks, chord_step
from server.calibration.contracts import Array
from server.calibration.rotation_fit import robust_sigma

#: Base track at the camera's times plus an offset [s]: positions (n, 3) [m] and velocities (n, 3) [m/s].
BaseTrack = Callable[[float], tuple[Array, Array]]

_JUMP_SIGMAS = 6.0
_SCALE_STEP_MAX = 0.2
_STEP_SMALL_SIGMAS = 0.01
_STEP_SMALL = 1e-5  # rad, log scale and s: less shows nowhere, though tracks without noise know better
TO_AND_FRO = 0.5  # share of a step that the next one takes back
_FREE_ROUNDS = 8  # in which samples may come and go


@dataclass(frozen=True, slots=True)
class ChordRotation:
    """v_base ~ scale R_base_vo v_vo at camera time + offset; `covariance` (5, 5) of rotation vector [rad, left, base
    axes], log scale and offset [s]; `kept` (n,): samples that are no outliers; noise: `drift` [m^2/m], `jitter` [m^2].
    """

    R_base_vo: Array
    scale: float
    offset_s: float
    covariance: Array
    kept: NDArray[np.bool_]
    drift: float
    jitter: float
    converged: bool


@dataclass(frozen=True, slots=True)
class _Guess:
    R: Array
    scale: float
    offset_s: float

    def after(self, change: Array, bound_s: float) -> "_Guess":
        return _Guess(
            rotation_from_rotvec(change[:3]) @ self.R,
            self.scale * float(np.exp(np.clip(change[3], -_SCALE_STEP_MAX, _SCALE_STEP_MAX))),
            float(np.clip(self.offset_s + change[4], -bound_s, bound_s)),
        )


def fit_chord_rotation(
    points_vo: Array,
    base_track: BaseTrack,
    arc_steps_m: Array,
    R_start: Array,
    offset_start_s: float,
    offset_bound_s: float,
    iterations_max: int = 24,
) -> ChordRotation:
    """Rotation, scale and clock offset that fit both tracks best under drift and jitter of unknown size.

    Model:   y(t + tau) = s R x + c + d + n, d a random walk over the arc length, n white: least squares with the
             information P of `chord_weighting`; Gauss-Newton over (rotation, log s, tau); the noise by restricted
             likelihood, averaged over its posterior (`chord_step`); a sample is left out while it is likelier an
             outlier (uniform over the path's volume) than not, judged by what all others say of it.
    Args:    points_vo (n, 3): odometry [m]; base_track: the same points by kinematics; arc_steps_m (n-1,) [m]; R_start,
             offset_start_s: coarse start; offset_bound_s: largest offset, also its sd beforehand [s].
    Returns: the fit; not `converged` when the step still moves after `iterations_max`.
    Source:  Aitken 1936; Umeyama 1991 is the case without drift, offset and outliers.
    """
    guess = _Guess(R_start, 1.0, offset_start_s)
    points, velocities = base_track(guess.offset_s)
    kept = _not_jumping(points - points_vo @ R_start.T)
    tries, last = 0, np.zeros(5)
    while True:
        tries += 1
        tracks = PairedTracks(points, velocities, guess.scale * points_vo @ guess.R.T, arc_steps_m, kept)
        step = chord_step(tracks, guess.offset_s, offset_bound_s)
        sigmas = np.sqrt(np.diag(step.covariance))
        change, last = _calmed(step.change, last, sigmas)
        guess = guess.after(change, offset_bound_s)
        points, velocities = base_track(guess.offset_s)
        before, kept = kept, _likely(points, guess.scale * points_vo @ guess.R.T, step, kept)
        if tries > _FREE_ROUNDS and (before & kept).sum() >= 0.5 * len(kept):
            kept = before & kept  # who is still coming and going stays out: the choice cannot go round in circles
        small = np.abs(step.change) < _STEP_SMALL_SIGMAS * sigmas + _STEP_SMALL
        settled = bool(small.all()) and np.array_equal(before, kept)
        if settled or tries >= iterations_max:
            return ChordRotation(
                R_base_vo=guess.R,
                scale=guess.scale,
                offset_s=guess.offset_s,
                covariance=step.covariance,
                kept=kept,
                drift=step.drift,
                jitter=step.jitter,
                converged=settled,
            )


def _calmed(change: Array, last: Array, sigmas: Array) -> tuple[Array, Array]:
    """The step, halved where it takes back most of the one before; and itself in sigmas, for the next one.

    Velocities at a swinging boom change with the offset, so full steps in the offset can go to and fro for long.
    """
    wide = change / sigmas
    to_and_fro = float(wide @ last) < -TO_AND_FRO * float(last @ last)
    return (0.5 * change, 0.5 * wide) if to_and_fro else (change, wide)


def _not_jumping(residuals: Array) -> NDArray[np.bool_]:
    """Samples that do not stand out from the median of the five about them."""
    padded = np.concatenate((residuals[1:3][::-1], residuals, residuals[-3:-1][::-1]))
    windows = np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0)
    jumps = residuals - np.median(windows, axis=-1)
    calm = np.linalg.norm(jumps, axis=1) < _JUMP_SIGMAS * max(robust_sigma(jumps), 1e-6)
    return calm if calm.sum() >= 0.5 * len(calm) else np.ones(len(residuals), dtype=bool)


def _likely(points: Array, rotated: Array, step: ChordStep, kept: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Samples that are likelier part of the track than spread over the path's volume; the old ones if few are."""
    differences, variances = step.weighting.left_out(points - rotated)
    total = variances + step.jitter
    outlier_frac = float(np.clip(1.0 - kept.mean(), 0.01, 0.5))
    volume = float(np.ptp(points, axis=0).max()) ** 3
    exponents = np.sum(differences**2, axis=1) / (2.0 * total)
    likely = np.log1p(-outlier_frac) - 1.5 * np.log(2.0 * np.pi * total) - exponents > np.log(outlier_frac / volume)
    return likely if likely.sum() >= 0.5 * len(likely) else kept
