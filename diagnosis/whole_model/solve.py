"""From the whole model down: all smooth effects are fitted together, then the best set is chosen and refined."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.search.candidates import Candidate
from diagnosis.search.cell import Cell
from diagnosis.search.fit import Fit, evaluated_at, soft_l1_costs, soft_l1_weights
from diagnosis.whole_model.linear import EffectTerm, LinearModel, linearise_terms, pack_terms
from diagnosis.whole_model.refine import CONVERGENCE_NATS, bounded, refine_present_terms
from diagnosis.whole_model.subsets import (
    LinearProblem,
    Members,
    best_addition,
    best_set,
    best_set_without,
)
from machine.effects.layout import ParameterSets
from machine.rotations import Array

MAX_ITERATIONS = 6
NOISE_STALL_RATIO = 0.9  # of the noise: a round that lowers it less ends the approach
REFIT_SCORE_DEFICIT_MAX_NATS = 50.0  # by the linear model: a set that is so much worse is not refitted


@dataclass(frozen=True, slots=True)
class Fitted:
    """A set of effects at its best numbers: every term of the library with its state, columns, and the log posterior
    of the set [nats, up to a constant of the part].
    """

    linear_model: LinearModel
    subset_problem: LinearProblem
    log_posterior_nats: float

    @property
    def current_terms(self) -> tuple[EffectTerm, ...]:
        """The library's terms as they stand."""
        return self.linear_model.effect_terms

    @property
    def present_terms(self) -> Members:
        """Which terms are present (terms,)."""
        return self.linear_model.present_terms


@dataclass(frozen=True, slots=True)
class WholeFit:
    """The best set of one part with its rivals.

    `correlation_weight`: (N,) how far each row speaks for itself, since what the model leaves is correlated.
    `rival_fit_by_term`: by present term, the best set found without it, refitted, with columns of its own terms only;
    None where the linear model leaves no doubt. `collinear_term_pairs`: terms whose column another one has, too: (kept,
    left out). `converged`: whether no rival and no further choice was better.
    """

    cell: Cell
    best_fit: Fitted
    correlation_weight: Array
    rival_fit_by_term: dict[int, Fitted | None]
    collinear_term_pairs: tuple[tuple[int, int], ...]
    converged: bool


def fit_and_prune(cell: Cell, library: tuple[Candidate, ...], start: tuple[EffectTerm, ...] = ()) -> WholeFit:
    """Fit a part by all effects of a library together, and prune. `start`: terms to begin with, in place of a library.

    Model: rounds of (columns about where the terms stand; best set of the linear model; Gauss-Newton of that set). At
           the end the best set without each term is refitted; where one of these is better, it takes the place.
    """
    terms = start or tuple(EffectTerm(effect, np.zeros(len(effect.parameter_slots)), False) for effect in library)
    twins = _equivalent_term_pairs(cell, terms)
    own = np.ones(len(terms), dtype=bool)
    own[[out for _, out in twins]] = False
    terms = start or _fit_by_graduated_noise(cell, terms, own)
    trust = trusted_rows(cell, terms)
    fitted = _linearised_fit(cell, terms, trust)
    if not start:
        fitted, trust = _grow_from_empty_set(cell, fitted, trust, own)
    settled, rivals = False, dict[int, Fitted | None]()
    for _ in range(MAX_ITERATIONS):
        problem = fitted.subset_problem
        best = best_set(problem, fitted.present_terms, own)
        if not (best == fitted.present_terms).all():
            fitted, trust, changed = _accept_if_better(cell, fitted, trust, fitted.linear_model, best)
            if changed:
                continue
        columns = _tangent_columns(cell, fitted)
        rivals = {
            int(k): _refit_without_term(cell, fitted, int(k), own, trust, columns)
            for k in np.nonzero(fitted.present_terms)[0]
        }
        better = max(
            (rival for rival in rivals.values() if rival is not None),
            key=lambda one: one.log_posterior_nats,
            default=None,
        )
        if better is None or better.log_posterior_nats <= fitted.log_posterior_nats + CONVERGENCE_NATS:
            settled = True
            break
        fitted = _linearised_fit(cell, better.current_terms, trust)
    return WholeFit(cell, fitted, trust, rivals, twins, settled)


def _grow_from_empty_set(cell: Cell, fitted: Fitted, trust: Array, own: Members) -> tuple[Fitted, Array]:
    """The best set from nothing upwards, where it is better than the one at hand; else that one.

    Why: a shape (an oscillation's period) may be seen only while little else is there. Given a baseline, one or two
    changes are expected, and the whole model may settle on several small ones in place of one with a narrow optimum:
    then effects enter one at a time, each refitted before the next.
    """
    terms = tuple(replace(term, is_present=False) for term in fitted.current_terms)
    own_trust = trusted_rows(cell, terms)
    grown = _linearised_fit(cell, terms, own_trust)
    if cell.baseline_gain_nats is None:
        even = grown.linear_model.choice_problem(np.ones(cell.rows.row_count))
        return _accept_if_better(cell, fitted, trust, grown.linear_model, best_set(even, grown.present_terms, own))[:2]
    for _ in range(int(own.sum())):
        members = best_addition(grown.subset_problem, grown.present_terms, own)
        if members is None:
            break
        grown, own_trust, better = _accept_if_better(cell, grown, own_trust, grown.linear_model, members)
        if not better:
            break
    return (
        (grown, own_trust) if grown.log_posterior_nats > score_at(fitted.linear_model, own_trust) else (fitted, trust)
    )


def _accept_if_better(
    cell: Cell, fitted: Fitted, trust: Array, lin: LinearModel, members: Members
) -> tuple[Fitted, Array, bool]:
    """The fit of another set, from columns `lin`, with its trust, where it is better by that; else the one at hand."""
    terms = refine_present_terms(cell, _terms_of_chosen_set(lin, lin.choice_problem(trust), members), trust)
    own_trust = trusted_rows(cell, terms)
    tried = _linearised_fit(cell, terms, own_trust)
    better = tried.log_posterior_nats > score_at(fitted.linear_model, own_trust)
    return (tried, own_trust, True) if better else (fitted, trust, False)


def _fit_by_graduated_noise(cell: Cell, terms: tuple[EffectTerm, ...], own: Members) -> tuple[EffectTerm, ...]:
    """The best set of the terms `own` that may enter, found from far away: all smooth effects together, then pruned.

    Model: each part's noise is taken for as large as what the terms leave of it, until that falls no more. So the
           priors hold what the data cannot distinguish, and no residual is an outlier just because nothing fits yet.
    Source: graduated non-convexity by the scale of the noise: Black, Rangarajan 1996, sec. 5.
    """
    even = np.ones(cell.rows.row_count)
    terms = tuple(replace(term, is_present=bool(term.is_smooth and own[k])) for k, term in enumerate(terms))
    left = _by_part(cell, tuple(replace(term, is_present=False) for term in terms))
    for k in range(MAX_ITERATIONS):
        near = replace(cell, whitened=_InflatedResidual(cell.whitened, left))
        terms = refine_present_terms(near, terms, even)
        lin = linearise_terms(near, terms)
        problem = lin.choice_problem(even)
        terms = refine_present_terms(
            near, _terms_of_chosen_set(lin, problem, best_set(problem, own if k == 0 else lin.present_terms, own)), even
        )
        before, left = left, _by_part(cell, terms)
        if (left > NOISE_STALL_RATIO * before).all():
            break
    return terms


@dataclass(frozen=True, slots=True)
class _InflatedResidual:
    """Residuals by a noise that is larger by `noise_ratio` (N,)."""

    whitened: Callable[[ParameterSets], Array]
    noise_ratio: Array

    def __call__(self, sets: ParameterSets) -> Array:
        return np.asarray(self.whitened(sets) / self.noise_ratio, dtype=float)


def _by_part(cell: Cell, terms: tuple[EffectTerm, ...]) -> Array:
    """By how much what terms leave exceeds the noise, of each row's part (N,), at least 1."""
    residual = evaluated_at(cell, pack_terms(cell, terms))[0]
    return np.concatenate(
        [np.full(len(own), max(1.0, float(np.sqrt(np.mean(own**2))))) for _, own in cell.by_part(residual)]
    )


def _equivalent_term_pairs(cell: Cell, terms: tuple[EffectTerm, ...]) -> tuple[tuple[int, int], ...]:
    """Pairs of smooth terms that do the same where both are absent: the one kept, and the one it stands for."""
    smooth = [k for k, term in enumerate(terms) if term.is_smooth]
    absent = tuple(replace(terms[k], theta=np.zeros_like(terms[k].theta), is_present=False) for k in smooth)
    return tuple((smooth[kept], smooth[out]) for kept, out in linearise_terms(cell, absent).twin_pairs())


def fit_of(terms: Sequence[EffectTerm], lin: LinearModel | None = None) -> Fit:
    """The present terms as a plain fit, for what compares, writes or plans by one. `lin`: about them, for J."""
    some = [term for term in terms if term.is_present]
    theta = np.concatenate([term.theta for term in some]) if some else np.zeros(0)
    cols = np.repeat(lin.present_terms, np.diff(lin.term_first_column)) if lin is not None else np.zeros(0, dtype=bool)
    residual = np.zeros(0) if lin is None else lin.residual
    J = np.zeros((0, len(theta))) if lin is None else lin.J[:, cols]
    effects = tuple(term.effect for term in some)
    return Fit(effects, theta, residual, J, float(soft_l1_costs(residual).sum()))


def refit_terms(fit: WholeFit, terms: Sequence[EffectTerm]) -> tuple[EffectTerm, ...]:
    """Some present terms of a fit (the same objects), fitted again as if nothing else were there."""
    kept = {id(term) for term in terms}
    whole = all(id(term) in kept for term in fit.best_fit.current_terms if term.is_present)
    return tuple(term for term in (fit.best_fit.current_terms if whole else _with_only(fit, terms)) if term.is_present)


def refit_reduced(fit: WholeFit, terms: Sequence[EffectTerm]) -> WholeFit:
    """A fit with some of its present terms only, fitted again, trusted as far as what they leave allows."""
    return _standing_at(fit, _with_only(fit, terms))


def refit_with_exchanged_term(fit: WholeFit, term: EffectTerm, others: Sequence[EffectTerm]) -> WholeFit:
    """A fit with other terms of its library in the place of a present one, fitted again."""
    entering = {id(other) for other in others}
    members = np.array(
        [(mine.is_present and mine is not term) or id(mine) in entering for mine in fit.best_fit.current_terms]
    )
    chosen = _terms_of_chosen_set(fit.best_fit.linear_model, fit.best_fit.subset_problem, members)
    return _standing_at(fit, refine_present_terms(fit.cell, chosen, fit.correlation_weight))


def _standing_at(fit: WholeFit, terms: tuple[EffectTerm, ...]) -> WholeFit:
    trust = trusted_rows(fit.cell, terms)
    return replace(
        fit, best_fit=_linearised_fit(fit.cell, terms, trust), correlation_weight=trust, rival_fit_by_term={}
    )


def _with_only(fit: WholeFit, terms: Sequence[EffectTerm]) -> tuple[EffectTerm, ...]:
    kept = {id(term) for term in terms}
    some = tuple(replace(term, is_present=id(term) in kept) for term in fit.best_fit.current_terms)
    return refine_present_terms(fit.cell, some, fit.correlation_weight)


def _linearised_fit(cell: Cell, terms: tuple[EffectTerm, ...], trust: Array, absent: bool = True) -> Fitted:
    lin = linearise_terms(cell, terms, absent=absent)
    return Fitted(lin, lin.choice_problem(trust), score_at(lin, trust))


def score_at(lin: LinearModel, trust: Array) -> float:
    """Log posterior of the present set where it stands: Laplace, with the costs as they are [nats]."""
    problem, members = lin.choice_problem(trust), lin.present_terms
    cols = np.repeat(members, np.diff(lin.term_first_column))
    x, slab = lin.parameter_offsets[cols], problem.prior_sigma[cols]
    A = np.eye(len(x)) + slab[:, None] * problem.normal_matrix[np.ix_(cols, cols)] * slab
    prior = float(problem.log_odds[members].sum()) - 0.5 * float(((x / slab) ** 2).sum())
    return prior - float((soft_l1_costs(lin.residual) * trust).sum()) - 0.5 * float(np.linalg.slogdet(A)[1])


def _refit_without_term(
    cell: Cell, fitted: Fitted, term: int, own: Members, trust: Array, columns: dict[int, Array]
) -> Fitted | None:
    """The best set without a present term, refitted; None where the linear model is sure that it is far worse.

    `columns`: tangents of the best set's terms; those that enter have theirs in its linear model.
    """
    problem = fitted.subset_problem
    members = best_set_without(problem, fitted.present_terms, term, own)
    if problem.score(fitted.present_terms) - problem.score(members) > REFIT_SCORE_DEFICIT_MAX_NATS:
        return None
    chosen = _terms_of_chosen_set(fitted.linear_model, problem, members)
    entering = {
        k: fitted.linear_model.columns(k)
        for k, chosen_term in enumerate(chosen)
        if chosen_term.is_present and k not in columns
    }
    short = [k for k, J in entering.items() if J.shape[1] < len(chosen[k].theta)]  # shapes have no column while absent
    given = None if short else {**columns, **entering}
    return _linearised_fit(cell, refine_present_terms(cell, chosen, trust, given), trust, absent=False)


def _tangent_columns(cell: Cell, fitted: Fitted) -> dict[int, Array]:
    some = [k for k, term in enumerate(fitted.current_terms) if term.is_present]
    lin = linearise_terms(cell, tuple(fitted.current_terms[k] for k in some), to_move=True)
    return {k: lin.columns(at) for at, k in enumerate(some)}


def _terms_of_chosen_set(lin: LinearModel, problem: LinearProblem, members: Members) -> tuple[EffectTerm, ...]:
    """The terms with the sizes that the linear model gives to a set's members; present thresholds and shapes stay, and
    what is limited or narrow enters as it was scanned.
    """
    x, _ = problem.estimate(members)
    out = []
    for k, term in enumerate(lin.effect_terms):
        theta = term.theta.copy()
        scanned = term.limits or term.effect.has_narrow_minimum
        if members[k] and not scanned and (term.is_smooth or not term.is_present):
            theta[: term.size_count] = x[lin.term_first_column[k] : lin.term_first_column[k] + term.size_count]
        out.append(EffectTerm(term.effect, bounded(term, theta), bool(members[k])))
    return tuple(out)


def trusted_rows(cell: Cell, terms: tuple[EffectTerm, ...]) -> Array:
    """How far each row speaks for itself (N,), from what the present terms leave.

    Model:  per part, k / tr(H^-1 K), H = J'J, K the sum over blocks of the blocks' scores squared: the size by which a
            working likelihood of independent rows has to be scaled so that its mean drop is that of the true one.
    Source: Pauli, Racugno, Ventura 2011, eq. 2.4 (magnitude adjustment of a composite likelihood).
    """
    lin = linearise_terms(cell, tuple(term for term in terms if term.is_present))
    out, start = np.ones(len(lin.residual)), 0
    for part in cell.joined_cells or (cell,):
        own = slice(start, start + part.rows.row_count)
        start += part.rows.row_count
        out[own] = _magnitude_adjustment(lin.J[own], lin.residual[own], part.rows.dependent_rows)
    return out


def _magnitude_adjustment(J: Array, residual: Array, block: NDArray[np.int64]) -> float:
    w = soft_l1_weights(residual)
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
