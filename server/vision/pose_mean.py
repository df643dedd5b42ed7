"""Robust mean of poses on SE(3)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machine.poses import pose
from machine.rotations import nearest_rotation, rotation_from_rotvec, rotvec_from_rotation
from server.vision.contracts import Array

ITERATIONS_MAX = 20
MAD_TO_SIGMA = 1.4826
OUTLIER_SIGMA = 3.5


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

    Model:   deviations from the median pose; a pose is out where position or rotation lies beyond 3.5 robust sigma
             (median absolute deviation) and beyond 3.5 of its own; then Karcher mean of the rest. Covariance: larger
             of scatter / n and mean predicted covariance / n, axis by axis of the scatter whitened by the prediction.
    Args:    Ts: poses (n, 4, 4), n >= 1. covariances: their predicted covariances (n, 6, 6).
    Returns: PoseMean.
    Source:  Karcher 1977 for the mean of the rotations.
    """
    start = pose(_medoid_rotation(Ts), np.median(Ts[:, :3, 3], axis=0))
    from_start = deviations(Ts, start)
    kept = np.ones(len(Ts), dtype=bool)
    for block in (slice(0, 3), slice(3, 6)):
        size = np.linalg.norm(from_start[:, block], axis=1)
        spread = MAD_TO_SIGMA * float(np.median(size))
        own = np.sqrt(np.trace(covariances[:, block, block], axis1=1, axis2=2))
        kept &= size <= OUTLIER_SIGMA * np.maximum(spread, own)
    if not kept.any():
        kept[:] = True
    T_mean = _mean(Ts[kept], start[:3, :3])
    return PoseMean(T_mean, _covariance(deviations(Ts[kept], T_mean), covariances[kept]), kept)


def _covariance(residuals: Array, covariances: Array) -> Array:
    n = len(residuals)
    predicted = covariances.mean(axis=0)
    if n < 6:
        return predicted / n
    scatter = residuals.T @ residuals / (n - 1)
    root = np.linalg.cholesky(predicted + 1e-18 * np.eye(6))
    white = np.linalg.solve(root, np.linalg.solve(root, scatter).T)
    values, vectors = np.linalg.eigh(0.5 * (white + white.T))
    grown = root @ vectors @ np.diag(np.maximum(values, 1.0)) @ vectors.T @ root.T
    return grown / n
