"""From the whole model down: all smooth effects are fitted at once, then the best set is chosen and refined in turn."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.errors import DiagnosisError
from diagnosis.search.candidates import Candidate
from diagnosis.search.cell import Cell
from diagnosis.search.fit import STEP_SHARE, Fit, costs, evaluated_at, weights
from diagnosis.whole_model.linear import Linearised, Term, linearised, packed
from diagnosis.whole_model.subsets import (
    LinearProblem,
    Members,
    SetPosterior,
    best_set,
    best_set_without,
    posterior_over_sets,
)
from machine.rotations import Array

ROUNDS = 6
STEPS = 6  # of Gauss-Newton between two choices
SHARES = (1.0, 0.5, 0.2, 0.05)  # of a step that are tried
SETTLED_NATS = 0.05
CLEAR_NATS = 50.0  # by the linear model: nobody refits a set that is so much worse


@dataclass(frozen=True, slots=True)
class Fitted:
    """A set of effects at its best numbers: every term of the library with its state, columns, and the log posterior
    of the set [nats, up to a constant of the part].
    """

    lin: Linearised
    problem: LinearProblem
    score: float

    @property
    def terms(self) -> tuple[Term, ...]:
        """The library's terms as they stand."""
        return self.lin.terms

    @property
    def present(self) -> Members:
        """Which terms are present (terms,)."""
        return self.lin.present


@dataclass(frozen=True, slots=True)
class WholeFit:
    """The best set of one part with its rivals and the posterior over sets about it.

    `trust`: (N,) how far each row speaks for itself, since what the model leaves is correlated. `rivals`: by present
    term, the best set found without it, refitted, with columns of its own terms only; None where the linear model
    leaves no doubt. `twins`: terms whose column another one has, too: (kept, left out). `settled`: whether no rival and
    no further choice was better.
    """

    cell: Cell
    best: Fitted
    posterior: SetPosterior
    trust: Array
    rivals: dict[int, Fitted | None]
    twins: tuple[tuple[int, int], ...]
    settled: bool


def solve(cell: Cell, library: tuple[Candidate, ...], start: tuple[Term, ...] = ()) -> WholeFit:
    """Fit a part by all effects of a library together, and prune. `start`: terms to begin with, in place of a library.

    Model: rounds of (columns about where the terms stand; best set of the linear model; Gauss-Newton of that set). At
           the end the best set without each term is refitted; where one of these is better, it takes the place.
    """
    trust = np.ones(cell.rows.count)
    terms = start
    if not start:
        terms = tuple(Term(effect, np.zeros(len(effect.slots)), False) for effect in library)
        terms = refined(cell, tuple(replace(term, present=term.smooth) for term in terms), trust)
    lin = linearised(cell, terms)
    twins = lin.twins()
    own = np.ones(len(terms), dtype=bool)
    own[[out for _, out in twins]] = False
    settled, rivals = False, dict[int, Fitted | None]()
    fitted: Fitted | None = None
    for _ in range(ROUNDS):
        problem = lin.problem(trust)
        best = best_set(problem, own if fitted is None else lin.present, own)
        if fitted is None or not (best == lin.present).all():
            terms = refined(cell, _chosen(lin, problem, best), trust)
            trust = trusted(cell, terms)
            tried = _fitted(cell, terms, trust)
            if fitted is None or tried.score > _score_at(fitted.lin, trust):
                fitted, lin = tried, tried.lin
                continue
        rivals = {int(k): _rival(cell, fitted, int(k), own, trust) for k in np.nonzero(fitted.present)[0]}
        better = max((one for one in rivals.values() if one is not None), key=lambda one: one.score, default=None)
        if better is None or better.score <= fitted.score + SETTLED_NATS:
            settled = True
            break
        fitted = _fitted(cell, better.terms, trust)
        lin = fitted.lin
    if fitted is None:
        raise DiagnosisError(f"{cell.label}: no round of the fit was run")
    posterior = posterior_over_sets(fitted.problem, fitted.present, own)
    return WholeFit(cell, fitted, posterior, trust, rivals, twins, settled)


def fit_of(terms: Sequence[Term], lin: Linearised | None = None) -> Fit:
    """The present terms as a plain fit, for what compares, writes or plans by one. `lin`: about them, for J."""
    some = [term for term in terms if term.present]
    theta = np.concatenate([term.theta for term in some]) if some else np.zeros(0)
    cols = np.repeat(lin.present, np.diff(lin.first)) if lin is not None else np.zeros(0, dtype=bool)
    residual = np.zeros(0) if lin is None else lin.residual
    J = np.zeros((0, len(theta))) if lin is None else lin.J[:, cols]
    effects = tuple(term.effect for term in some)
    return Fit(effects, theta, residual, J, float(costs(residual).sum()), tuple(False for _ in theta))


def _fitted(cell: Cell, terms: tuple[Term, ...], trust: Array, absent: bool = True) -> Fitted:
    lin = linearised(cell, terms, absent=absent)
    return Fitted(lin, lin.problem(trust), _score_at(lin, trust))


def _score_at(lin: Linearised, trust: Array) -> float:
    """Log posterior of the present set where it stands: Laplace, with the costs as they are [nats]."""
    problem, members = lin.problem(trust), lin.present
    cols = np.repeat(members, np.diff(lin.first))
    x, slab = lin.x[cols], problem.slab[cols]
    A = np.eye(len(x)) + slab[:, None] * problem.H[np.ix_(cols, cols)] * slab
    prior = float(problem.log_odds[members].sum()) - 0.5 * float(((x / slab) ** 2).sum())
    return prior - float((costs(lin.residual) * trust).sum()) - 0.5 * float(np.linalg.slogdet(A)[1])


def _rival(cell: Cell, fitted: Fitted, term: int, own: Members, trust: Array) -> Fitted | None:
    """The best set without a present term, refitted; None where the linear model is sure that it is far worse."""
    problem = fitted.problem
    members = best_set_without(problem, fitted.present, term, own)
    if problem.score(fitted.present) - problem.score(members) > CLEAR_NATS:
        return None
    return _fitted(cell, refined(cell, _chosen(fitted.lin, problem, members), trust), trust, absent=False)


def _chosen(lin: Linearised, problem: LinearProblem, members: Members) -> tuple[Term, ...]:
    """The terms with the sizes that the linear model gives to a set's members; present thresholds and shapes stay."""
    x, _ = problem.estimate(members)
    out = []
    for k, term in enumerate(lin.terms):
        theta = term.theta.copy()
        if members[k] and not term.limits and (term.smooth or not term.present):
            theta[: term.sizes] = x[lin.first[k] : lin.first[k] + term.sizes]
        out.append(Term(term.effect, _bounded(term, theta), bool(members[k])))
    return tuple(out)


def _bounded(term: Term, theta: Array) -> Array:
    low = np.array([slot.low for slot in term.effect.slots])
    high = np.array([slot.highest for slot in term.effect.slots])
    inside = np.clip(theta, low, high)
    return inside if term.present or not term.limits else theta


def refined(cell: Cell, terms: tuple[Term, ...], trust: Array) -> tuple[Term, ...]:
    """Gauss-Newton of the present terms under their priors, from where they stand."""
    some = [k for k, term in enumerate(terms) if term.present]
    own = tuple(terms[k] for k in some)
    for _ in range(STEPS if own else 0):
        lin = linearised(cell, own, to_move=True)
        problem = lin.problem(trust)
        now = np.concatenate([term.theta for term in own])
        x = problem.estimate(np.ones(len(own), dtype=bool))[0]
        moved = np.split(now + x - lin.x, np.cumsum([len(term.theta) for term in own])[:-1])
        target = np.concatenate([_bounded(term, theta) for term, theta in zip(own, moved, strict=True)])
        trials = now + np.array((*SHARES, 0.0))[:, None] * (target - now)
        left = evaluated_at(cell, packed(cell, own, trials))
        sizes = np.concatenate([np.arange(len(term.theta)) < term.sizes for term in own])
        limit = np.concatenate([np.full(len(term.theta), term.limits) for term in own]) & sizes
        off = np.where(limit, 0.0, trials - np.where(sizes, 0.0, now)) / problem.slab
        totals = (costs(left) * trust).sum(axis=1) + 0.5 * (off**2).sum(axis=1)
        best = int(np.argmin(totals))
        ends = np.cumsum([len(term.theta) for term in own])[:-1]
        own = tuple(replace(term, theta=row) for term, row in zip(own, np.split(trials[best], ends), strict=True))
        if totals[-1] - totals[best] < SETTLED_NATS:
            break
    by_number = dict(zip(some, (replace(term, present=not _vanished(term)) for term in own), strict=True))
    return tuple(by_number.get(k, term) for k, term in enumerate(terms))


def _vanished(term: Term) -> bool:
    """Whether a size that cannot be negative ended at nothing."""
    slot = term.effect.slots[0]
    return not term.limits and slot.low >= 0.0 and float(term.theta[0]) <= STEP_SHARE * slot.start


def trusted(cell: Cell, terms: tuple[Term, ...]) -> Array:
    """How far each row speaks for itself (N,), from what the present terms leave.

    Model:  per part, k / tr(H^-1 K), H = J'J, K the sum over blocks of the blocks' scores squared: the size by which a
            working likelihood of independent rows has to be scaled so that its mean drop is that of the true one.
    Source: Pauli, Racugno, Ventura 2011, eq. 2.4 (magnitude adjustment of a composite likelihood).
    """
    lin = linearised(cell, tuple(term for term in terms if term.present))
    out, start = np.ones(len(lin.residual)), 0
    for part in cell.parts or (cell,):
        own = slice(start, start + part.rows.count)
        start += part.rows.count
        out[own] = _magnitude(lin.J[own], lin.residual[own], part.rows.block)
    return out


def _magnitude(J: Array, residual: Array, block: NDArray[np.int64]) -> float:
    w = weights(residual)
    spread = float((w * residual**2).sum() / max(1, len(residual) - J.shape[1]))
    norm = np.sqrt((J**2).sum(axis=0))
    J = J[:, norm > 0.0] / norm[norm > 0.0]
    if J.shape[1] == 0:
        return 1.0 / max(1.0, spread)
    U, s, _ = np.linalg.svd(J * np.sqrt(w)[:, None], full_matrices=False)
    Q = U[:, s > 1e-6 * s[0]]
    scores = np.zeros((int(block.max()) + 1, Q.shape[1]))
    np.add.at(scores, block, Q * (np.sqrt(w) * residual)[:, None])
    K = float((scores**2).sum()) * len(scores) / max(1.0, len(scores) - 1.0)
    return min(1.0, Q.shape[1] / max(K, 1e-12), 1.0 / max(1.0, spread))
