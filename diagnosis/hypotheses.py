"""Sets of effects that a recording leaves open, the most probable first, until they hold 90 %."""

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.search.candidates import Candidate
from diagnosis.verdict import EffectLine
from diagnosis.whole_model.evidence import NORMAL_QUANTILE_95
from diagnosis.whole_model.linear import EffectTerm
from diagnosis.whole_model.solve import WholeFit
from machine.rotations import Array

LISTED_PROBABILITY_SUM = 0.9  # probability that the sets hold together
LISTED_HYPOTHESES_MAX = 20  # sets that are listed
CHANGE_ODDS_MAX = 1.0 - 1e-9  # the largest odds of a change against what stands
SizedEffect = tuple[Candidate, Array]  # an effect with its numbers (slots, 3): value and 90 % limits


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Effects that are there together, and how probable that is."""

    effects: tuple[SizedEffect, ...]
    probability: float


@dataclass(frozen=True, slots=True)
class _HypothesisChange:
    """What differs from the effects that are more likely there than not, and its odds against them (0 to 1)."""

    odds: float
    removed_effects: tuple[tuple[str, int | None], ...]
    added_effects: tuple[SizedEffect, ...]


def hypotheses_of(lines: Sequence[EffectLine], fits: Sequence[WholeFit]) -> list[Hypothesis]:
    """The effects that are more likely there than not, and what may be there instead or besides.

    Model: changes are independent. An effect of the budget may be absent, or its best rival in its place, by its
           probability; each other effect of the catalogue may be there, by the posterior odds of the best set with it.
    """
    likely = [sized_effect_of_line(line) for line in lines if line.status != "doubtful"]
    changes = sorted((*_of_lines(lines, fits), *_absent_effect_changes(fits)), key=lambda change: -change.odds)
    standing = float(np.prod([1.0 / (1.0 + change.odds) for change in changes]))
    out: list[Hypothesis] = []
    for odds, chosen in _in_order(changes):
        gone = {key for change in chosen for key in change.removed_effects}
        into = [effect for change in chosen for effect in change.added_effects]
        known = [effect for effect in likely if effect[0].effect_and_joint not in gone]
        keys = [effect[0].effect_and_joint for effect in (*known, *into)]
        if len(set(keys)) == len(keys):
            out.append(Hypothesis((*known, *into), standing * odds))
        if len(out) == LISTED_HYPOTHESES_MAX or sum(listed.probability for listed in out) >= LISTED_PROBABILITY_SUM:
            break
    return out


def sized_effect_of_line(line: EffectLine) -> SizedEffect:
    """The effect of a line with its numbers."""
    return _sized_effect(line.evidence.effect_term, *line.evidence.limits)


def _sized_effect(term: EffectTerm, low: Array, high: Array) -> SizedEffect:
    return term.effect, np.stack([term.theta, low, high], axis=1)


def _of_lines(lines: Sequence[EffectLine], fits: Sequence[WholeFit]) -> Iterator[_HypothesisChange]:
    for line in lines:
        term, p = line.evidence.effect_term, min(line.probability, CHANGE_ODDS_MAX)
        if line.status == "doubtful":
            yield _HypothesisChange(p / (1.0 - p), (), (sized_effect_of_line(line),))
        else:
            yield _HypothesisChange(
                min((1.0 - p) / p, CHANGE_ODDS_MAX), (term.effect.effect_and_joint,), _replacing_effects(term, fits)
            )


def _replacing_effects(term: EffectTerm, fits: Sequence[WholeFit]) -> tuple[SizedEffect, ...]:
    """What enters in the place of an effect of the best set where it is left out."""
    for fit in fits:
        for k, rival in fit.rival_fit_by_term.items():
            if fit.best_fit.current_terms[k] is term and rival is not None:
                entered = np.nonzero(rival.present_terms & ~fit.best_fit.present_terms)[0]
                return tuple(
                    _sized_effect(rival.current_terms[t], rival.current_terms[t].theta, rival.current_terms[t].theta)
                    for t in entered
                )
    return ()


def _absent_effect_changes(fits: Sequence[WholeFit]) -> Iterator[_HypothesisChange]:
    """Every absent effect, by the linear model of its part."""
    for fit in fits:
        problem, present, first = (
            fit.best_fit.subset_problem,
            fit.best_fit.present_terms,
            fit.best_fit.linear_model.term_first_column,
        )
        twins = {out for _, out in fit.collinear_term_pairs}
        score = problem.score(present)
        for k, term in enumerate(fit.best_fit.current_terms):
            if present[k] or k in twins or term.limits:
                continue
            members = present.copy()
            members[k] = True
            x, S = problem.estimate(members)
            own = slice(first[k], first[k] + term.size_count)
            theta, half = term.theta.copy(), np.zeros_like(term.theta)
            theta[: term.size_count], half[: term.size_count] = x[own], NORMAL_QUANTILE_95 * np.sqrt(np.diag(S)[own])
            odds = min(float(np.exp(min(problem.score(members) - score, 0.0))), CHANGE_ODDS_MAX)
            yield _HypothesisChange(odds, (), ((term.effect, np.stack([theta, theta - half, theta + half], axis=1)),))


def _in_order(changes: Sequence[_HypothesisChange]) -> Iterator[tuple[float, tuple[_HypothesisChange, ...]]]:
    """Sets of changes with the product of their odds, largest first; changes come sorted by theirs."""
    costs = [-float(np.log(max(change.odds, 1e-300))) for change in changes]
    yield 1.0, ()
    waiting: list[tuple[float, tuple[int, ...]]] = [(costs[0], (0,))] if costs else []
    while waiting:
        cost, chosen = heapq.heappop(waiting)
        yield float(np.exp(-cost)), tuple(changes[k] for k in chosen)
        following = chosen[-1] + 1
        if following < len(costs):
            heapq.heappush(waiting, (cost + costs[following], (*chosen, following)))
            heapq.heappush(waiting, (cost + costs[following] - costs[chosen[-1]], (*chosen[:-1], following)))
