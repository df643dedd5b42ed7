"""The evidence of each effect of the best set: gain, size against its uncertainty, invariance, rivals, remainder."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from diagnosis.search.cell import Cell
from diagnosis.search.fit import soft_l1_costs
from diagnosis.whole_model.linear import EffectTerm, linearise_terms
from diagnosis.whole_model.refine import alike_delays
from diagnosis.whole_model.solve import Fitted, WholeFit
from diagnosis.whole_model.subsets import best_set
from machine.rotations import Array

NORMAL_QUANTILE_95 = 1.6448536269514722
DETECTION_LIMIT_SIGMAS = 3.3354  # deviations: found with 90 % probability at 2 % false alarms
SCATTER_FALSE_ALARM_RATE = 0.05  # share of the causes of one size that are said to scatter
RANK_TOLERANCE_FRAC = 1e-6  # of the largest power: below, columns of finite steps are the same to rounding
QUARTERS, HALVES = (0.25, 0.5, 0.75), (0.5,)
SUBSTITUTE_TERMS_MAX = 4  # terms in whose place an effect may stand: a longer list is of no use
DISTINCT_SQUARED_DISTANCE_MIN = 9.0  # least squared distance below which two sets are not distinguished (contract)


@dataclass(frozen=True, slots=True)
class Evidence:
    """What speaks for one effect of the best set of its part.

    `gain_nats`: what the best set without it and its equals loses. `parameter_sd`: (slots,) of its numbers, with what
    its definition leaves open. `size_z_score`: its size over that. `size_scatter_frac`: by what share its size differs
    between kinds of motion, times, amplitudes or postures, beyond noise; a cause has one size.
    `equivalent_effect_sets`: sets of effects that take its place at a distance T below 9. `residual_mean_square`: of
    its part in noise floors. `noise_known`: from repeats or stated accuracy.
    `explained_frac`: what it alone explains, as a share of that and what its part leaves beyond noise.
    `full_model_z_score`: its size over its deviation with every effect of the part in the model; with its equals if
    they share it. `prior_nats`: with a baseline its prior log odds, of which the gain is the rest; else None.
    `full_model_limits`: (sizes, 2) 90 % in that model of sizes that the data do not determine by themselves, or None.
    """

    effect_term: EffectTerm
    part_label: str
    gain_nats: float
    parameter_sd: Array
    size_z_score: float
    size_scatter_frac: float
    equivalent_effect_sets: tuple[tuple[EffectTerm, ...], ...]
    residual_mean_square: float
    explained_frac: float
    noise_known: bool
    full_model_z_score: float
    prior_nats: float | None
    full_model_limits: Array | None

    @property
    def size_sd(self) -> Array:
        """Standard deviations of its sizes (sizes,) by its limits, where the data do not determine it by itself."""
        sd = self.parameter_sd[: self.effect_term.size_count]
        return (
            sd
            if self.full_model_limits is None
            else np.maximum(sd, 0.5 * np.ptp(self.full_model_limits, axis=1) / NORMAL_QUANTILE_95)
        )

    @property
    def limits(self) -> tuple[Array, Array]:
        """90 % limits of its numbers (slots,)."""
        slots = self.effect_term.effect.parameter_slots
        half = NORMAL_QUANTILE_95 * self.parameter_sd
        least, most = self.effect_term.theta - half, self.effect_term.theta + half
        if self.effect_term.effect.share_sample_count:
            return least, most
        if self.full_model_limits is not None:
            own = slice(0, len(self.full_model_limits))
            least[own], most[own] = (
                np.minimum(least[own], self.full_model_limits[:, 0]),
                np.maximum(most[own], self.full_model_limits[:, 1]),
            )
        low, high = np.array([slot.lower_bound for slot in slots]), np.array([slot.upper_bound for slot in slots])
        return np.maximum(least, low), np.minimum(most, high)


def evidence_of(fit: WholeFit) -> tuple[Evidence, ...]:
    """The evidence of every present effect of a part.

    Why tangents, of thresholds, too: deviations and the score test belong to the slope at the best numbers. The secant
    back to absence, by which a set is judged, has a score of its own there.
    """
    best = fit.best_fit
    present = np.nonzero(best.present_terms)[0]
    if not len(present):
        return ()
    lin = linearise_terms(fit.cell, tuple(best.current_terms[k] for k in present), to_move=True)
    w = lin.robust_weight * fit.correlation_weight
    J, residual = lin.J * np.sqrt(w)[:, None], lin.residual * np.sqrt(w)
    spread = standard_deviations(J, residual, lin.prior_deviations, fit.cell.rows.dependent_rows)
    left = float(np.mean(lin.robust_weight * lin.residual**2))
    S = np.asarray(
        np.linalg.inv((lin.J * lin.robust_weight[:, None]).T @ lin.J + np.diag(lin.prior_deviations**-2.0)), dtype=float
    )
    groupings = groupings_of(fit.cell)
    everything = _with_everything(fit)
    out = []
    for term, k, own in zip(
        lin.effect_terms, present, np.split(np.arange(J.shape[1]), lin.term_first_column[1:-1]), strict=True
    ):
        sd = _with_open(term, spread[own])
        if term.effect.share_sample_count:  # a share, seen among so many
            share = float(term.theta[0])
            sd[0] = np.sqrt(share * (1.0 - share) / term.effect.share_sample_count)
        z = _z_score(term, sd[: term.size_count])
        if term.effect.cycle_and_delay_s is not None:
            run = alike_delays(fit.cell, lin, len(out), fit.correlation_weight)
            sd = np.hypot(
                sd, 0.5 * (float(np.ptp(run)) + term.effect.cycle_and_delay_s[0]) / NORMAL_QUANTILE_95
            )  # limits: the tread
        gain_nats, equals = _rivals_of(fit, int(k))
        alone, sharing, wide = _significance_among_others(fit, int(k), everything)
        out.append(
            Evidence(
                effect_term=term,
                part_label=fit.cell.label,
                gain_nats=gain_nats,
                parameter_sd=sd,
                size_z_score=z,
                size_scatter_frac=_share_of_size(
                    term,
                    scatter_between_groups(
                        J, residual, own[: term.size_count], groupings, fit.cell.baseline_gain_nats is not None
                    ),
                ),
                equivalent_effect_sets=_with_sharing(fit, equals, sharing),
                residual_mean_square=left,
                explained_frac=_share_above(
                    lin.parameter_offsets[own], S[np.ix_(own, own)], max(left - 1.0, 0.0) * len(residual)
                ),
                noise_known=fit.cell.floor_known,
                full_model_z_score=alone,
                prior_nats=None
                if fit.cell.baseline_gain_nats is None
                else float(fit.best_fit.linear_model.log_odds[k]),
                full_model_limits=wide,
            )
        )
    return tuple(out)


def standard_deviations(J: Array, residual: Array, slab: Array, block: NDArray[np.int64]) -> Array:
    """Standard deviations (k,) of numbers with columns J (N, k) under priors `slab` (k,): by the posterior, and at
    least what leaving out one block of rows after the other moves them by.

    Why: what a model is wrong by in one posture or motion is not white noise; a number that hangs on one shows it.
    Source: delete-one-group jackknife, Kott 2001, eq. 1.
    """
    H, g = J.T @ J + np.diag(slab**-2.0), J.T @ residual
    S = np.asarray(np.linalg.inv(H), dtype=float)
    whole = S @ g
    moved = []
    for number in np.unique(block):
        rows = J[block == number]
        moved.append(np.linalg.solve(H - rows.T @ rows, g - rows.T @ residual[block == number]) - whole)
    jackknife = np.sqrt((np.array(moved) ** 2).sum(axis=0) * (len(moved) - 1.0) / len(moved))
    return np.maximum(np.sqrt(np.maximum(np.diag(S), 0.0)), jackknife)


def _z_score(term: EffectTerm, sd: Array) -> float:
    if term.limits:
        return float("inf")
    return float(np.linalg.norm(term.theta[: term.size_count] / np.maximum(sd, 1e-300)))


def _share_above(x: Array, S: Array, beyond: float) -> float:
    """What numbers x (k,) of covariance S (k, k) alone explain, over that and what is left beyond noise."""
    explained = float(x @ np.linalg.lstsq(S, x, rcond=None)[0])
    return explained / (explained + beyond) if explained > 0.0 else 0.0


def _share_of_size(term: EffectTerm, spread: float) -> float:
    size = 1.0 if term.limits else float(np.linalg.norm(term.theta[: term.size_count]))
    return spread / size if size > 0.0 else 0.0


def _with_open(term: EffectTerm, sd: Array) -> Array:
    """Deviations (slots,) of a term's numbers, with what the effect's definition leaves open."""
    open_part = [
        max(slot.spec.open_size, slot.spec.open_frac * abs(x))
        for slot, x in zip(term.effect.parameter_slots, term.theta, strict=True)
    ]
    return np.hypot(sd, open_part)


def _rivals_of(fit: WholeFit, k: int) -> tuple[float, tuple[tuple[EffectTerm, ...], ...]]:
    """What the best set loses without an effect and its equals [nats], and these: terms with the same column, and what
    takes its place where T is below 9, as often as something else does. Sets of many terms are not listed.
    """
    problem, present, terms = fit.best_fit.subset_problem, fit.best_fit.present_terms, fit.best_fit.current_terms
    equals: list[tuple[EffectTerm, ...]] = [(terms[out],) for kept, out in fit.collinear_term_pairs if kept == k]
    allowed = np.ones(len(terms), dtype=bool)
    allowed[[k, *(out for _, out in fit.collinear_term_pairs)]] = False
    rival, gain = fit.rival_fit_by_term.get(k), 0.0
    at = problem.misfit_nats(problem.estimate(present)[0])
    for _ in range(SUBSTITUTE_TERMS_MAX):
        if rival is not None:
            gain, entered = fit.best_fit.log_posterior_nats - rival.log_posterior_nats, rival.present_terms & ~present
            distance = 2.0 * (_weighted_cost(rival, fit) - _weighted_cost(fit.best_fit, fit))
        else:
            members = best_set(problem, present & allowed, allowed)
            gain, entered = problem.score(present) - problem.score(members), members & ~present
            distance = 2.0 * (problem.misfit_nats(problem.estimate(members)[0]) - at)
        if distance >= DISTINCT_SQUARED_DISTANCE_MIN or not entered.any():
            break
        if entered.sum() <= SUBSTITUTE_TERMS_MAX:
            equals.append(tuple(terms[t] for t in np.nonzero(entered)[0]))
        allowed, rival = allowed & ~entered, None
    return gain, tuple(equals)


def _with_everything(fit: WholeFit) -> tuple[Array, Array]:
    """The numbers (k,) and their covariance (k, k) with every effect that has a slope in the model, under its prior."""
    members = np.array([term.is_present or term.is_smooth for term in fit.best_fit.current_terms])
    members[[out for _, out in fit.collinear_term_pairs]] = False
    return fit.best_fit.subset_problem.estimate(members)


def _significance_among_others(
    fit: WholeFit, k: int, everything: tuple[Array, Array]
) -> tuple[float, tuple[int, ...], Array | None]:
    """How clearly the data determine an effect when any other may be there, the terms that share this with it, and its
    90 % limits where it is not clear by itself.

    Model: T = x'S^-1 x of the sizes of some terms is the squared distance at which all of them may be absent; less that
           of the others it is the distance of this one where they are absent. Others join, the one first that raises
           it most, of those that are not clear by themselves, until it is clear that one of them is there.
    """
    x, S = everything
    first, terms = fit.best_fit.linear_model.term_first_column, fit.best_fit.current_terms
    own = np.arange(first[k], first[k] + min(terms[k].size_count, first[k + 1] - first[k]))

    def distance(cols: NDArray[np.int64]) -> float:
        cols = cols[np.diag(S)[cols] > 0.0]
        return float(x[cols] @ np.linalg.solve(S[np.ix_(cols, cols)], x[cols])) if len(cols) else 0.0

    T = distance(own)
    if terms[k].limits or not terms[k].is_smooth:
        return float(np.sqrt(T)), (), None
    half = NORMAL_QUANTILE_95 * np.sqrt(np.diag(S)[own])
    clear = x[own] ** 2 >= DISTINCT_SQUARED_DISTANCE_MIN * np.diag(S)[own]
    limits = np.stack([x[own] - half, x[own] + half], axis=1)
    wide = np.where(clear[:, None], terms[k].theta[: len(own), None], limits)
    if T >= DISTINCT_SQUARED_DISTANCE_MIN:
        return float(np.sqrt(T)), (), None if clear.all() else wide
    columns = [np.arange(first[t], first[t + 1]) for t in range(len(terms))]
    open_terms = [
        t
        for t, term in enumerate(terms)
        if t != k and term.is_smooth and distance(columns[t]) < DISTINCT_SQUARED_DISTANCE_MIN
    ]
    sharing: list[int] = []
    others = np.zeros(0, dtype=np.int64)
    for _ in range(SUBSTITUTE_TERMS_MAX):
        sets = [(t, np.concatenate([others, columns[t]])) for t in open_terms if t not in sharing]
        tried = [(distance(np.concatenate([own, absent])) - distance(absent), t) for t, absent in sets]
        if not tried:
            break
        shared, best = max(tried)
        sharing.append(best)
        others = np.concatenate([others, columns[best]])
        if shared >= DISTINCT_SQUARED_DISTANCE_MIN:
            return float(np.sqrt(shared)), tuple(sharing), wide
    return float(np.sqrt(T)), (), wide


def _with_sharing(
    fit: WholeFit, equals: tuple[tuple[EffectTerm, ...], ...], sharing: tuple[int, ...]
) -> tuple[tuple[EffectTerm, ...], ...]:
    """Equals, and each term that shares the evidence of an effect; each set of names and joints is listed once."""
    sets = (*equals, *((fit.best_fit.current_terms[t],) for t in sharing))
    return tuple(
        {tuple(term.effect.effect_and_joint for term in members): members for members in reversed(sets)}.values()
    )[::-1]


def _weighted_cost(one: Fitted, fit: WholeFit) -> float:
    return float((soft_l1_costs(one.linear_model.residual) * fit.correlation_weight).sum())


def scatter_between_groups(
    J: Array, residual: Array, own: NDArray[np.int64], groupings: Sequence[NDArray[np.int64]], known: bool = False
) -> float:
    """Standard deviation of a size between groups of rows beyond its noise, the largest of the groupings; 0 by chance.

    `known`: whether a baseline knows the noise. Then chance is ruled out at 5 % over all groupings; else what exceeds
    the mean of chance by its deviation counts, since the noise that chance goes by was itself fitted.

    Model:  a number of their own in every group for columns `own` of J, against all of J common to all; their sum of
            squares d'Wd has the mean df + tau^2 tr W if the sizes scatter by tau (method of moments).
    Why projected: a fit stops short of its optimum and leans on its priors; what J still explains is not a difference.
    Source: invariance as a sign of a cause: Peters, Buehlmann, Meinshausen 2016; tau: DerSimonian, Laird 1986.
    """
    norm = np.sqrt((J**2).sum(axis=0))
    U, sizes, _ = np.linalg.svd(J[:, norm > 0.0] / norm[norm > 0.0], full_matrices=False)
    Q = U[:, sizes > RANK_TOLERANCE_FRAC * sizes.max(initial=0.0)]
    level = 1.0 - SCATTER_FALSE_ALARM_RATE / max(1, len(groupings)) if known else None
    return max((_scatter_between_groups(Q, J[:, own], residual, group, level) for group in groupings), default=0.0)


def _scatter_between_groups(
    Q: Array, columns: Array, residual: Array, group: NDArray[np.int64], level: float | None
) -> float:
    """Of one grouping; Q: orthonormal columns of what is common to all groups. `level`: quantile of chance."""
    apart = (columns[:, None] * (group[:, None] == np.unique(group))[:, :, None]).reshape(len(residual), -1)
    power = float((apart**2).sum(axis=0).max())
    apart = apart - Q @ (Q.T @ apart)
    values, vectors = np.linalg.eigh(apart.T @ apart)
    kept = values > RANK_TOLERANCE_FRAC * power
    if not kept.any():
        return 0.0
    scores = vectors[:, kept].T @ (apart.T @ residual)
    squares, df = float((scores**2 / values[kept]).sum()), int(kept.sum())
    if level is None:
        return float(np.sqrt(max(0.0, squares - df - np.sqrt(2.0 * df)) / values[kept].sum()))
    return float(np.sqrt((squares - df) / values[kept].sum())) if squares > float(chi2.ppf(level, df)) else 0.0


def groupings_of(cell: Cell) -> list[NDArray[np.int64]]:
    """Groups of rows in which a true cause has one size: kinds of motion; of each part quarters of its time, and the
    lower and upper half of whatever a remainder may go with (position, speed, command, posture).
    """
    out, start = [cell.rows.fold], 0
    for part in cell.joined_cells or (cell,):
        own = slice(start, start + part.rows.row_count)
        start += part.rows.row_count
        for values, cuts in ((part.t_s, QUARTERS), *((values, HALVES) for _, values in part.regressors)):
            group = np.zeros(cell.rows.row_count, dtype=np.int64)
            if len(values) == part.rows.row_count:
                group[own] = 1 + np.searchsorted(np.quantile(values, cuts), values)
            out.append(group)
    return [group for group in out if len(np.unique(group)) > 1]


def smallest_detectable(fit: WholeFit) -> dict[int, float]:
    """By absent term, the smallest size that this recording would have shown: found nine times of ten at 2 % alarms."""
    H, best = fit.best_fit.subset_problem.normal_matrix, fit.best_fit
    cols = np.nonzero(np.repeat(best.present_terms, np.diff(best.linear_model.term_first_column)))[0]
    inside = H[np.ix_(cols, cols)] + np.diag(best.subset_problem.prior_sigma[cols] ** -2.0)
    inverse = np.linalg.inv(inside) if len(cols) else np.zeros((0, 0))
    out = {}
    for k, term in enumerate(best.current_terms):
        if term.is_present or term.limits:
            continue
        first = int(best.linear_model.term_first_column[k])
        cross = H[first, cols]
        power = float(H[first, first] - cross @ inverse @ cross)
        out[k] = (
            DETECTION_LIMIT_SIGMAS / np.sqrt(power) if power > 1e-9 * max(float(H[first, first]), 1e-300) else np.inf
        )
    return out
