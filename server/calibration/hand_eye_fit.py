"""A X = Y B solved: closed-form starts, residuals with their derivatives, and the robust refinement on SE(3)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from machine.poses import moved_pose, pose
from machine.rotations import nearest_rotation, skew_matrices
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


def start_ax_yb(As: Array, Bs: Array, rng: np.random.Generator, triples: int) -> tuple[Array, Array]:
    """X and Y of A X = Y B: of all poses, and of random triples, the one with the least median residual.

    Model:   three poses give three motions and by them X; Y = A X B^-1 averaged; half of the poses may be wrong.
    Args:    As, Bs: (n, 4, 4).
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
        X = park_martin(motions_between(As, chosen, other), motions_between(Bs, chosen, other))
        Y = _mean_pose((As @ X @ inverse_poses(Bs))[chosen])
        misses = inverse_poses(Y @ Bs) @ As @ X
        angles = np.linalg.norm(rotation_vectors(misses[:, :3, :3]), axis=1)
        cost = float(np.median(distance * angles + np.linalg.norm(misses[:, :3, 3], axis=1)))
        if cost < best_cost:
            best, best_cost = (X, Y), cost
    return best if best is not None else (np.eye(4), np.eye(4))


def _mean_pose(Ts: Array) -> Array:
    return pose(nearest_rotation(Ts[:, :3, :3].mean(axis=0)), np.asarray(np.median(Ts[:, :3, 3], axis=0), dtype=float))


#: Hand poses (n, 4, 4) at the camera's times plus an offset [s].
HandTrack = Callable[[float], Array]
_OFFSET_STEP_S = 0.005


@dataclass(frozen=True, slots=True)
class HandEyeUnknowns:
    """X, Y, clock offset [s]."""

    T_hand_cam: Array
    T_base_target: Array
    offset_s: float = 0.0

    def moved_by(self, change: Array) -> "HandEyeUnknowns":
        """Changed by (X 6, Y 6, offset if it is free)."""
        offset_s = self.offset_s + (float(change[12]) if len(change) > 12 else 0.0)
        return HandEyeUnknowns(
            moved_pose(self.T_hand_cam, change[:6]), moved_pose(self.T_base_target, change[6:12]), offset_s
        )


@dataclass(frozen=True, slots=True)
class PoseModel:
    """A X = Y B over poses: predicts the target in the camera, B^-1 = X^-1 A^-1 Y.

    Residual (n, 6), in camera axes, where the camera's noise lives: log(R_seen R_pred^T), t_seen - t_pred.
    """

    hand_track: HandTrack
    Ts_cam_target: Array
    free_offset: bool

    def evaluate(self, at: HandEyeUnknowns) -> tuple[Array, Array]:
        """Residuals (n, 6) [rad, m] and their derivative (n, 6, 12 + offset)."""
        As = self.hand_track(at.offset_s)
        R_pred, t_pred, w, R_XA = self._predicted_pose_terms(at, As)
        seen = self.Ts_cam_target
        turned = rotation_vectors(seen[:, :3, :3] @ R_pred.transpose(0, 2, 1))
        residuals = np.hstack((turned, seen[:, :3, 3] - t_pred))
        n, R_X = len(As), at.T_hand_cam[:3, :3]
        J = np.zeros((n, 6, 12 + self.free_offset))
        J[:, :3, :3] = R_X.T
        J[:, :3, 6:9] = -R_XA
        J[:, 3:, :3] = -R_X.T @ skew_matrices(w)
        J[:, 3:, 3:6] = R_X.T
        J[:, 3:, 9:12] = -R_XA
        if self.free_offset:
            sides = [
                self._predicted_pose_terms(at, self.hand_track(at.offset_s + side))
                for side in (-_OFFSET_STEP_S, _OFFSET_STEP_S)
            ]
            turned = rotation_vectors(sides[1][0] @ sides[0][0].transpose(0, 2, 1))
            moved = sides[1][1] - sides[0][1]
            J[:, :, -1] = -np.hstack((turned, moved)) / (2.0 * _OFFSET_STEP_S)
        return residuals, J

    def _predicted_pose_terms(self, at: HandEyeUnknowns, As: Array) -> tuple[Array, Array, Array, Array]:
        R_X, inverse_A = at.T_hand_cam[:3, :3], inverse_poses(As)
        w = (inverse_A @ at.T_base_target)[:, :3, 3] - at.T_hand_cam[:3, 3]
        R_XA = R_X.T @ inverse_A[:, :3, :3]
        return R_XA @ at.T_base_target[:3, :3], w @ R_X, w, R_XA


@dataclass(frozen=True, slots=True)
class WeightedModel:
    """Another model's residuals and derivatives, each sample's multiplied by its own matrix (n, 6, 6)."""

    model: PoseModel
    whitening_matrices: Array

    def evaluate(self, at: HandEyeUnknowns) -> tuple[Array, Array]:
        """Residuals (n, 6), of equal spread if the matrices are right, and their derivative."""
        residuals, J = self.model.evaluate(at)
        return np.einsum("nij,nj->ni", self.whitening_matrices, residuals), self.whitening_matrices @ J


def whiteners_of(covariances: Array, residuals: Array, weights: Array) -> Array:
    """Inverse Cholesky factors (n, 6, 6) of the camera's covariances plus what hand and clock add to all alike.

    Model:   cov(r_i) = H + C_i; H: weighted mean of r r^T less that of C, its negative eigenvalues set to 0. A tenth of
             a thousandth of the mean stays, so that no C_i of almost nothing outweighs the rest.
    Args:    covariances C_i (n, 6, 6), residuals (n, 6) of a fit without them, its weights (n,).
    """
    share = weights / weights.sum()
    scatter = np.einsum("n,ni,nj->ij", share, residuals, residuals)
    values, vectors = np.linalg.eigh(scatter - np.einsum("n,nij->ij", share, covariances))
    common = (vectors * np.maximum(values, 0.0)) @ vectors.T + 1e-4 * np.diag(np.diag(scatter))
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariances + common)), dtype=np.float64)


_FLOOR = 1e-7  # rad, m: exact data must not divide by 0
_POSES_FOR_FULL, _POSES_FOR_AXES = 60, 25
_SHAPE_ROUNDS = 15


@dataclass(frozen=True, slots=True)
class RefinedHandEye:
    """The refined unknowns, covariance (p, p), residuals (n, 6), weights (n,), and whether it settled."""

    unknowns: HandEyeUnknowns
    covariance: Array
    residuals: Array
    weights: Array
    converged: bool


def refine_hand_eye(
    model: PoseModel | WeightedModel, start: HandEyeUnknowns, freedom: float, iterations_max: int
) -> RefinedHandEye:
    """Unknowns of the largest likelihood under Student's t of the residuals, its 6x6 shape estimated from them.

    Model:   w = (nu + 6) / (nu + r^T S^-1 r); S = sum w r r^T / n; (sum w J^T S^-1 J) d = -sum w J^T S^-1 r, damped
             until the likelihood does not fall. Covariance: the model's, at least the sandwich's size, times
             6 n / (6 n - p), times the residuals' correlation time, for neighbours in time err alike.
    Source:  Lange, Little, Taylor 1989 (t by reweighting); Huber 1967 (sandwich).
    """
    at, damping, settled = start, 1e-6, False
    residuals, J = model.evaluate(at)
    S = _first_shape(residuals)
    for count in range(iterations_max):
        if count < _SHAPE_ROUNDS:  # then held: fitting it further only creeps
            S, weights = _fit_shape_matrix(residuals, S, freedom)
        else:
            weights = (freedom + 6.0) / (freedom + _mahalanobis_squares(residuals, S))
        cost = _student_t_cost(residuals, S, freedom)
        H, g = _normal_equations(residuals, J, S, weights)
        change: Array = -np.linalg.lstsq(H + damping * np.diag(np.diag(H)), g, rcond=None)[0].astype(float)
        tried = at.moved_by(change)
        tried_residuals, tried_J = model.evaluate(tried)
        if _student_t_cost(tried_residuals, S, freedom) <= cost + 1e-9:
            at, residuals, J, damping = tried, tried_residuals, tried_J, max(0.1 * damping, 1e-9)
            if float(np.abs(change).max()) < 1e-8 or float(change @ H @ change) < 1e-5:
                settled = True
                break
        else:
            damping = max(10.0 * damping, 1e-4)
            if damping > 1e8:
                break
    weights = (freedom + 6.0) / (freedom + _mahalanobis_squares(residuals, S))
    return RefinedHandEye(at, _sandwich_covariance(residuals, J, S, weights, freedom), residuals, weights, settled)


def _first_shape(residuals: Array) -> Array:
    """Robust start: squared medians per half."""
    halves = [max(float(np.median(np.linalg.norm(residuals[:, half], axis=1))) / 1.5382, 1e-6) for half in _HALVES]
    return np.diag(np.repeat(halves, 3) ** 2)


_HALVES = (slice(0, 3), slice(3, 6))


def _fit_shape_matrix(residuals: Array, S: Array, freedom: float) -> tuple[Array, Array]:
    """Shape matrix after some rounds of reweighting, and the weights; fewer numbers are fitted from fewer poses."""
    n = len(residuals)
    weights = np.ones(n)
    for _ in range(5):
        weights = (freedom + 6.0) / (freedom + _mahalanobis_squares(residuals, S))
        full = (residuals * weights[:, None]).T @ residuals / n
        if n < _POSES_FOR_FULL:
            full = np.diag(np.diag(full))
        if n < _POSES_FOR_AXES:
            full = np.diag(np.repeat([np.mean(np.diag(full)[half]) for half in _HALVES], 3))
        S = np.asarray(full + np.diag(np.full(6, _FLOOR) ** 2), dtype=float)
    return S, weights


def _mahalanobis_squares(residuals: Array, S: Array) -> Array:
    return np.einsum("ni,ni->n", residuals, np.linalg.solve(S, residuals.T).T)


def _student_t_cost(residuals: Array, S: Array, freedom: float) -> float:
    return float(0.5 * (freedom + 6.0) * np.sum(np.log1p(_mahalanobis_squares(residuals, S) / freedom)))


def _normal_equations(residuals: Array, J: Array, S: Array, weights: Array) -> tuple[Array, Array]:
    JS = np.einsum("nip,ij->npj", J, np.linalg.inv(S)) * weights[:, None, None]
    return np.einsum("npj,njq->pq", JS, J), np.einsum("npj,nj->p", JS, residuals)


def _sandwich_covariance(residuals: Array, J: Array, S: Array, weights: Array, freedom: float) -> Array:
    """The model's covariance, widened where the residuals scatter more than the model says (sandwich) or err alike."""
    n, p = len(residuals), J.shape[2]
    JS = np.einsum("nip,ij->npj", J, np.linalg.inv(S))
    information = np.einsum("n,npj,njq->pq", np.minimum(weights, 1.0), JS, J) * ((freedom + 6.0) / (freedom + 8.0))
    inverse = np.linalg.pinv(information, hermitian=True) * (6.0 * n / max(6.0 * n - p, 1.0))
    bread = np.linalg.pinv(np.einsum("n,npj,njq->pq", weights, JS, J), hermitian=True)
    pulls = np.einsum("npj,nj->np", JS, residuals) * weights[:, None]
    wider = float(np.trace(information @ bread @ (pulls.T @ pulls) @ bread)) / p
    longer = _correlation_time(residuals * np.sqrt(weights)[:, None], S)
    return 0.5 * max(wider, 1.0) * longer * (inverse + inverse.T)


def _correlation_time(residuals: Array, S: Array) -> float:
    """1 + 2 sum of the whitened residuals' autocorrelations up to the first below 0.05, at most n / 10 samples."""
    white = np.linalg.solve(np.linalg.cholesky(S), residuals.T)
    white = white - white.mean(axis=1, keepdims=True)
    square, total = float(np.sum(white**2)), 1.0
    for lag in range(1, max(white.shape[1] // 10, 1)):
        correlation = float(np.sum(white[:, lag:] * white[:, :-lag])) / square if square > 0.0 else 0.0
        if correlation < 0.05:
            break
        total += 2.0 * correlation
    return total
