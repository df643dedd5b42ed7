"""Robust mean of poses on SE(3)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machine.poses import pose
from machine.rotations import nearest_rotation, rotation_from_rotvec, rotvec_from_rotation
from server.vision.contracts import Array

ITERATIONS_MAX = 20
MAD_TO_SIGMA = 1.4826
OUTLIER_CHI2 = 16.3  # 3 degrees of freedom, 99.9 %
CHI2_3_MEDIAN = 2.366
SCATTER_MIN = 8  # fewer poses do not show their own scatter
TRACY_WIDOM_99 = 2.02
CORRELATED_ALL = 2.33 / np.sqrt(6.0)  # standard errors of a correlation that six axes share: 1 %
CORRELATED_ONE = 1.645  # of one axis alone: 5 %, for a drift that is passed over costs more than a few poses


@dataclass(frozen=True, slots=True)
class PoseMean:
    """Mean pose, covariance of the mean (6, 6) (rotation [rad] left perturbation, position [m]), who was kept (n,)."""

    T_mean: Array
    covariance: Array
    kept: NDArray[np.bool_]


def deviations(Ts: Array, T_mean: Array) -> Array:
    """Deviations (n, 6) of poses (n, 4, 4) from a mean: rotvec of R R_mean^T [rad], then position difference [m]."""
    rotations = np.array([rotvec_from_rotation(T[:3, :3] @ T_mean[:3, :3].T) for T in Ts])
    return np.concatenate([rotations, Ts[:, :3, 3] - T_mean[:3, 3]], axis=1)


def _mean(Ts: Array, start: Array) -> Array:
    """Karcher mean of the rotations, arithmetic mean of the positions."""
    rotation = start
    for _ in range(ITERATIONS_MAX):
        step = np.mean([rotvec_from_rotation(T[:3, :3] @ rotation.T) for T in Ts], axis=0)
        rotation = rotation_from_rotvec(step) @ rotation
        if np.linalg.norm(step) < 1e-12:
            break
    return pose(nearest_rotation(rotation), Ts[:, :3, 3].mean(axis=0))


def _medoid_rotation(Ts: Array) -> Array:
    """The rotation with the smallest sum of angles to the others: a start that outliers cannot pull away."""
    rotations = Ts[:, :3, :3]
    cosines = (np.einsum("aij,bij->ab", rotations, rotations) - 1.0) / 2.0
    return rotations[int(np.argmin(np.arccos(np.clip(cosines, -1.0, 1.0)).sum(axis=1)))]


def pose_mean(Ts: Array, covariances: Array) -> PoseMean:
    """Mean pose with outliers cut, and its covariance.

    Model:   deviations from the median pose, whitened by each pose's own covariance; a pose is out where position or
             rotation lies beyond chi2_3 = 16.3 (99.9 %), scaled up where the median says that all scatter more; then
             Karcher mean of the rest, unweighted: a covariance depends on its own pose's error, so weights would pull.
             Covariance: mean of the predicted ones, grown where the scatter refutes them at 1 % (as a whole, or along
             axes), over the effective number of poses, n (1 - r) / (1 + r) where neighbours in time correlate by r, in
             all axes or in one.
    Args:    Ts: poses (n, 4, 4) in order of time, n >= 1. covariances: their predicted covariances (n, 6, 6).
    Returns: PoseMean.
    Source:  Karcher 1977 (mean of rotations); Johnstone 2001 (largest eigenvalue of a white scatter matrix);
             Bartlett 1946 (effective number).
    """
    start = pose(_medoid_rotation(Ts), np.median(Ts[:, :3, 3], axis=0))
    from_start = deviations(Ts, start)
    kept = np.ones(len(Ts), dtype=bool)
    for block in (slice(0, 3), slice(3, 6)):
        part = from_start[:, block]
        chi2 = np.sum(part * np.linalg.solve(covariances[:, block, block], part[..., None])[..., 0], axis=1)
        kept &= chi2 <= OUTLIER_CHI2 * max(float(np.median(chi2)) / CHI2_3_MEDIAN, 1.0)
    if not kept.any():
        kept[:] = True
    T_mean = _mean(Ts[kept], start[:3, :3])
    return PoseMean(T_mean, _covariance(deviations(Ts[kept], T_mean), covariances[kept]), kept)


def _covariance(residuals: Array, covariances: Array) -> Array:
    n = len(residuals)
    predicted = covariances.mean(axis=0)
    if n < SCATTER_MIN:
        return predicted / n
    root = np.linalg.cholesky(predicted + 1e-18 * np.eye(6))
    white = np.linalg.solve(root, residuals.T).T
    values, vectors = np.linalg.eigh(white.T @ white / (n - 1))
    dof = 6 * (n - 1)
    overall = fitted_scale(float(values.sum()) / 6.0, dof)
    grown = np.where(values > overall * white_eigenvalue_max(n - 1), values, overall)
    axes = root / np.sqrt(_effective_numbers(white)) @ vectors
    return (axes * grown) @ axes.T


def fitted_scale(chi2_per_dof: float, dof: int) -> float:
    """By how much the scatter exceeds the prediction; 1 unless it refutes it at the 1 % level."""
    limit = (1.0 - 2.0 / (9.0 * dof) + 2.326 * np.sqrt(2.0 / (9.0 * dof))) ** 3  # Wilson and Hilferty 1931, 99 %
    return chi2_per_dof if chi2_per_dof > limit else 1.0


def white_eigenvalue_max(dof: int, size: int = 6) -> float:
    """What the largest eigenvalue of a white scatter matrix stays below in 99 % of cases (Johnstone 2001)."""
    a, b = np.sqrt(dof - 0.5), np.sqrt(size - 0.5)
    return float(((a + b) ** 2 + TRACY_WIDOM_99 * (a + b) * (1.0 / a + 1.0 / b) ** (1.0 / 3.0)) / dof)


def _effective_numbers(white: Array) -> Array:
    """How many independent poses these (n, 6) are worth along each whitened axis (6,).

    All six together show a weak correlation that they share; one axis alone shows its own drift, which six would hide.
    """
    n = len(white)
    products, squares = np.sum(white[1:] * white[:-1], axis=0), np.sum(white**2, axis=0)
    shared = _worth(float(products.sum() / max(squares.sum(), 1e-30)), n, CORRELATED_ALL)
    own = [_worth(float(p / max(q, 1e-30)), n, CORRELATED_ONE) for p, q in zip(products, squares, strict=True)]
    return np.minimum(shared, own)


def _worth(r: float, n: int, limit: float) -> float:
    """n independent values, or fewer where neighbours in time correlate by r, if that is beyond limit / sqrt(n)."""
    if r + 1.0 / n < limit / np.sqrt(n):
        return float(n)
    r = min((r + 1.0 / n) * n / max(n - 3.0, 1.0), 1.0)  # a short series shows less of its correlation: Kendall 1954
    return max(n * (1.0 - r) / (1.0 + r), 1.0)
