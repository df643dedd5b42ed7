"""Robust refinement on SE(3): Student's t residuals whose covariance is fitted along, Levenberg-Marquardt steps."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from server.calibration.contracts import Array
from server.calibration.hand_eye_models import HandEyeUnknowns

_FLOORS = np.array([1e-7] * 3 + [1e-7] * 3)  # [rad], [m]: exact data must not divide by 0
_POSES_FOR_FULL, _POSES_FOR_AXES = 60, 25
_SHAPE_ROUNDS = 15


class HandEyeModel(Protocol):
    """Residuals (n, 6) and Jacobian (n, 6, p) at given unknowns."""

    def evaluate(self, at: HandEyeUnknowns, /) -> tuple[Array, Array]:
        """At these unknowns."""
        ...


@dataclass(frozen=True, slots=True)
class Refined:
    """The refined unknowns, covariance (p, p), residuals (n, 6), weights (n,), and whether it settled."""

    unknowns: HandEyeUnknowns
    covariance: Array
    residuals: Array
    weights: Array
    settled: bool


def refine(
    model: HandEyeModel,
    start: HandEyeUnknowns,
    freedom: float,
    iterations_max: int,
    free_scale: bool,
    in_time_order: bool,
) -> Refined:
    """Unknowns of the largest likelihood under Student's t of the residuals, its 6x6 shape estimated from them.

    Model:   w = (nu + 6) / (nu + r^T S^-1 r); S = sum w r r^T / n; (sum w J^T S^-1 J) d = -sum w J^T S^-1 r, damped
             until the likelihood does not fall. Covariance: the model's, at least the sandwich's size, times
             6 n / (6 n - p); poses in time order: times the residuals' correlation time, for neighbours err alike.
    Source:  Lange, Little, Taylor 1989 (t by reweighting); Huber 1967 (sandwich).
    """
    at, damping, settled = start, 1e-6, False
    residuals, J = model.evaluate(at)
    S = _first_shape(residuals)
    for count in range(iterations_max):
        if count < _SHAPE_ROUNDS:  # then held: fitting it further only creeps
            S, weights = _shape(residuals, S, freedom)
        else:
            weights = (freedom + 6.0) / (freedom + _squares(residuals, S))
        cost = _cost(residuals, S, freedom)
        H, g = _normal(residuals, J, S, weights)
        change: Array = -np.linalg.lstsq(H + damping * np.diag(np.diag(H)), g, rcond=None)[0].astype(float)
        tried = at.after(change, free_scale)
        tried_residuals, tried_J = model.evaluate(tried)
        if _cost(tried_residuals, S, freedom) <= cost + 1e-9:
            at, residuals, J, damping = tried, tried_residuals, tried_J, max(0.1 * damping, 1e-9)
            if float(np.abs(change).max()) < 1e-8 or float(change @ H @ change) < 1e-5:
                settled = True
                break
        else:
            damping = max(10.0 * damping, 1e-4)
            if damping > 1e8:
                break
    weights = (freedom + 6.0) / (freedom + _squares(residuals, S))
    return Refined(at, _covariance(residuals, J, S, weights, freedom, in_time_order), residuals, weights, settled)


def _first_shape(residuals: Array) -> Array:
    """Robust start: squared medians per half."""
    halves = [max(float(np.median(np.linalg.norm(residuals[:, half], axis=1))) / 1.5382, 1e-6) for half in _HALVES]
    return np.diag(np.repeat(halves, 3) ** 2)


_HALVES = (slice(0, 3), slice(3, 6))


def _shape(residuals: Array, S: Array, freedom: float) -> tuple[Array, Array]:
    """Shape matrix after some rounds of reweighting, and the weights; fewer numbers are fitted from fewer poses."""
    n = len(residuals)
    weights = np.ones(n)
    for _ in range(5):
        weights = (freedom + 6.0) / (freedom + _squares(residuals, S))
        full = (residuals * weights[:, None]).T @ residuals / n
        if n < _POSES_FOR_FULL:
            full = np.diag(np.diag(full))
        if n < _POSES_FOR_AXES:
            full = np.diag(np.repeat([np.mean(np.diag(full)[half]) for half in _HALVES], 3))
        S = np.asarray(full + np.diag(_FLOORS**2), dtype=float)
    return S, weights


def _squares(residuals: Array, S: Array) -> Array:
    return np.einsum("ni,ni->n", residuals, np.linalg.solve(S, residuals.T).T)


def _cost(residuals: Array, S: Array, freedom: float) -> float:
    return float(0.5 * (freedom + 6.0) * np.sum(np.log1p(_squares(residuals, S) / freedom)))


def _normal(residuals: Array, J: Array, S: Array, weights: Array) -> tuple[Array, Array]:
    JS = np.einsum("nip,ij->npj", J, np.linalg.inv(S)) * weights[:, None, None]
    return np.einsum("npj,njq->pq", JS, J), np.einsum("npj,nj->p", JS, residuals)


def _covariance(residuals: Array, J: Array, S: Array, weights: Array, freedom: float, in_time_order: bool) -> Array:
    """The model's covariance, widened where the residuals scatter more than the model says (sandwich) or err alike."""
    n, p = len(residuals), J.shape[2]
    JS = np.einsum("nip,ij->npj", J, np.linalg.inv(S))
    information = np.einsum("n,npj,njq->pq", np.minimum(weights, 1.0), JS, J) * ((freedom + 6.0) / (freedom + 8.0))
    inverse = np.linalg.pinv(information, hermitian=True) * (6.0 * n / max(6.0 * n - p, 1.0))
    bread = np.linalg.pinv(np.einsum("n,npj,njq->pq", weights, JS, J), hermitian=True)
    pulls = np.einsum("npj,nj->np", JS, residuals) * weights[:, None]
    wider = float(np.trace(information @ bread @ (pulls.T @ pulls) @ bread)) / p
    longer = _correlation_time(residuals * np.sqrt(weights)[:, None], S) if in_time_order else 1.0
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
