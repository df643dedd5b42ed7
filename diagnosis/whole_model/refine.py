"""Gauss-Newton of the present effects of a set, under their priors and within their ranges."""

from dataclasses import replace

import numpy as np

from diagnosis.search.cell import Cell
from diagnosis.search.fit import FINITE_DIFFERENCE_STEP_FRAC, evaluated_at, soft_l1_costs
from diagnosis.whole_model.linear import EffectTerm, LinearModel, linear_model_from_columns, linearise_terms, pack_terms
from machine.rotations import Array

MAX_GAUSS_NEWTON_STEPS = 10  # of Gauss-Newton between two choices
COST_TOLERANCE_NATS = 0.5  # a step that gains less by tangents that were kept is followed by one of fresh ones
TRIAL_STEP_FRACS = (1.0, 0.5, 0.2, 0.05)  # of a step that are tried
CONVERGENCE_NATS = 0.05
DELAY_SEARCH_CYCLES = 10  # of a PLC, to either side of a delay that a fit ended at


def refine_present_terms(
    cell: Cell, terms: tuple[EffectTerm, ...], trust: Array, columns: dict[int, Array] | None = None
) -> tuple[EffectTerm, ...]:
    """Gauss-Newton of the present terms under their priors, from where they stand.

    Args:  columns: by term, its tangents where the terms stood nearby; without them they are computed.
    Model: tangents are kept while full steps by them help (chord method); the last step is by fresh ones.
    """
    some = [k for k, term in enumerate(terms) if term.is_present]
    own = tuple(terms[k] for k in some)
    if not own:
        return terms
    fresh = columns is None
    lin = (
        linearise_terms(cell, own, to_move=True)
        if columns is None
        else linear_model_from_columns(cell, own, [columns[k] for k in some])
    )
    total = _total_cost(lin, trust)
    for _ in range(MAX_GAUSS_NEWTON_STEPS):
        moved = _best_gauss_newton_step(cell, lin, trust, TRIAL_STEP_FRACS if fresh else (1.0,), total)
        gained = 0.0
        if moved is not None:
            gained, (lin, total) = total - moved[1], moved
        if fresh and gained <= CONVERGENCE_NATS:
            break
        if columns is not None and gained > COST_TOLERANCE_NATS:
            fresh = False
        else:
            lin, fresh = linearise_terms(cell, lin.effect_terms, to_move=True), True
    moved = _at_whole_cycles(cell, lin, trust)
    if _total_cost(moved, trust) < total - COST_TOLERANCE_NATS:
        whole_cycles = dict(zip(some, moved.effect_terms, strict=True))
        return refine_present_terms(cell, tuple(whole_cycles.get(k, term) for k, term in enumerate(terms)), trust)
    lin = moved
    by_number = dict(
        zip(some, (replace(term, is_present=not _has_size_vanished(term)) for term in lin.effect_terms), strict=True)
    )
    return tuple(by_number.get(k, term) for k, term in enumerate(terms))


def _best_gauss_newton_step(
    cell: Cell, lin: LinearModel, trust: Array, shares: tuple[float, ...], total: float
) -> tuple[LinearModel, float] | None:
    """The best of some shares of a Gauss-Newton step, with its total; None where none of them helps."""
    own = lin.effect_terms
    now = np.concatenate([term.theta for term in own])
    x = lin.choice_problem(trust).estimate(np.ones(len(own), dtype=bool))[0]
    ends = np.cumsum([len(term.theta) for term in own])[:-1]
    moved = np.split(now + x - lin.parameter_offsets, ends)
    target = np.concatenate([bounded(term, theta) for term, theta in zip(own, moved, strict=True)])
    trials = now + np.array(shares)[:, None] * (target - now)
    tried = []
    for row, left in zip(trials, evaluated_at(cell, pack_terms(cell, own, trials)), strict=True):
        there = tuple(replace(term, theta=theta) for term, theta in zip(own, np.split(row, ends), strict=True))
        one = lin.relinearised_at(there, left)
        tried.append((_total_cost(one, trust), one))
    best, at = min(tried, key=lambda pair: pair[0])
    return (at, best) if best < total else None


def _at_whole_cycles(cell: Cell, lin: LinearModel, trust: Array) -> LinearModel:
    """The terms with every delay in the middle of those whole PLC cycles near it that fit best; at none if that is
    one of them.
    """
    for k, term in enumerate(lin.effect_terms):
        if term.effect.cycle_and_delay_s is not None:
            run = alike_delays(cell, lin, k, trust)
            theta = run[0] if run[0, 0] == term.absent_size else run[len(run) // 2]
            terms = tuple(other if j != k else replace(term, theta=theta) for j, other in enumerate(lin.effect_terms))
            lin = lin.relinearised_at(terms, evaluated_at(cell, pack_terms(cell, terms))[0])
    return lin


def alike_delays(cell: Cell, lin: LinearModel, k: int, trust: Array) -> Array:
    """Whole PLC cycles (m, 1) near a present delay, term k, that fit best and alike [s].

    Why: what arrives is taken over at the next cycle and logged with the next row, so the cost is a staircase, which no
    gradient crosses, and any delay on one tread is as good as any other.
    """
    term = lin.effect_terms[k]
    cycle_s = (term.effect.cycle_and_delay_s or (0.0, 0.0))[0]
    near = (
        term.effect.with_whole_delay(term.theta)
        + cycle_s * np.arange(-DELAY_SEARCH_CYCLES, DELAY_SEARCH_CYCLES + 1)[:, None]
    )
    tried = np.unique([bounded(term, theta) for theta in near], axis=0)
    sets = [
        tuple(other if j != k else replace(term, theta=theta) for j, other in enumerate(lin.effect_terms))
        for theta in tried
    ]
    thetas = np.array([np.concatenate([term.theta for term in terms]) for terms in sets])
    left = evaluated_at(cell, pack_terms(cell, lin.effect_terms, thetas))
    totals = np.array(
        [_total_cost(lin.relinearised_at(terms, residual), trust) for terms, residual in zip(sets, left, strict=True)]
    )
    alike, best = totals < totals.min() + COST_TOLERANCE_NATS, int(np.argmin(totals))
    first = best - int(np.argmin(alike[best::-1])) + 1 if not alike[: best + 1].all() else 0
    end = best + int(np.argmin(alike[best:])) if not alike[best:].all() else len(tried)
    return tried[first:end]


def _total_cost(lin: LinearModel, trust: Array) -> float:
    """Costs and priors of the terms as they stand, of columns to move by [nats]."""
    return float(
        (soft_l1_costs(lin.residual) * trust).sum() + 0.5 * ((lin.parameter_offsets / lin.prior_deviations) ** 2).sum()
    )


def bounded(term: EffectTerm, theta: Array) -> Array:
    """A term's numbers (k,) inside their ranges; an absent term that has only limits is left as it was scanned."""
    low = np.array([slot.lower_bound for slot in term.effect.parameter_slots])
    high = np.array([slot.upper_bound for slot in term.effect.parameter_slots])
    inside = np.clip(theta, low, high)
    return inside if term.is_present or not term.limits else theta


def _has_size_vanished(term: EffectTerm) -> bool:
    """Whether a size that cannot be negative ended at nothing."""
    slot = term.effect.parameter_slots[0]
    return (
        not term.limits
        and slot.lower_bound >= 0.0
        and float(term.theta[0]) <= FINITE_DIFFERENCE_STEP_FRAC * slot.start_value
    )
