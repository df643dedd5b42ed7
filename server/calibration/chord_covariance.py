"""How sure the rotation from chords is: drift and jitter of the odometry carried through the overlapping chords."""

import numpy as np

from machine.rotations import skew
from server.calibration.chords import ChordPairs
from server.calibration.contracts import Array


def rotation_information(vectors: Array, weights: Array) -> Array:
    """Information of paired vectors about a small rotation, per unit variance.

    Model:   A = sum w (|v|^2 I - v v^T): weak about the direction most vectors share.
    Args:    vectors (k, 3) [m]; weights (k,).
    Returns: (3, 3) [m^2].
    """
    squares = float(np.sum(weights * np.sum(vectors**2, axis=1)))
    return squares * np.eye(3) - (vectors * weights[:, None]).T @ vectors


def observability(information: Array) -> float:
    """Smallest eigenvalue over the largest, 0..1: 0 for a straight line, 1 for equal knowledge about all axes."""
    values = np.linalg.eigvalsh(information)
    return float(max(values[0], 0.0) / values[2]) if values[2] > 0.0 else 0.0


def fit_noise(steps_m: Array, step_residuals: Array, chord_m: float, chord_sigma_m: float) -> tuple[float, float]:
    """Drift and jitter of the odometry that explain the residuals of single steps and of whole chords.

    Model:   one-axis variance over an arc length L: var = drift L + 2 jitter.
    Args:    steps_m: mean length of a step [m]; step_residuals (n, 3) [m]; chord_m: mean arc length of a chord [m];
             chord_sigma_m: one axis [m].
    Returns: drift [m^2/m] and jitter [m^2], neither negative.
    """
    step = float(np.mean(steps_m))
    step_variance = float(np.median(np.linalg.norm(step_residuals, axis=1)) / 1.5382) ** 2
    drift = max(chord_sigma_m**2 - step_variance, 0.0) / max(chord_m - step, 1e-6)
    jitter = max(0.5 * (step_variance - drift * step), 0.0)
    if (
        drift * chord_m + 2.0 * jitter < chord_sigma_m**2
    ):  # steps noisier or quieter than the model can hold: trust the chords
        drift = max(chord_sigma_m**2 - 2.0 * jitter, 0.0) / chord_m
    return drift, jitter


def rotation_covariance(
    rotated: Array, weights: Array, pairs: ChordPairs, arc_steps_m: Array, drift: float, jitter: float
) -> Array:
    """Covariance of the weighted chord rotation, with the correlation of overlapping chords.

    Model:   cov = A^-1 (jitter sum S_i S_i^T + drift sum ds_i U_i U_i^T) A^-1; S_i: how much the position of sample i
             enters the normal equations, U_i = sum over samples from i on of S: how much a step before i enters them.
    Args:    rotated (k, 3): chords in the base [m]; weights (k,); pairs: their samples; arc_steps_m (n-1,): path length
             of each step [m]; drift [m^2/m]; jitter [m^2].
    Returns: (3, 3) [rad^2], left perturbation, base axes.
    """
    n = len(arc_steps_m) + 1
    S = np.zeros((n, 3, 3))
    cross = np.array([w * skew(v) for w, v in zip(weights, rotated, strict=True)])
    np.add.at(S, pairs.last, cross)
    np.add.at(S, pairs.first, -cross)
    U = np.cumsum(S[::-1], axis=0)[::-1][1:]
    middle = jitter * np.einsum("nij,nkj->ik", S, S) + drift * np.einsum("n,nij,nkj->ik", arc_steps_m, U, U)
    inverse = np.linalg.inv(rotation_information(rotated, weights))
    return inverse @ middle @ inverse
