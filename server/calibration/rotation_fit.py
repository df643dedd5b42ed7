"""The rotation between two sets of paired vectors: weighted Kabsch, and its robust form by reweighting."""

from dataclasses import dataclass

import numpy as np

from server.calibration.contracts import Array

_MAD_TO_SIGMA_3D = 1.0 / 1.5382  # median of a chi distribution with 3 degrees of freedom


@dataclass(frozen=True, slots=True)
class RotationFit:
    """R_a_b and scale with v_a ~ scale R_a_b v_b; weights (k,), residuals (k, 3) [m], robust one-axis sigma [m]."""

    R_a_b: Array
    scale: float
    weights: Array
    residuals: Array
    sigma_m: float


def kabsch(vectors_a: Array, vectors_b: Array, weights: Array) -> Array:
    """Rotation that maps b's vectors onto a's with the least weighted squares; never a reflection.

    Model:   min sum w |v_a - R v_b|^2; H = sum w v_a v_b^T = U S V^T, R = U diag(1, 1, det(U V^T)) V^T.
    Args:    vectors_a, vectors_b: (k, 3) [m]; weights: (k,), >= 0.
    Returns: R_a_b, (3, 3).
    Source:  Kabsch 1976; Umeyama 1991.
    """
    H = (vectors_a * weights[:, None]).T @ vectors_b
    U, _, Vt = np.linalg.svd(H)
    return U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt


def fit_scale(vectors_a: Array, rotated_b: Array, weights: Array) -> float:
    """Length ratio a over b along matched directions: the odometry's scale, a nuisance that does not turn the fit."""
    square = float(np.sum(weights * np.sum(rotated_b**2, axis=1)))
    return float(np.sum(weights * np.sum(vectors_a * rotated_b, axis=1))) / square if square > 0.0 else 1.0


def robust_sigma(residuals: Array) -> float:
    """One-axis standard deviation of 3-D residuals (k, 3) from the median of their norms."""
    return float(np.median(np.linalg.norm(residuals, axis=1))) * _MAD_TO_SIGMA_3D


def fit_rotation(vectors_a: Array, vectors_b: Array, iterations: int = 12, sigma_floor_m: float = 1e-5) -> RotationFit:
    """Robust rotation between paired vectors by iteratively reweighted Kabsch.

    Model:   w = 1 / (1 + (|r| / 2 sigma)^2)^2 after a least-squares start, r = v_a - scale R v_b, sigma from the median
             of |r|.
    Args:    vectors_a, vectors_b: (k, 3) [m], k >= 3; iterations: reweightings; sigma_floor_m: smallest sigma [m].
    Returns: the fit; residuals with the scale taken out.
    """
    weights = np.ones(len(vectors_a))
    R, scale, residuals, sigma = np.eye(3), 1.0, vectors_a, sigma_floor_m
    for _ in range(iterations):
        R = kabsch(vectors_a, vectors_b, weights)
        rotated = vectors_b @ R.T
        scale = fit_scale(vectors_a, rotated, weights)
        residuals = vectors_a - scale * rotated
        sigma = max(robust_sigma(residuals), sigma_floor_m)
        weights = 1.0 / (1.0 + np.sum(residuals**2, axis=1) / (2.0 * sigma) ** 2) ** 2
    return RotationFit(R_a_b=R, scale=scale, weights=weights, residuals=residuals, sigma_m=sigma)
