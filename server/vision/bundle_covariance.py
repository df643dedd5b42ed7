"""How well a bundle's optimum is known: covariances from the inliers, and the factor that makes them honest."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit

from server.vision.bundle_contracts import BundleLayout, BundleState, BundleWork, Indices, Mask
from server.vision.bundle_reduced import assemble, back_substitute, cholesky_in_place, choose_charts, solve_factored
from server.vision.bundle_residuals import CAUCHY, CUT, HUBER, apply_step, drop_behind, linearise, observations_cost
from server.vision.contracts import Array

CHI2_MEDIANS = np.array([1.0, 0.4549, 1.3863, 2.3660])  # by degrees of freedom


CONVERGED, UNFINISHED, NOT_FINITE = 0, 1, 2
DAMPING_START, DAMPING_MIN, DAMPING_MAX = 1e-4, 1e-12, 1e8
NEAR_OPTIMUM_DAMPING_MAX = 1e-2  # below, a short step means a near optimum and not a short leash
COST_ROUNDING_FRAC = 1e-13  # of the cost: a change below is rounding
BEHIND_EYE_STEPS_MAX = 4  # steps refused because a point would go behind an eye; then its observation is given up


@njit(cache=True, nogil=True)
def _solve_damped_step(layout: BundleLayout, work: BundleWork, damping: float, step: Array) -> float:
    """Damped step of the frames into `step`, of the points into the workspace; returns the promised gain, -1: none."""
    assemble(layout, work, damping)
    if not cholesky_in_place(work.reduced_matrix):
        return -1.0
    for j in range(len(step)):
        step[j] = -work.reduced_rhs[j]
    solve_factored(work.reduced_matrix, step)
    gain = back_substitute(layout, work, step)
    for j in range(len(step)):
        gain += 0.5 * step[j] * (damping * work.reduced_diagonal[j] * step[j] - work.reduced_rhs[j])
    return gain


@njit(cache=True, nogil=True)
def _copy_state(source: BundleState, target: BundleState) -> None:
    target.rotation[:] = source.rotation
    target.position[:] = source.position
    target.points[:] = source.points


@njit(cache=True, nogil=True)
def minimise(
    layout: BundleLayout, state: BundleState, trial: BundleState, work: BundleWork, iterations_max: int, step_tol: float
) -> tuple[int, int]:
    """Adjust `state` in place by Levenberg-Marquardt: CONVERGED, UNFINISHED or NOT_FINITE, and iterations.

    `trial` is room for a second state.
    """
    step = np.zeros(6 * layout.n_columns)
    drop_behind(layout, state)
    cost, _ = observations_cost(layout, state)
    damping, growth, refused, fresh = DAMPING_START, 2.0, 0, True
    for iteration in range(iterations_max):
        if not math.isfinite(cost):
            return NOT_FINITE, iteration
        if fresh:
            linearise(layout, state, work)
            choose_charts(layout, state, work)
            fresh = False
        gain = _solve_damped_step(layout, work, damping, step)
        if not math.isfinite(gain):
            return NOT_FINITE, iteration
        if gain >= 0.0:
            near = damping <= NEAR_OPTIMUM_DAMPING_MAX and (
                2.0 * gain < step_tol * step_tol or gain < COST_ROUNDING_FRAC * cost
            )
            apply_step(layout, state, work, step, trial)
            new, behind = observations_cost(layout, trial)
            if behind == 0 and new <= cost:
                ratio = (cost - new) / max(gain, 1e-300)
                _copy_state(trial, state)
                cost, fresh, growth, refused = new, True, 2.0, 0
                damping = max(damping * max(1.0 / 9.0, 1.0 - (2.0 * ratio - 1.0) ** 3), DAMPING_MIN)
            if near and behind == 0:
                return CONVERGED, iteration + 1
            if fresh:
                continue
            refused += behind > 0
            if refused >= BEHIND_EYE_STEPS_MAX:
                drop_behind(layout, trial)
                cost, _ = observations_cost(layout, state)
                refused, fresh = 0, True
                continue
        damping *= growth
        growth *= 2.0
        if damping > DAMPING_MAX:
            return UNFINISHED, iteration + 1
    return UNFINISHED, iterations_max


class Spread(NamedTuple):
    """Covariance (c, c) of all unknown frames for residuals of sigma 1, and which share (c,) of each unknown's
    information is its own, the rest being shared with other unknowns; zeros where the system is singular."""

    covariance: Array
    own_frac: Array


class BundleFit(NamedTuple):
    """Which eyes (n, 2) see and agree, rms [sigma] of their coordinates, variance factor, redundancy."""

    inliers: Mask
    rms_sigma: float
    variance_factor: float
    redundancy: int


def frames_spread(layout: BundleLayout, state: BundleState, work: BundleWork, limit_sigma: float) -> Spread:
    """Inverse of the reduced system of the inliers at full weight; leaves the inliers' linearisation in `work`."""
    cut = layout._replace(loss=CUT, loss_scale=limit_sigma)
    linearise(cut, state, work)
    choose_charts(cut, state, work)
    assemble(cut, work, 0.0)
    c = len(work.reduced_diagonal)
    covariance = np.zeros((c, c))
    size = np.sqrt(np.maximum(work.reduced_diagonal, 1e-300))
    scaled = work.reduced_matrix / size[:, None] / size
    if not cholesky_in_place(scaled):
        return Spread(covariance, np.zeros(c))
    _invert_factored(scaled, covariance)
    own = 1.0 / np.maximum(np.diag(covariance), 1e-300)
    return Spread(covariance / size[:, None] / size, own)


@njit(cache=True, nogil=True)
def _invert_factored(lower: Array, inverse: Array) -> None:
    """(L L^T)^-1 into `inverse`; the lower triangle is overwritten by L^-1."""
    c = len(lower)
    for j in range(c):
        lower[j, j] = 1.0 / lower[j, j]
        for i in range(j + 1, c):
            value = 0.0
            for q in range(j, i):
                value -= lower[i, q] * lower[q, j]
            lower[i, j] = value / lower[i, i]
    for i in range(c):
        for j in range(i + 1):
            value = 0.0
            for q in range(i, c):
                value += lower[q, i] * lower[q, j]
            inverse[i, j] = value
            inverse[j, i] = value


def seen_counts(layout: BundleLayout) -> Indices:
    """Coordinates (n, 2) that either eye measured of each one `in_front`; a rectified pair is one eye of 3 or 2."""
    counts = (layout.focal_over_sigma > 0.0).reshape(-1, 2, 2).sum(axis=2)
    if layout.shared_row:
        counts = np.column_stack([counts.sum(axis=1), np.zeros(len(counts), dtype=np.int64)])
    return np.where(layout.in_front[:, None], counts, 0)


def noise_of(layout: BundleLayout, squares: Array) -> float:
    """Residuals over their given sigma by the median, at least 1: an outlier is judged by the noise that there is.

    Model:   median of |r|^2 over that of chi2, with the share that the unknowns took out of the residuals put back.
    """
    counts = seen_counts(layout)
    seen = counts > 0
    if not seen.any():
        return 1.0
    typical = float(np.median(squares[seen] / CHI2_MEDIANS[counts[seen]]))
    taken = counts.sum() / max(_degrees_of_freedom(layout, counts), 1)
    return math.sqrt(max(typical * taken, 1.0))


def fit_of(layout: BundleLayout, work: BundleWork, limit_sigma: float) -> BundleFit:
    """Inliers and variance factor from the squared residuals in `work`.

    Model:   covariance of an M-estimate = E psi^2 / (E psi')^2 (J^T J)^-1 (Huber 1981, 7.6): the loss's own factor on
             Gaussian residuals, or the one measured on these residuals where that is larger (sigmas too small, outliers
             that still pull).
    """
    counts = seen_counts(layout)
    agree = (counts > 0) & (work.squared_residuals <= limit_sigma**2)
    redundancy = _degrees_of_freedom(layout, np.where(agree, counts, 0))
    squares, of = work.squared_residuals[agree], counts[agree]
    influence = float(np.sum(_squared_influence(layout, work.squared_residuals[counts > 0])))
    slope = float(np.sum(_influence_derivative(layout, squares, of))) / max(int(of.sum()), 1)
    measured = influence / max(redundancy, 1) / max(slope, 0.05) ** 2
    expected = gaussian_factor(layout.loss, round(layout.loss_scale, 1), 3 if layout.shared_row else 2)
    rms = math.sqrt(float(squares.sum()) / max(redundancy, 1))
    return BundleFit(agree, rms, max(measured, expected), redundancy)


def _degrees_of_freedom(layout: BundleLayout, counts: Indices) -> int:
    """Agreeing coordinates (counts (n, 2)) minus unknowns; a point takes no more than what was measured of it."""
    if len(layout.first_observation) == 1:
        return int(counts.sum()) - 6 * layout.n_columns
    of_point = np.add.reduceat(np.append(counts.sum(axis=1), 0), layout.first_observation[:-1])
    of_point = np.where(np.diff(layout.first_observation) > 0, of_point, 0)
    return int(counts.sum()) - 6 * layout.n_columns - int(np.minimum(of_point, 3).sum())


def _squared_influence(layout: BundleLayout, squares: Array) -> Array:
    """|psi|^2 = w^2 s."""
    return _robust_weights(layout.loss, layout.loss_scale, squares) ** 2 * squares


def _influence_derivative(layout: BundleLayout, squares: Array, counts: Indices) -> Array:
    """Trace of d psi / d r = d w + 2 s dw/ds."""
    w = _robust_weights(layout.loss, layout.loss_scale, squares)
    if layout.loss == HUBER:
        return np.where(w < 1.0, (counts - 1) * w, counts)
    if layout.loss == CAUCHY:
        return counts * w - 2.0 * w**2 * squares / layout.loss_scale**2
    return counts.astype(float)


def _robust_weights(kind: int, scale: float, squares: Array) -> Array:
    if kind == HUBER:
        return scale / np.maximum(np.sqrt(squares), scale)
    if kind == CAUCHY:
        return 1.0 / (1.0 + squares / scale**2)
    return np.ones_like(squares)


@lru_cache(maxsize=32)
def gaussian_factor(kind: int, scale: float, dimensions: int) -> float:
    """Variance of the M-estimate over that of least squares where residuals (d,) are truly Gaussian."""
    r = np.linspace(0.0, 12.0, 4001)
    density = r ** (dimensions - 1) * np.exp(-0.5 * r**2)
    density /= density.sum()
    w = _robust_weights(kind, scale, r**2)
    slope = np.zeros_like(r)
    if kind == HUBER:
        slope = np.where(w < 1.0, -w, 0.0)
    if kind == CAUCHY:
        slope = -2.0 * w**2 * r**2 / scale**2
    psi = float(np.sum(density * w**2 * r**2)) / dimensions
    return psi / (float(np.sum(density * (w + slope / dimensions))) ** 2)
