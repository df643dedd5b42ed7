"""The hybrid mixture's EM against two independent re-derivations: direct maximisation, and a literal EM in loops."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from machine.rotations import geodesic_angle, rotation_from_rotvec
from server.calibration.hybrid_mixture import MixtureSettings, register_poses

OUTLIER_WEIGHT = 0.1
WITHIN_DEG = 0.1


def pose_sets(seed: int, outliers: int = 0):
    """Two noisy pose sets of 24: x = R y + t, 2 mm and 2 deg of noise; some of x anywhere."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0.0, 1.0, 24)
    y = np.column_stack((0.4 * s, 0.12 * np.sin(5 * s), 0.08 * np.cos(3 * s)))
    Rs_y = Rotation.from_rotvec(0.4 * rng.normal(size=y.shape)).as_matrix()
    R, t = rotation_from_rotvec(np.deg2rad([6.0, -8.0, 5.0])), np.array([0.02, -0.01, 0.03])
    x = y @ R.T + t + 0.002 * rng.normal(size=y.shape)
    Rs_x = Rotation.from_rotvec(np.deg2rad(2.0) * rng.normal(size=y.shape)).as_matrix() @ R @ Rs_y
    for i in rng.choice(24, outliers, replace=False):
        x[i] += 0.1 * rng.normal(size=3)
        Rs_x[i] = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
    return x, Rs_x, y, Rs_y


def log_likelihood(R, t, sigma, kappa, x, Rs_x, y, Rs_y, n_axes: int) -> float:
    """Sum over observations of log(w / (V (4 pi)^j) + (1 - w) / M sum_m Gaussian prod vMF), without any trick."""
    volume = np.prod(np.maximum(x.max(axis=0) - x.min(axis=0), 0.02))
    squares = np.sum((x[:, None] - (y @ R.T + t)[None]) ** 2, axis=2)
    density = np.exp(-squares / (2 * sigma**2)) / (2 * np.pi * sigma**2) ** 1.5
    for j in range(n_axes):
        cosines = Rs_x[:, :, j] @ (Rs_y[:, :, j] @ R.T).T
        density = density * kappa / (4 * np.pi * np.sinh(kappa)) * np.exp(kappa * cosines)
    outlier = OUTLIER_WEIGHT / (volume * (4 * np.pi) ** n_axes)
    return float(np.sum(np.log(outlier + (1 - OUTLIER_WEIGHT) * density.mean(axis=1))))


def maximise(x, Rs_x, y, Rs_y, n_axes: int):
    """scipy from the start the EM has: R = I, means on each other; kappa kept below the overflow of sinh."""

    def cost(p):
        sigma, kappa = np.exp(np.clip(p[6], -7.0, 0.0)), np.exp(np.clip(p[7], -2.0, 6.4))
        return -log_likelihood(Rotation.from_rotvec(p[:3]).as_matrix(), p[3:6], sigma, kappa, x, Rs_x, y, Rs_y, n_axes)

    start = np.concatenate((np.zeros(3), x.mean(axis=0) - y.mean(axis=0), [np.log(0.05), np.log(10.0)]))
    found = minimize(cost, start, method="BFGS", options={"maxiter": 300}).x
    found = minimize(cost, found, method="Nelder-Mead", options={"maxiter": 1500, "xatol": 1e-7, "fatol": 1e-9}).x
    return Rotation.from_rotvec(found[:3]).as_matrix(), found[3:6], -cost(found)


def literal_em(x, Rs_x, y, Rs_y, n_axes: int, rounds: int = 60):
    """EM in loops from the model; its maximisation over R by a quaternion eigenproblem, kappa by bisection."""
    R, t = np.eye(3), x.mean(axis=0) - y.mean(axis=0)
    sigma2 = np.mean([np.sum((a - b - t) ** 2) for a in x for b in y]) / 3.0
    kappa, volume = 10.0, np.prod(np.maximum(np.ptp(x, axis=0), 0.02))
    for _ in range(rounds):
        P = np.zeros((len(y), len(x)))
        for n in range(len(x)):
            for m in range(len(y)):
                p = np.exp(-np.sum((x[n] - R @ y[m] - t) ** 2) / (2 * sigma2)) / (2 * np.pi * sigma2) ** 1.5
                for j in range(n_axes):
                    mu = R @ Rs_y[m][:, j]
                    p *= kappa / (2 * np.pi * (1 - np.exp(-2 * kappa))) * np.exp(kappa * (mu @ Rs_x[n][:, j] - 1.0))
                P[m, n] = (1 - OUTLIER_WEIGHT) / len(y) * p
            P[:, n] /= P[:, n].sum() + OUTLIER_WEIGHT / (volume * (4 * np.pi) ** n_axes)
        total = P.sum()
        x_bar = sum(P[:, n].sum() * x[n] for n in range(len(x))) / total
        y_bar = sum(P[m].sum() * y[m] for m in range(len(y))) / total
        pairs = [(P[m, n], m, n) for m in range(len(y)) for n in range(len(x)) if P[m, n] > 1e-12]
        K = np.zeros((4, 4))
        for p, m, n in pairs:
            K += p / sigma2 * _profile(x[n] - x_bar, y[m] - y_bar)
            for j in range(n_axes):
                K += p * kappa * _profile(Rs_x[n][:, j], Rs_y[m][:, j])
        R = Rotation.from_quat(np.linalg.eigh(K)[1][:, 3]).as_matrix()
        t = x_bar - R @ y_bar
        sigma2 = max(sum(p * np.sum((x[n] - R @ y[m] - t) ** 2) for p, m, n in pairs) / (3 * total), 4e-8)
        if n_axes:
            mean = sum(p * (R @ Rs_y[m][:, j]) @ Rs_x[n][:, j] for p, m, n in pairs for j in range(n_axes))
            kappa = _bisect(mean / (n_axes * total))
    return R, t


def _profile(a, b):
    """4x4 whose quadratic form in the quaternion (x, y, z, w) is a . R b (Davenport)."""
    B = np.outer(a, b)
    z = np.array([B[2, 1] - B[1, 2], B[0, 2] - B[2, 0], B[1, 0] - B[0, 1]])
    K = np.zeros((4, 4))
    K[:3, :3] = B + B.T - np.trace(B) * np.eye(3)
    K[:3, 3] = K[3, :3] = z
    K[3, 3] = np.trace(B)
    return K


def _bisect(mean: float) -> float:
    low, high = 1e-6, 1e5
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if 1 / np.tanh(middle) - 1 / middle < mean else (low, middle)
    return 0.5 * (low + high)


@pytest.mark.parametrize("outliers", [0, 3])
@pytest.mark.parametrize("use_axes", [True, False])
def test_em_reaches_the_maximum_of_the_likelihood(outliers, use_axes):
    sets = pose_sets(3, outliers)
    match = register_poses(*sets, MixtureSettings(use_axes=use_axes, outlier_weight=OUTLIER_WEIGHT))
    R, t, best = maximise(*sets, 3 if use_axes else 0)
    assert np.rad2deg(geodesic_angle(match.R_x_y, R)) < WITHIN_DEG
    assert 1e3 * np.linalg.norm(match.t_x_y - t) < 0.5  # mm
    ours = log_likelihood(
        match.R_x_y, match.t_x_y, match.sigma_m, min(match.vmf_concentration, 600.0), *sets, 3 if use_axes else 0
    )
    assert ours > best - 0.5


@pytest.mark.parametrize("use_axes", [True, False])
def test_em_agrees_with_a_literal_em(use_axes):
    sets = pose_sets(8, 2)
    match = register_poses(*sets, MixtureSettings(use_axes=use_axes, outlier_weight=OUTLIER_WEIGHT))
    R, t = literal_em(*sets, 3 if use_axes else 0, rounds=25)
    assert np.rad2deg(geodesic_angle(match.R_x_y, R)) < WITHIN_DEG
    assert 1e3 * np.linalg.norm(match.t_x_y - t) < 0.5  # mm
    assert match.iterations < MixtureSettings().iterations_max  # it stopped by its own rule


def test_large_concentration_does_not_overflow():
    """Exact axes drive kappa to its cap, where exp(kappa) is beyond a double."""
    x, _, y, Rs_y = pose_sets(5)
    R = rotation_from_rotvec(np.deg2rad([6.0, -8.0, 5.0]))
    match = register_poses(x, R @ Rs_y, y, Rs_y, MixtureSettings(kappa_max=1e5))
    assert match.vmf_concentration == 1e5
    assert np.isfinite(match.pairing_probabilities).all()
    assert np.rad2deg(geodesic_angle(match.R_x_y, R)) < 0.05


def test_observations_far_away_are_taken_as_outliers_by_the_volume():
    x, Rs_x, y, Rs_y = pose_sets(6)
    far = np.vstack((x, x.mean(axis=0) + np.array([[0.5, 0.5, 0.5]])))
    match = register_poses(far, np.vstack((Rs_x, Rs_x[:1])), y, Rs_y, MixtureSettings(use_axes=False))
    shares = match.pairing_probabilities.sum(axis=0)
    assert shares[-1] < 0.01
    assert np.median(shares[:-1]) > 0.9
