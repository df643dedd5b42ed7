"""A part of the recording as a linear model about where it stands: one block of columns for every effect.

Smooth effects get the tangent. An effect with a threshold (a dead band, a play) or a shape of its own (a frequency, an
order) has no slope where it is absent: its column is the secant from absence to the start that explains most of what is
left; where it is present, the secant back to absence, so that leaving it out is judged by what really happens.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.search.candidates import Candidate, parameter_sets_with
from diagnosis.search.cell import Cell
from diagnosis.search.fit import FINITE_DIFFERENCE_STEP_FRAC, evaluated_at, soft_l1_weights
from diagnosis.whole_model.subsets import LinearProblem, Members
from machine.effects.layout import ParameterSets
from machine.effects.registry import effect_of
from machine.rotations import Array

SLAB_TO_PRIOR_SCALE_RATIO = 3.0  # times the catalogue's prior scale: wide, so that a poor machine is not an outlier
PARAMETER_SET_BATCH_SIZE = 64  # parameter sets in one call, for memory
# Of the effects that a machine has: how many are expected to change between two diagnoses
PRIOR_CHANGED_EFFECT_FRAC = 0.02
DELAY_DIFFERENCE_STEP_CYCLES = 10.0  # of a delay: many treads of its staircase, and little against any motion
COLUMN_POWER_MIN_FRAC = 1e-9  # of a column's power: less is rounding
COLLINEARITY_TOLERANCE = 1e-5  # of the cosine between columns, by finite steps of different length


@dataclass(frozen=True, slots=True)
class EffectTerm:
    """One effect of the library with its numbers (slots,); `is_present`: whether the machine is taken to have it."""

    effect: Candidate
    theta: Array
    is_present: bool

    @property
    def is_smooth(self) -> bool:
        """Whether its size has a slope at absence and nothing else has to be known of it."""
        sizes = {slot.parameter for slot in self.effect.parameter_slots}
        slot = self.effect.parameter_slots[0]
        return (
            len(sizes) == 1
            and not self.effect.fixed_parameters
            and slot.neutral_value == 0.0
            and not effect_of(self.effect.name).has_threshold
        )

    @property
    def absent_size(self) -> float:
        """The size at which the effect vanishes."""
        return float(self.effect.parameter_slots[0].neutral_value)

    @property
    def limits(self) -> bool:
        """Whether it is a limit (neutral 1 or infinite): its column is the whole change, its number the share of it."""
        return self.absent_size != 0.0

    @property
    def size_count(self) -> int:
        """How many of its numbers are sizes; the others are shapes."""
        first = self.effect.parameter_slots[0].parameter
        return sum(slot.parameter == first for slot in self.effect.parameter_slots)


@dataclass(frozen=True, slots=True)
class LinearModel:
    """Residual (N,) and columns J (N, k) about the terms as they stand.

    `parameter_offsets`: (k,), their numbers in those columns. `term_first_column`: (terms + 1,). `robust_weight`: (N,)
    of each row in a least-squares step. `log_odds`: (terms,), prior, of a term being there.
    """

    effect_terms: tuple[EffectTerm, ...]
    residual: Array
    J: Array
    parameter_offsets: Array
    term_first_column: NDArray[np.int64]
    robust_weight: Array
    log_odds: Array

    def twin_pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs of terms of one column whose columns are the same to rounding: the one kept, and the one it stands for.

        Why: two numbers that do the same would be played against each other to imitate the model's curvature.
        """
        single = np.nonzero(np.diff(self.term_first_column) == 1)[0]
        columns = self.J[:, self.term_first_column[single]] * np.sqrt(self.robust_weight)[:, None]
        norm = np.linalg.norm(columns, axis=0)
        unit = columns / np.where(norm > 0.0, norm, 1.0)
        alike = np.abs(unit.T @ unit) > 1.0 - COLLINEARITY_TOLERANCE
        odds = self.log_odds[single]
        out = []
        for i in range(len(single)):
            better = [j for j in range(len(single)) if alike[i, j] and (odds[j], -j) > (odds[i], -i)]
            if norm[i] > 0.0 and better:
                out.append((int(single[max(better, key=lambda j: (odds[j], -j))]), int(single[i])))
        return tuple(out)

    def choice_problem(self, trust: Array) -> LinearProblem:
        """The choice among its terms. `trust`: (N,), at most 1, how far each row speaks for itself."""
        w = np.sqrt(self.robust_weight * trust)
        white = self.J * w[:, None]
        H = white.T @ white
        c = H @ self.parameter_offsets - white.T @ (w * self.residual)
        shown = [
            term for term, columns in zip(self.effect_terms, np.diff(self.term_first_column), strict=True) if columns
        ]
        nonnegative = np.concatenate([np.zeros(0, dtype=bool), *(_nonnegative_columns(term) for term in shown)])
        return LinearProblem(H, c, self.prior_deviations, self.term_first_column, nonnegative, self.log_odds)

    @property
    def prior_deviations(self) -> Array:
        """Prior deviations of the columns' numbers (k,)."""
        shown = [
            term for term, columns in zip(self.effect_terms, np.diff(self.term_first_column), strict=True) if columns
        ]
        return np.concatenate([np.zeros(0), *(_prior_deviations(term) for term in shown)])

    def columns(self, k: int) -> Array:
        """Columns of one term (N, its columns)."""
        return self.J[:, self.term_first_column[k] : self.term_first_column[k + 1]]

    def relinearised_at(self, terms: tuple[EffectTerm, ...], residual: Array) -> "LinearModel":
        """The same columns, where present terms have other numbers that leave another residual, for a further step."""
        x = np.concatenate([_parameter_offsets(term, True) for term in terms])
        return replace(
            self, effect_terms=terms, residual=residual, parameter_offsets=x, robust_weight=soft_l1_weights(residual)
        )

    @property
    def present_terms(self) -> Members:
        """Terms that are present (terms,)."""
        return np.array([term.is_present for term in self.effect_terms], dtype=bool)


def pack_terms(cell: Cell, terms: Sequence[EffectTerm], thetas: Array | None = None) -> ParameterSets:
    """Parameter sets with the present terms; `thetas` (m, numbers of the present ones) in place of their own."""
    some = [term for term in terms if term.is_present]
    own = np.concatenate([term.theta for term in some])[None] if some else np.zeros((1, 0))
    return parameter_sets_with(
        cell.baseline_parameters, tuple(term.effect for term in some), own if thetas is None else thetas
    )


def linearise_terms(cell: Cell, terms: Sequence[EffectTerm], to_move: bool = False, absent: bool = True) -> LinearModel:
    """Columns of all terms about the present ones as they stand. `to_move`: tangents of present thresholds, too, for a
    step of their sizes, in place of the secants by which they are left out. `absent`: whether absent terms get columns.
    """
    base = pack_terms(cell, terms)
    residual = evaluated_at(cell, base)[0]
    tangents = _tangent_columns(cell, terms, residual, to_move)
    smooth = [k for k, term in enumerate(terms) if absent and not term.is_present and term.is_smooth]
    steps = [(k, row) for k in smooth for row in np.diag(_difference_steps(terms[k]))]
    moved = _residuals_with_effect(cell, base, [(terms[k].effect, row) for k, row in steps])
    columns: dict[int, list[Array]] = {k: [] for k in range(len(terms))}
    for (k, row), there in zip(steps, moved, strict=True):
        columns[k].append((there - residual) / row[np.nonzero(row)[0][0]])
    known = (
        np.array([column for own in (*tangents.values(), *columns.values()) for column in own])
        .reshape(-1, len(residual))
        .T
    )
    w = np.sqrt(soft_l1_weights(residual))
    scanned = absent and any(not term.is_present and not term.is_smooth for term in terms)
    Q = np.linalg.qr(known * w[:, None])[0] if scanned and known.size else np.zeros((len(residual), 0))
    out = list(terms)
    for k, term in enumerate(terms):
        if term.is_present:
            columns[k] = tangents[k]
        elif absent and not term.is_smooth:
            out[k], columns[k] = _best_start_and_secant(cell, base, term, residual, w, Q)
    x = [
        _parameter_offsets(term, to_move) if term.is_present else np.zeros(len(columns[k]))
        for k, term in enumerate(out)
    ]
    first = np.concatenate([[0], np.cumsum([len(columns[k]) for k in range(len(out))])]).astype(np.int64)
    J = np.array([column for k in range(len(out)) for column in columns[k]]).reshape(-1, len(residual)).T
    odds = np.array([log_odds_of(cell, term) for term in out])
    return LinearModel(
        tuple(out), residual, J, np.concatenate([*x, np.zeros(0)]), first, soft_l1_weights(residual), odds
    )


def linear_model_from_columns(cell: Cell, terms: tuple[EffectTerm, ...], columns: Sequence[Array]) -> LinearModel:
    """Present terms with columns (N, numbers of each) that were found nearby."""
    first = np.concatenate([[0], np.cumsum([len(term.theta) for term in terms])]).astype(np.int64)
    residual = evaluated_at(cell, pack_terms(cell, terms))[0]
    x = np.concatenate([_parameter_offsets(term, True) for term in terms])
    odds = np.array([log_odds_of(cell, term) for term in terms])
    return LinearModel(
        tuple(terms), residual, np.concatenate(list(columns), axis=1), x, first, soft_l1_weights(residual), odds
    )


def _parameter_offsets(term: EffectTerm, to_move: bool) -> Array:
    """A present term's numbers in its columns: sizes as they are, shapes counted from where they stand."""
    sizes = term.theta[: term.size_count]
    if term.limits:
        sizes = np.zeros(1) if to_move else np.ones(1)
    return np.concatenate([sizes, np.zeros(len(term.theta) - term.size_count)])


def _tangent_columns(cell: Cell, terms: Sequence[EffectTerm], residual: Array, to_move: bool) -> dict[int, list[Array]]:
    """Columns of the present terms: tangents, and for a size with a threshold the secant back to absence."""
    some = [k for k, term in enumerate(terms) if term.is_present]
    if not some:
        return {}
    theta = np.concatenate([terms[k].theta for k in some])
    high = np.concatenate([[slot.upper_bound for slot in terms[k].effect.parameter_slots] for k in some])
    step = np.concatenate([_difference_steps(terms[k]) for k in some])
    step = np.where(theta + step > high, -step, step)
    at, moves = 0, []
    for k in some:
        term = terms[k]
        for s in range(len(term.theta)):
            row = theta.copy()
            far = abs(term.theta[s] - term.absent_size) > abs(step[at + s])
            if s < term.size_count and not term.is_smooth and far and not to_move:
                row[at + s] = term.absent_size
            else:
                row[at + s] += step[at + s]
            moves.append((k, at + s, row))
        at += len(term.theta)
    there = _in_parts(cell, pack_terms(cell, terms, np.array([row for _, _, row in moves])))
    out: dict[int, list[Array]] = {k: [] for k in some}
    for (k, column, row), moved in zip(moves, there, strict=True):
        change = row[column] - theta[column]
        whole = terms[k].limits and not out[k] and not to_move
        out[k].append((moved - residual) / (-1.0 if whole else change))
    return out


def _best_start_and_secant(
    cell: Cell, base: ParameterSets, term: EffectTerm, residual: Array, w: Array, Q: Array
) -> tuple[EffectTerm, list[Array]]:
    """The start at which an absent term explains most of what known columns leave, and its secant; Q (N, k): their
    orthonormal basis, rows weighted by w (N,).
    """
    starts = _start_values(term)
    there = _residuals_with_effect(cell, base, [(term.effect, row) for row in starts])
    columns = there - residual
    white, own = columns * w, residual * w
    own -= Q @ (Q.T @ own)
    whole = np.einsum("ij,ij->i", white, white)
    power = whole - ((white @ Q) ** 2).sum(axis=1)  # of what Q leaves of a column
    shown = power > COLUMN_POWER_MIN_FRAC * whole
    gain = np.where(shown, np.maximum(-(white @ own), 0.0) ** 2 / np.where(shown, power, 1.0), 0.0)
    best = int(np.argmax(gain))
    size = 1.0 if term.limits else starts[best, 0]
    return EffectTerm(term.effect, starts[best], False), [columns[best] / size]


def _start_values(term: EffectTerm) -> Array:
    """Where an absent term may be (m, slots); one size alone where the change is in proportion to it."""
    starts = term.effect.scan_points()
    starts = starts[starts[:, 0] != term.absent_size]
    if term.limits or effect_of(term.effect.name).has_threshold or not len(starts):
        return starts
    sizes = np.unique(starts[:, 0])
    return starts[starts[:, 0] == sizes[len(sizes) // 2]]


def _residuals_with_effect(cell: Cell, base: ParameterSets, moves: Sequence[tuple[Candidate, Array]]) -> list[Array]:
    """Residuals with one further effect each."""
    out: list[Array] = []
    for k in range(0, len(moves), PARAMETER_SET_BATCH_SIZE):
        part = moves[k : k + PARAMETER_SET_BATCH_SIZE]
        sets = base.repeated_sets(len(part))
        for row, (effect, theta) in enumerate(part):
            one = parameter_sets_with(base, (effect,), theta)
            sets.joint_parameters[row], sets.machine_parameters[row] = (
                one.joint_parameters[0],
                one.machine_parameters[0],
            )
        out.extend(evaluated_at(cell, sets))
    return out


def _in_parts(cell: Cell, sets: ParameterSets) -> list[Array]:
    out: list[Array] = []
    for k in range(0, sets.set_count, PARAMETER_SET_BATCH_SIZE):
        own = slice(k, k + PARAMETER_SET_BATCH_SIZE)
        out.extend(
            evaluated_at(cell, ParameterSets(sets.joint_parameters[own].copy(), sets.machine_parameters[own].copy()))
        )
    return out


def _difference_steps(term: EffectTerm) -> Array:
    if term.effect.cycle_and_delay_s is not None:  # the cost is a staircase of PLC cycles and logged rows
        return np.full(1, DELAY_DIFFERENCE_STEP_CYCLES * term.effect.cycle_and_delay_s[0])
    return FINITE_DIFFERENCE_STEP_FRAC * np.array(
        [slot.typical_max - slot.lower_bound for slot in term.effect.parameter_slots]
    )


def _prior_deviations(term: EffectTerm) -> Array:
    """(columns,) prior deviations: sizes by the catalogue, shapes of a present term by their range."""
    slots = term.effect.parameter_slots if term.is_present else term.effect.parameter_slots[: term.size_count]
    out = []
    for k, slot in enumerate(slots):
        if term.limits and k == 0:
            out.append(1.0)
            continue
        scale = slot.spec.prior.scale * slot.size_scale if k < term.size_count else 0.0
        span = slot.typical_max - slot.lower_bound
        out.append(
            SLAB_TO_PRIOR_SCALE_RATIO * scale
            if scale > 0.0
            else (span if np.isfinite(span) else max(abs(slot.start_value), 1e-9))
        )
    return np.array(out)


def _nonnegative_columns(term: EffectTerm) -> Members:
    columns = len(term.theta) if term.is_present else term.size_count
    first = term.limits or term.effect.parameter_slots[0].lower_bound >= 0.0
    return np.array([first and k < term.size_count for k in range(columns)], dtype=bool)


def log_odds_of(cell: Cell, term: EffectTerm) -> float:
    """Prior log odds of an effect: of a machine that has it or, given a baseline, of one that got it since.

    Why less what it usually gains: by so much it explains the wrong form of the machine's own model.
    """
    share = effect_of(term.effect.name).prior_probability
    if cell.baseline_gain_nats is None:
        return float(np.log(share / (1.0 - share)))
    return float(np.log(PRIOR_CHANGED_EFFECT_FRAC * share)) - dict(cell.baseline_gain_nats).get(term.effect.name, 0.0)
