"""Where a fit would have ended without each fold (kind of trajectory)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.search.cell import Cell
from diagnosis.search.fit import Fit, bounds, costs, evaluated, normal_equations, spans
from machine.rotations import Array

DAMPINGS = (0.1, 1.0, 10.0, 100.0)  # of a step that leads astray, over each number's own curvature


@dataclass(frozen=True, slots=True)
class Folds:
    """Numbers of the folds (m,), ascending, and theta without each of them (m, k)."""

    numbers: NDArray[np.int64]
    thetas: Array

    def theta_without(self, fold: int) -> Array:
        """Theta (k,) without one fold."""
        return np.asarray(self.thetas[int(np.searchsorted(self.numbers, fold))])


def refitted(cell: Cell, found: Fit) -> tuple[Folds, Array]:
    """The fit without each fold, and the residuals of all rows there (m, N).

    Model: one Gauss-Newton step, theta_f = theta - (J'WJ + R)^-1 J'Wr inside the bounds, rows of fold f left out, R =
           1 / range^2; a damped one where that serves the rest better, or none.
    Why damped: at a kink (a limit just reached, a whole cycle of delay) or where the rest hardly tells a number, the
           step goes far astray, and what the fold then costs is no fault of its name.
    """
    numbers = np.unique(cell.rows.fold)
    if found.k == 0:
        return Folds(numbers, np.zeros((len(numbers), 0))), np.tile(found.residual, (len(numbers), 1))
    kept = cell.rows.fold != numbers[:, None]
    thetas = np.array([_stepped(found, keep, 0.0) for keep in kept])
    residuals = evaluated(cell, found.hypothesis, thetas)
    before = kept @ costs(found.residual)
    worse = np.nonzero((costs(residuals) * kept).sum(axis=1) > before)[0]
    if len(worse):
        damped = np.array([[_stepped(found, kept[k], one) for k in worse] for one in DAMPINGS])
        there = evaluated(cell, found.hypothesis, damped.reshape(-1, found.k)).reshape(len(DAMPINGS), len(worse), -1)
        damped = np.concatenate([damped, np.tile(found.theta, (1, len(worse), 1))])
        there = np.concatenate([there, np.tile(found.residual, (1, len(worse), 1))])
        best = np.argmin((costs(there) * kept[worse]).sum(axis=2), axis=0), np.arange(len(worse))
        thetas[worse], residuals[worse] = damped[best], there[best]
    return Folds(numbers, thetas), residuals


def _stepped(found: Fit, keep: NDArray[np.bool_], damping: float) -> Array:
    """Theta (k,) after a step on some rows; a number that would leave its range stays at the end, the others go on.

    Why go on: a second name that is nothing here would else keep its neighbours where they are.
    """
    low, high = bounds(found.hypothesis)
    span = spans(found.hypothesis)
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
