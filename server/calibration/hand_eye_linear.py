"""Closed-form starts for A X = X B and A X = Y B: Park-Martin rotation, linear translation, best of many triples."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from machine.poses import pose
from machine.rotations import nearest_rotation
from server.calibration.contracts import Array

Indices = NDArray[np.int64]
_POSES_MAX = 100  # the start is judged on, evenly picked


def inverse_poses(Ts: Array) -> Array:
    """Inverses of poses (n, 4, 4)."""
    out = np.tile(np.eye(4), (len(Ts), 1, 1))
    turned = Ts[:, :3, :3].transpose(0, 2, 1)
    out[:, :3, :3] = turned
    out[:, :3, 3] = -np.einsum("nij,nj->ni", turned, Ts[:, :3, 3])
    return out


def rotation_vectors(Rs: Array) -> Array:
    """Rotation vectors (n, 3) [rad] of rotations (n, 3, 3)."""
    return Rotation.from_matrix(Rs).as_rotvec()


def park_martin(As: Array, Bs: Array) -> Array:
    """X of A X = X B from motions, without weights.

    Model:   alpha = log R_A = R_X log R_B = R_X beta: R_X = (M^T M)^-1/2 M^T, M = sum beta alpha^T, here by SVD, which
             also holds for two motions; (R_A - I) t_X = R_X t_B - t_A by least squares.
    Args:    As, Bs: (n, 4, 4), n >= 2 with axes that are not parallel.
    Source:  Park, Martin 1994, eq. 24-26.
    """
    alpha, beta = rotation_vectors(As[:, :3, :3]), rotation_vectors(Bs[:, :3, :3])
    U, _, Vt = np.linalg.svd(alpha.T @ beta)
    R_X = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    left = (As[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (Bs[:, :3, 3] @ R_X.T - As[:, :3, 3]).reshape(-1)
    return pose(R_X, np.asarray(np.linalg.lstsq(left, right, rcond=None)[0], dtype=float))


def motions_between(Ts: Array, first: Indices, second: Indices) -> Array:
    """Relative motions T_first^-1 T_second, (k, 4, 4)."""
    return inverse_poses(Ts[first]) @ Ts[second]


def start_ax_yb(
    As: Array, Bs: Array, unknown_scale: bool, rng: np.random.Generator, triples: int
) -> tuple[Array, Array]:
    """X and Y of A X = Y B: of all poses, and of random triples, the one with the least median residual.

    Model:   three poses give three motions and by them X; Y = A X B^-1 averaged; half of the poses may be wrong.
    Args:    As, Bs: (n, 4, 4); unknown_scale: then B's lengths are first scaled by what the triple or set itself says.
    """
    n = len(As)
    distance = float(np.median(np.linalg.norm(Bs[:, :3, 3], axis=1)))
    picks = np.arange(n) if n <= _POSES_MAX else np.unique(np.linspace(0, n - 1, _POSES_MAX).astype(int))
    As, Bs = As[picks], Bs[picks]
    shift = max(len(As) // 3, 1)
    best, best_cost = None, np.inf
    for trial in range(triples + 1):
        chosen = np.arange(len(As)) if trial == 0 else rng.choice(len(As), size=3, replace=False)
        other = np.roll(chosen, -shift if trial == 0 else -1)
        A_motions, B_motions = motions_between(As, chosen, other), motions_between(Bs, chosen, other)
        X = park_martin(A_motions, B_motions)
        X, lengthen = _scaled(A_motions, B_motions, X) if unknown_scale else (X, 1.0)
        scaled = _lengthened(Bs, lengthen)
        Y = _mean_pose((As @ X @ inverse_poses(scaled))[chosen])
        misses = inverse_poses(Y @ scaled) @ As @ X
        angles = np.linalg.norm(rotation_vectors(misses[:, :3, :3]), axis=1)
        cost = float(np.median(distance * angles + np.linalg.norm(misses[:, :3, 3], axis=1)))
        if cost < best_cost:
            best, best_cost = (X, Y), cost
    return best if best is not None else (np.eye(4), np.eye(4))


def _scaled(As: Array, Bs: Array, X: Array) -> tuple[Array, float]:
    """Translation of X together with the factor from B's lengths to A's: (R_A - I) t - f R_X t_B = -t_A."""
    R_X = X[:3, :3]
    left = np.hstack(((As[:, :3, :3] - np.eye(3)).reshape(-1, 3), -(Bs[:, :3, 3] @ R_X.T).reshape(-1, 1)))
    found = np.asarray(np.linalg.lstsq(left, -As[:, :3, 3].reshape(-1), rcond=None)[0], dtype=float)
    return pose(R_X, found[:3]), float(found[3])


def _lengthened(Ts: Array, factor: float) -> Array:
    out = Ts.copy()
    out[:, :3, 3] *= factor
    return out


def _mean_pose(Ts: Array) -> Array:
    return pose(nearest_rotation(Ts[:, :3, :3].mean(axis=0)), np.asarray(np.median(Ts[:, :3, 3], axis=0), dtype=float))
