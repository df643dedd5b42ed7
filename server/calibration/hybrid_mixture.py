"""Hybrid mixture registration of pose sets: positions Gaussian, axes von Mises-Fisher, unknown pairing, by EM."""

from dataclasses import dataclass

import numpy as np

from server.calibration.contracts import Array


@dataclass(frozen=True, slots=True)
class MixtureSettings:
    """How the mixture is fitted."""

    outlier_weight: float = 0.1
    kappa_start: float = 10.0
    kappa_max: float = 1e5
    sigma_floor_m: float = 2e-4
    iterations_max: int = 150
    use_axes: bool = True  # off: positions only, as in plain probabilistic point matching


@dataclass(frozen=True, slots=True)
class MixtureMatch:
    """R_x_y, t_x_y with x ~ R y + t; one-axis position sd [m], concentration, iterations, and the pairing (m, n)."""

    R_x_y: Array
    t_x_y: Array
    sigma_m: float
    vmf_concentration: float
    iterations: int
    pairing_probabilities: Array


def _log_vmf_normaliser(kappa: float) -> float:
    """log of kappa / (2 pi (e^kappa - e^-kappa)), less kappa's growth taken out: holds for large kappa."""
    return float(np.log(kappa) - np.log(2.0 * np.pi) - kappa - np.log1p(-np.exp(-2.0 * kappa)))


def concentration_of(mean_cosine: float, kappa_max: float) -> float:
    """kappa with coth(kappa) - 1/kappa = mean cosine.

    Model: start r (3 - r^2) / (1 - r^2), Newton with derivative 1 - A^2 - 2 A / kappa.
    """
    r = float(np.clip(mean_cosine, 1e-6, 1.0 - 1e-12))
    kappa = r * (3.0 - r * r) / (1.0 - r * r)
    for _ in range(8):
        if kappa > 500.0:
            return min(1.0 / (1.0 - r), kappa_max)
        a = 1.0 / np.tanh(kappa) - 1.0 / kappa
        kappa = max(kappa - (a - r) / (1.0 - a * a - 2.0 * a / kappa), 1e-6)
    return min(kappa, kappa_max)


def _match_probabilities(
    square: Array, cosines: Array, sigma2: float, kappa: float, log_outlier: float, n_axes: int
) -> Array:
    """E step: P (m, n), the probability that model pose m made observation n; columns sum to at most 1."""
    m = square.shape[0]
    log_p = -square / (2.0 * sigma2) - 1.5 * np.log(2.0 * np.pi * sigma2) - np.log(m)
    if n_axes:
        log_p = log_p + n_axes * _log_vmf_normaliser(kappa) + kappa * cosines
    top = np.maximum(log_p.max(axis=0), log_outlier)
    weights = np.exp(log_p - top)
    return weights / (weights.sum(axis=0) + np.exp(log_outlier - top))


def register_poses(
    points_x: Array, Rs_x: Array, points_y: Array, Rs_y: Array, settings: MixtureSettings, R_start: Array | None = None
) -> MixtureMatch:
    """Rigid motion that lays pose set y onto pose set x without known pairs.

    Model:   p(x_n, X_n) = w / (V (4 pi)^3) + (1 - w) / M sum_m N(x_n; R y_m + t, s2 I) prod_j vMF(X_nj; R Y_mj, kappa),
             j the three axes; M step closed form: H = (1/s2) sum P (y - ybar)(x - xbar)^T + kappa sum P Y X^T, R = V
             diag(1, 1, det) U^T.
    Args:    points_x (n, 3), points_y (m, 3) [m]; Rs_x (n, 3, 3), Rs_y (m, 3, 3): axes as columns; R_start: coarse
             alignment.
    Returns: the match; sigma and kappa as the data ask, floored and capped by the settings.
    Source:  Min, Wang, Meng 2018 (model as stated there; formulae derived); used by Makinen et al. 2023, section 3.2.2.
    """
    n_axes = 3 if settings.use_axes else 0
    R = np.eye(3) if R_start is None else np.asarray(R_start, dtype=float)
    t = points_x.mean(axis=0) - R @ points_y.mean(axis=0)
    volume = float(np.prod(np.maximum(np.ptp(points_x, axis=0), 0.02)))
    w = settings.outlier_weight
    log_outlier = float(np.log(w / (1.0 - w)) - np.log(volume) - n_axes * np.log(4.0 * np.pi))
    sigma2 = float(np.mean(np.sum((points_x[None] - (points_y @ R.T + t)[:, None]) ** 2, axis=2))) / 3.0
    kappa, P, iteration = settings.kappa_start, np.zeros((len(points_y), len(points_x))), 0
    # H's axes part and the sum of cosines both are linear in sum_P Y X^T, so the axes are stacked as (pose, 9)
    flat_x = Rs_x.reshape(len(Rs_x), 9)
    while iteration < settings.iterations_max:
        iteration += 1
        square = np.sum((points_x[None] - (points_y @ R.T + t)[:, None]) ** 2, axis=2)
        cosines = (R @ Rs_y).reshape(len(Rs_y), 9) @ flat_x.T
        P = _match_probabilities(square, cosines, sigma2, kappa, log_outlier, n_axes)
        total = float(P.sum())
        if total < 1e-9:
            break
        R, t = _fit_rigid_motion(points_x, Rs_x, points_y, Rs_y, P, sigma2, kappa if n_axes else 0.0)
        square = np.sum((points_x[None] - (points_y @ R.T + t)[:, None]) ** 2, axis=2)
        before, sigma2 = sigma2, max(float(np.sum(P * square)) / (3.0 * total), settings.sigma_floor_m**2)
        if n_axes:
            mean_cosine = float(np.sum(P * ((R @ Rs_y).reshape(len(Rs_y), 9) @ flat_x.T))) / (n_axes * total)
            kappa = concentration_of(mean_cosine, settings.kappa_max)
        if abs(before - sigma2) < 1e-9 * before:
            break
    return MixtureMatch(R, t, float(np.sqrt(sigma2)), kappa, iteration, P)


def _fit_rigid_motion(
    points_x: Array, Rs_x: Array, points_y: Array, Rs_y: Array, P: Array, sigma2: float, kappa: float
) -> tuple[Array, Array]:
    """M step for R and t."""
    total = P.sum()
    x_bar = P.sum(axis=0) @ points_x / total
    y_bar = P.sum(axis=1) @ points_y / total
    H = (points_y - y_bar).T @ P @ (points_x - x_bar) / sigma2
    if kappa > 0.0:
        weighted_x = np.einsum("mn,nij->mij", P, Rs_x)
        H = H + kappa * np.einsum("mij,mkj->ik", Rs_y, weighted_x)
    U, _, Vt = np.linalg.svd(H)
    R = Vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))]) @ U.T
    return R, x_bar - R @ y_bar
