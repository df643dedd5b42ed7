"""Levenberg-Marquardt over a laid-out bundle; the only loop that changes frames, groups and points."""

import math

import numpy as np
from numba import njit

from server.vision.bundle_layout import BundleLayout, BundleState, BundleWork
from server.vision.bundle_motion import add_priors, move, priors_cost
from server.vision.bundle_reduced import assemble, choose_charts, set_body_arms
from server.vision.bundle_residuals import drop_behind, linearise, observations_cost
from server.vision.bundle_solve import back_substitute, factor, solve_factored
from server.vision.contracts import Array

CONVERGED, UNFINISHED, NOT_FINITE = 0, 1, 2
DAMPING_START, DAMPING_MIN, DAMPING_MAX = 1e-4, 1e-12, 1e8
DAMPING_SMALL = 1e-2  # below, a short step means a near optimum and not a short leash
NOISE = 1e-13  # of the cost: a change below is rounding
BEHIND_PATIENCE = 4  # steps refused because a point would go behind an eye; then its observation is given up


@njit(cache=True, nogil=True)
def total_cost(layout: BundleLayout, start: BundleState, state: BundleState) -> tuple[float, int]:
    """Cost of rays and priors, and how many living rays have their point behind the eye."""
    cost, behind = observations_cost(layout, state)
    return cost + priors_cost(layout, start, state), behind


@njit(cache=True, nogil=True)
def _solve(
    layout: BundleLayout, start: BundleState, state: BundleState, work: BundleWork, damping: float, step: Array
) -> float:
    """Damped step of the bodies into `step`, of the points into the workspace; returns the promised gain, -1: none."""
    add_priors(layout, start, state, work)
    assemble(layout, state, work, damping)
    if not factor(work.reduced):
        return -1.0
    for j in range(len(step)):
        step[j] = -work.right[j]
    solve_factored(work.reduced, step)
    gain = back_substitute(layout, work, step)
    for j in range(len(step)):
        gain += 0.5 * step[j] * (damping * work.diagonal[j] * step[j] - work.right[j])
    return gain


@njit(cache=True, nogil=True)
def _copy(source: BundleState, target: BundleState) -> None:
    target.rotation[:] = source.rotation
    target.position[:] = source.position
    target.points[:] = source.points


@njit(cache=True, nogil=True)
def minimise(
    layout: BundleLayout,
    start: BundleState,
    state: BundleState,
    trial: BundleState,
    work: BundleWork,
    iterations_max: int,
    step_tol: float,
) -> tuple[int, int]:
    """Adjust `state` in place: (CONVERGED, UNFINISHED or NOT_FINITE), iterations.

    `start` is where the priors hold; `trial` is room for a second state.
    """
    step = np.zeros(6 * layout.n_columns)
    drop_behind(layout, state)
    cost, _ = total_cost(layout, start, state)
    damping, growth, refused, fresh = DAMPING_START, 2.0, 0, True
    for iteration in range(iterations_max):
        if not math.isfinite(cost):
            return NOT_FINITE, iteration
        if fresh:
            linearise(layout, state, work)
            choose_charts(layout, state, work)
            set_body_arms(layout, state, work)
            fresh = False
        gain = _solve(layout, start, state, work, damping, step)
        if not math.isfinite(gain):
            return NOT_FINITE, iteration
        if gain >= 0.0:
            near = damping <= DAMPING_SMALL and (2.0 * gain < step_tol * step_tol or gain < NOISE * cost)
            move(layout, state, work, step, trial)
            new, behind = total_cost(layout, start, trial)
            if behind == 0 and new <= cost:
                ratio = (cost - new) / max(gain, 1e-300)
                _copy(trial, state)
                cost, fresh, growth, refused = new, True, 2.0, 0
                damping = max(damping * max(1.0 / 9.0, 1.0 - (2.0 * ratio - 1.0) ** 3), DAMPING_MIN)
            if near and behind == 0:
                return CONVERGED, iteration + 1
            if fresh:
                continue
            refused += behind > 0
            if refused >= BEHIND_PATIENCE:
                drop_behind(layout, trial)
                cost, _ = total_cost(layout, start, state)
                refused, fresh = 0, True
                continue
        damping *= growth
        growth *= 2.0
        if damping > DAMPING_MAX:
            return UNFINISHED, iteration + 1
    return UNFINISHED, iterations_max
