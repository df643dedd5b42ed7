"""The bench's own yardsticks, written without the estimator: two-view bound, and the globally best fit.

Everything is in raw pixels through `machine.camera.project_stereo`, with numerical Jacobians, many looks at once.
"""

from dataclasses import dataclass

import numpy as np

from machine.camera import project_stereo
from machine.description import StereoCamera
from machine.rotations import Array, rotation_from_rotvec, rotvec_from_rotation

_STEP = 1e-6
_ITERATIONS = 60
_SAME_RAD = np.deg2rad(0.5)


def predict(camera: StereoCamera, Ts: Array, corners: Array) -> Array:
    """Raw corners of both eyes, (n, 4 * n_corners) [px], for poses (n, 4, 4)."""
    points = np.einsum("nij,kj->nki", Ts[:, :3, :3], corners) + Ts[:, None, :3, 3]
    left, right = project_stereo(camera, points.reshape(-1, 3))
    n = len(Ts)
    return np.concatenate([left.reshape(n, -1), right.reshape(n, -1)], axis=1)


def moved(Ts: Array, steps: Array) -> Array:
    """Poses (n, 4, 4) after left perturbations (n, 6): rotation vector [rad], translation [m]."""
    result = Ts.copy()
    result[:, :3, :3] = np.array([rotation_from_rotvec(w) for w in steps[:, :3]]) @ Ts[:, :3, :3]
    result[:, :3, 3] += steps[:, 3:]
    return result


def jacobians(camera: StereoCamera, Ts: Array, corners: Array) -> Array:
    """d(raw corners)/d(left perturbation), (n, 4 * n_corners, 6), by central differences."""
    columns = []
    for k in range(6):
        step = np.zeros(6)
        step[k] = _STEP
        turn = rotation_from_rotvec(step[:3])
        plus, minus = Ts.copy(), Ts.copy()
        plus[:, :3, :3], minus[:, :3, :3] = turn @ Ts[:, :3, :3], turn.T @ Ts[:, :3, :3]
        plus[:, :3, 3] += step[3:]
        minus[:, :3, 3] -= step[3:]
        columns.append((predict(camera, plus, corners) - predict(camera, minus, corners)) / (2.0 * _STEP))
    return np.stack(columns, axis=2)


def bounds(camera: StereoCamera, Ts: Array, corners: Array, sigma_px: float) -> Array:
    """Cramer-Rao bound (n, 6, 6) for independent noise on every corner coordinate: sigma^2 (J^T J)^-1."""
    J = jacobians(camera, Ts, corners)
    return sigma_px**2 * np.linalg.inv(np.einsum("nji,njk->nik", J, J))


def correlated_bounds(camera: StereoCamera, Ts: Array, corners: Array, covariances: Array) -> Array:
    """Bound (n, 6, 6) for corner noise of covariance (n, m, m): (J^T C^-1 J)^-1."""
    J = jacobians(camera, Ts, corners)
    return np.linalg.inv(np.einsum("nji,njk->nik", J, np.linalg.solve(covariances, J)))


def mirrored(Ts: Array, eye_middle: Array) -> Array:
    """The normal mirrored at the line of sight from the middle of the eyes, position kept."""
    result = Ts.copy()
    for T in result:
        sight = T[:3, 3] - eye_middle
        sight /= np.linalg.norm(sight)
        flip = 2.0 * np.outer(sight, sight) - np.eye(3)  # half a turn about the line of sight ...
        spin = np.diag([-1.0, -1.0, 1.0])  # ... and half a turn of the print in its plane: together the normal mirrors
        T[:3, :3] = flip @ T[:3, :3] @ spin
    return result


@dataclass(frozen=True, slots=True)
class Fit:
    """Local minima: poses (n, 4, 4), chi2 (n,)."""

    Ts: Array
    chi2: Array


def fit(camera: StereoCamera, corners: Array, seen: Array, starts: Array, sigma_px: float) -> Fit:
    """Levenberg-Marquardt on many looks at once; seen (n, 4 * n_corners) [px]."""
    Ts = starts.copy()
    residual = predict(camera, Ts, corners) - seen
    cost = np.nan_to_num(np.sum(residual**2, axis=1), nan=np.inf)
    damping = np.full(len(Ts), 1e-3)
    for _ in range(_ITERATIONS):
        J = jacobians(camera, Ts, corners)
        A = np.einsum("nji,njk->nik", J, J)
        g = np.einsum("nji,nj->ni", J, residual)
        A = A + np.einsum("n,nii,ij->nij", damping, A, np.eye(6))
        steps = -np.linalg.solve(A, g[..., None])[..., 0]
        trial = moved(Ts, steps)
        trial_residual = predict(camera, trial, corners) - seen
        trial_cost = np.nan_to_num(np.sum(trial_residual**2, axis=1), nan=np.inf)
        better = trial_cost <= cost
        gain = np.max(np.where(better, (cost - trial_cost) / np.maximum(cost, 1e-20), 0.0))
        Ts[better], residual[better], cost[better] = trial[better], trial_residual[better], trial_cost[better]
        damping = np.clip(np.where(better, damping * 0.2, damping * 8.0), 1e-10, 1e8)
        if gain < 1e-10 and better.any():
            break
    return Fit(Ts, cost / sigma_px**2)


@dataclass(frozen=True, slots=True)
class GlobalFit:
    """The best fit of each look, and its rival: (n, 4, 4), chi2 (n,), chi2 of the rival minus it (inf: none)."""

    Ts: Array
    chi2: Array
    margin: Array


def global_fit(camera: StereoCamera, corners: Array, seen: Array, truths: Array, sigma_px: float) -> GlobalFit:
    """Both minima by starts from the truth, the mirrored truth and the mirror of what these find."""
    middle = np.array([0.5 * camera.baseline_m, 0.0, 0.0])
    fits = [fit(camera, corners, seen, start, sigma_px) for start in (truths, mirrored(truths, middle))]
    fits += [fit(camera, corners, seen, mirrored(one.Ts, middle), sigma_px) for one in fits[:2]]
    chi2 = np.stack([one.chi2 for one in fits])
    Ts = np.stack([one.Ts for one in fits])
    n = np.arange(len(truths))
    best = np.argmin(chi2, axis=0)
    margin = np.full(len(truths), np.inf)
    for k in range(len(fits)):
        apart = np.array(
            [
                np.linalg.norm(rotvec_from_rotation(a[:3, :3] @ b[:3, :3].T)) > _SAME_RAD
                for a, b in zip(Ts[k], Ts[best, n], strict=True)
            ]
        )
        margin = np.where(apart, np.minimum(margin, chi2[k] - chi2[best, n]), margin)
    return GlobalFit(Ts[best, n], chi2[best, n], margin)
