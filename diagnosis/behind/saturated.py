"""The noise of rows that were never measured twice: what no mixture of all effects explains of them."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from diagnosis.search.candidates import Candidate, parameter_sets_with
from machine.effects.layout import ParameterSets
from machine.rotations import Array

SINGULAR_VALUE_MIN_FRAC = 1e-4  # of the strongest direction: a weaker one is rounding
MIXTURE_DIRECTIONS_MAX_FRAC = 0.5  # of the degrees of freedom, that a mixture may explain


def saturated_noise(
    residual: Callable[[ParameterSets], Array],
    base: ParameterSets,
    candidates: tuple[Candidate, ...],
    groups: NDArray[np.int64],
    taken: int = 0,
) -> tuple[float, float]:
    """Standard deviations of each row's own noise, and of what the rows of one group share.

    Args:  groups: (N,) of the rows: one instant, one axis; taken: numbers that the residual's own fit took from them.
    Model: what is left by one linear step in all effects together, its degrees of freedom counted; the mean product of
           two rows of a group is what they share.
    Why:   not the residual of a model under test: that would hide the gap. And a hand that stands 3 mm off its model
           takes all its markers with it: counted one by one such a pose would speak as often as it has markers.
    """
    left, dof = unexplained_by_mixtures(residual, base, candidates, taken)
    S, Q, n = np.bincount(groups, weights=left), np.bincount(groups, weights=left**2), np.bincount(groups)
    pairs = float((n * (n - 1)).sum())
    variance = float(left @ left) / dof
    shared = float((S**2 - Q).sum()) / pairs * len(left) / dof if pairs > 0.0 else 0.0
    shared = float(np.clip(shared, 0.0, variance))
    return float(np.sqrt(variance - shared)), float(np.sqrt(shared))


def unexplained_by_mixtures(
    residual: Callable[[ParameterSets], Array],
    base: ParameterSets,
    candidates: tuple[Candidate, ...],
    taken: int = 0,
) -> tuple[Array, int]:
    """What no mixture explains (N,), and how many degrees of freedom it has. `taken`: see `saturated_noise`.

    Why: at most half of what is free is explained, by what effects show most: of twenty points at rest a mixture of all
         explains each number, and what it left was called a noise of a tenth of the true one.
    """
    r0, u = mixture_directions(residual, base, candidates)
    free = max(len(r0) - taken, 1)
    u = u[:, : int(MIXTURE_DIRECTIONS_MAX_FRAC * free)]
    return r0 - u @ (u.T @ r0), max(free - u.shape[1], 1)


def mixture_directions(
    residual: Callable[[ParameterSets], Array], base: ParameterSets, candidates: tuple[Candidate, ...]
) -> tuple[Array, Array]:
    """The residual (N,) without effects, and orthonormal directions (N, k), strongest first, that small ones span."""
    r0 = residual(base)[0]
    columns = []
    for candidate in candidates:
        theta = np.array([0.0 if slot.neutral_value == 0.0 else slot.start_value for slot in candidate.parameter_slots])
        for k, slot in enumerate(candidate.parameter_slots):
            theta[k] = 0.2 * slot.start_value if slot.neutral_value == 0.0 else slot.start_value
            columns.append(residual(parameter_sets_with(base, (candidate,), theta[None]))[0] - r0)
            theta[k] = 0.0 if slot.neutral_value == 0.0 else slot.start_value
    A = np.array(columns).T
    A = A / np.maximum(np.linalg.norm(A, axis=0), 1e-15)
    u, s, _ = np.linalg.svd(A, full_matrices=False)
    return r0, u[:, s > SINGULAR_VALUE_MIN_FRAC * s[0]] if len(s) else u
