"""How far an experiment drives two hypotheses apart, whatever size the second one takes."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from diagnosis.experiments.prediction import Hypothesis, Rows
from diagnosis.search.cell import Cell
from diagnosis.search.fit import damped_steps, parameter_bounds, residuals_at, soft_l1_costs
from machine.effects.layout import ParameterSets
from machine.rotations import Array

MAX_ITERATIONS = 5
FINITE_DIFFERENCE_STEP_FRAC = 2e-3
CONVERGENCE_NATS = 0.05


def separation_nats(
    cell: Cell, spread: float, rows: Rows, truth: ParameterSets, other: Hypothesis, holds: bool
) -> float:
    """Expected log-likelihood ratio of `truth` against the other hypothesis at its best size.

    Model:  T_ij / 2 = min over theta_j of sum rho(W (f_i - f_j(theta_j))) + 1/2 |R (theta_j - fitted)|^2, R the
            `sqrt_information`, over the cell's spread; rho is the fit's own soft-L1 (Atkinson & Fedorov 1975, with the
            recording as prior).
    Args:   holds: the rows are of the experiment alone, so that the recording counts by `other.sqrt_information`.
    """
    own = rows(truth)[0]
    cell = replace(cell, whitened=_residual_against_truth(rows, own))
    residual = _residual_of(cell, other, holds, spread)
    theta = other.fit.theta
    if other.fit.k == 0:
        return _cost_in_nats(residual(theta[None])[0], spread)
    low, high = parameter_bounds(other.fit.hypothesis)
    best = residual(theta[None])[0]
    for _ in range(MAX_ITERATIONS):
        J = _numeric_jacobian(residual, theta, best, low, high)
        trials = np.clip(theta + damped_steps(J, best, high - low), low, high)
        tried = residual(trials)
        totals = soft_l1_costs(tried).sum(axis=1)
        k = int(np.argmin(totals))
        gained = float(soft_l1_costs(best).sum() - totals[k])
        if gained <= 0.0:
            break
        theta, best = trials[k], tried[k]
        if gained < CONVERGENCE_NATS:
            break
    return _cost_in_nats(best, spread)


def _residual_against_truth(rows: Rows, own: Array) -> Callable[[ParameterSets], Array]:
    return lambda sets: rows(sets) - own


def _residual_of(cell: Cell, other: Hypothesis, holds: bool, spread: float) -> Callable[[Array], Array]:
    """Residuals (m, N) at thetas (m, k), the recording's hold on the sizes behind them."""

    def residual(thetas: Array) -> Array:
        new = residuals_at(cell, other.fit.hypothesis, thetas)
        if not holds or other.fit.k == 0:
            return new
        away = (thetas - other.fit.theta) @ other.sqrt_information.T * np.sqrt(spread)
        return np.concatenate([new, away], axis=1)

    return residual


def _cost_in_nats(residual: Array, spread: float) -> float:
    return float(soft_l1_costs(residual).sum()) / spread


def _numeric_jacobian(residual: Callable[[Array], Array], theta: Array, at: Array, low: Array, high: Array) -> Array:
    steps = FINITE_DIFFERENCE_STEP_FRAC * (high - low)
    signs = np.where(theta + steps > high, -1.0, 1.0)
    return ((residual(theta + np.diag(signs * steps)) - at) / (signs * steps)[:, None]).T
