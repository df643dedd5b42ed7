"""What the hand-eye equations predict and how it changes with the unknowns: residuals and Jacobians of all poses."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from server.calibration.contracts import Array
from server.calibration.hand_eye_linear import inverse_poses, rotation_vectors

#: Hand poses (n, 4, 4) at the camera's times plus an offset [s].
HandTrack = Callable[[float], Array]
_OFFSET_STEP_S = 0.005


@dataclass(frozen=True, slots=True)
class HandEyeUnknowns:
    """X, Y (None for A X = X B), scale of the camera's lengths, clock offset [s]."""

    X: Array
    Y: Array | None
    scale: float = 1.0
    offset_s: float = 0.0

    def after(self, change: Array, free_scale: bool) -> "HandEyeUnknowns":
        """Changed by (X 6, Y 6 if any, log scale if free, offset if any are left)."""
        X, rest = _moved(self.X, change[:6]), change[6:]
        Y = self.Y
        if Y is not None:
            Y, rest = _moved(Y, rest[:6]), rest[6:]
        scale = self.scale
        if free_scale:
            scale, rest = scale * float(np.exp(np.clip(rest[0], -0.5, 0.5))), rest[1:]
        return HandEyeUnknowns(X, Y, scale, self.offset_s + (float(rest[0]) if len(rest) else 0.0))


def _moved(T: Array, change: Array) -> Array:
    return pose(rotation_from_rotvec(change[:3]) @ T[:3, :3], T[:3, 3] + change[3:])


@dataclass(frozen=True, slots=True)
class PoseModel:
    """A X = Y B over poses: predicts the target in the camera, B^-1 = X^-1 A^-1 Y, lengths times the scale.

    Residual (n, 6), in camera axes, where the camera's noise lives: log(R_seen R_pred^T), t_seen - scale t_pred.
    """

    hand: HandTrack
    Ts_cam_target: Array
    free_scale: bool
    free_offset: bool

    def evaluate(self, at: HandEyeUnknowns) -> tuple[Array, Array]:
        """Residuals (n, 6) [rad, m] and their derivative (n, 6, 12 + scale + offset)."""
        As = self.hand(at.offset_s)
        R_pred, t_pred, w, R_XA = self._predicted(at, As)
        residuals = _misses(self.Ts_cam_target, R_pred, at.scale * t_pred)
        n, R_X = len(As), at.X[:3, :3]
        J = np.zeros((n, 6, 12 + self.free_scale + self.free_offset))
        J[:, :3, :3] = R_X.T
        J[:, :3, 6:9] = -R_XA
        J[:, 3:, :3] = -at.scale * R_X.T @ _skews(w)
        J[:, 3:, 3:6] = at.scale * R_X.T
        J[:, 3:, 9:12] = -at.scale * R_XA
        if self.free_scale:
            J[:, 3:, 12] = -at.scale * t_pred
        if self.free_offset:
            sides = [self._predicted(at, self.hand(at.offset_s + side)) for side in (-_OFFSET_STEP_S, _OFFSET_STEP_S)]
            turned = rotation_vectors(sides[1][0] @ sides[0][0].transpose(0, 2, 1))
            moved = at.scale * (sides[1][1] - sides[0][1])
            J[:, :, -1] = -np.hstack((turned, moved)) / (2.0 * _OFFSET_STEP_S)
        return residuals, J

    def _predicted(self, at: HandEyeUnknowns, As: Array) -> tuple[Array, Array, Array, Array]:
        if at.Y is None:
            raise ValueError("A X = Y B needs a start for Y")
        R_X, inverse_A = at.X[:3, :3], inverse_poses(As)
        w = (inverse_A @ at.Y)[:, :3, 3] - at.X[:3, 3]
        R_XA = R_X.T @ inverse_A[:, :3, :3]
        return R_XA @ at.Y[:3, :3], w @ R_X, w, R_XA


@dataclass(frozen=True, slots=True)
class WeightedModel:
    """Another model's residuals and derivatives, each sample's multiplied by its own matrix (n, 6, 6)."""

    model: PoseModel
    whiteners: Array

    def evaluate(self, at: HandEyeUnknowns) -> tuple[Array, Array]:
        """Residuals (n, 6), of equal spread if the matrices are right, and their derivative."""
        residuals, J = self.model.evaluate(at)
        return np.einsum("nij,nj->ni", self.whiteners, residuals), self.whiteners @ J


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


def _misses(Ts_seen: Array, R_pred: Array, t_pred: Array) -> Array:
    return np.hstack((rotation_vectors(Ts_seen[:, :3, :3] @ R_pred.transpose(0, 2, 1)), Ts_seen[:, :3, 3] - t_pred))


def _skews(vectors: Array) -> Array:
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
