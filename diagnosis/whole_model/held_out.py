"""How well a fit predicts kinds of motion that it was not fitted to."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.search.cell import Cell
from diagnosis.search.fit import Fit, normal_equations, parameter_bounds, parameter_spans, residuals_at, soft_l1_costs
from machine.rotations import Array

TRIAL_DAMPINGS = (0.1, 1.0, 10.0, 100.0)  # of a step that leads astray, over each number's own curvature


@dataclass(frozen=True, slots=True)
class HeldOut:
    """One part predicted by a fit to its other kinds of motion.

    `residual_with_effects` (N,): of effects fitted without that row's fold; `fold_numbers` (m,): ascending;
    `thetas_without_fold` (m, k): the numbers without each of them.
    """

    cell: Cell
    fit: Fit
    fold_numbers: NDArray[np.int64]
    thetas_without_fold: Array
    residual_without_effects: Array
    residual_with_effects: Array

    def theta_without(self, fold: int) -> Array:
        """The numbers (k,) without one fold."""
        return np.asarray(self.thetas_without_fold[int(np.searchsorted(self.fold_numbers, fold))])


def held_out(cell: Cell, found: Fit) -> HeldOut:
    """Leave each fold (kind of motion) out, fit the others again, and predict it.

    Model: one Gauss-Newton step, theta_f = theta - (J'WJ + R)^-1 J'Wr inside the bounds, rows of fold f left out, R =
           1 / range^2; a damped one where that serves the rest better, or none.
    Why damped: at a kink (a limit just reached, a whole cycle of delay) or where the rest hardly determines a number,
           the step goes far astray, and the effect is not to blame for what the fold then costs.
    """
    folds = np.unique(cell.rows.fold)
    before = residuals_at(cell, (), np.zeros((1, 0)))[0]
    if found.k == 0:
        return HeldOut(cell, found, folds, np.zeros((len(folds), 0)), before, before)
    kept = cell.rows.fold != folds[:, None]
    thetas = np.array([_theta_after_bounded_step(found, keep, 0.0) for keep in kept])
    residuals = residuals_at(cell, found.hypothesis, thetas)
    worse = np.nonzero((soft_l1_costs(residuals) * kept).sum(axis=1) > kept @ soft_l1_costs(found.residual))[0]
    if len(worse):
        damped = np.array(
            [[_theta_after_bounded_step(found, kept[k], damping) for k in worse] for damping in TRIAL_DAMPINGS]
        )
        there = residuals_at(cell, found.hypothesis, damped.reshape(-1, found.k)).reshape(
            len(TRIAL_DAMPINGS), len(worse), -1
        )
        damped = np.concatenate([damped, np.tile(found.theta, (1, len(worse), 1))])
        there = np.concatenate([there, np.tile(found.residual, (1, len(worse), 1))])
        best = np.argmin((soft_l1_costs(there) * kept[worse]).sum(axis=2), axis=0), np.arange(len(worse))
        thetas[worse], residuals[worse] = damped[best], there[best]
    after = residuals[np.searchsorted(folds, cell.rows.fold), np.arange(cell.rows.row_count)]
    return HeldOut(cell, found, folds, thetas, before, after)


def _theta_after_bounded_step(found: Fit, keep: NDArray[np.bool_], damping: float) -> Array:
    """Theta (k,) after a step on some rows; a number that would leave its range stays at the end, the others go on.

    Why go on: a second effect that is nothing here would else keep its neighbours where they are.
    """
    low, high = parameter_bounds(found.hypothesis)
    span = parameter_spans(found.hypothesis)
    H, g = normal_equations(found.J[keep], found.residual[keep], span)
    H = H + damping * np.diag(np.diag(H)) + np.eye(found.k)
    least, most = (low - found.theta) / span, (high - found.theta) / span
    step, free = np.zeros(found.k), np.ones(found.k, dtype=bool)
    while free.any():
        step[free] = np.linalg.lstsq(
            H[np.ix_(free, free)], -g[free] - H[np.ix_(free, ~free)] @ step[~free], rcond=None
        )[0]
        beyond = free & ((step < least) | (step > most))
        if not beyond.any():
            break
        step[beyond] = np.clip(step, least, most)[beyond]
        free &= ~beyond
    return np.clip(found.theta + step * span, low, high)
