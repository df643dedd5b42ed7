"""How far a machine's own numbers wander from one day without a fault to the next: noise along each one's direction.

The flow gain that fits one day is half a percent off on the next: oil warms, friction changes. In one recording that
is not white noise. It adds up as its effect does, and the effect gains ten times what chance gives. Taken as what it
is, a variance of that number, it costs this effect alone its confidence.
"""

from dataclasses import dataclass, replace

import numpy as np

from diagnosis.log.nominal import Nominal
from diagnosis.noise.excess import common_excess
from diagnosis.noise.of_a_day import day_noise
from diagnosis.replay.stage_replay import Replay
from diagnosis.search.candidates import Candidate, candidates_of_effects
from diagnosis.search.cell import Cell
from diagnosis.search.fit import neutral_fit, residuals_at
from machine.rotations import Array

RECORDINGS_MIN = 6  # recordings that can show it
DAILY_VARIATION_CHI2_MIN = 1.5  # mean square of a number over its own error: 1 by chance, seldom more than this
FINITE_DIFFERENCE_STEP_FRAC = 0.004  # of the bound
SENSITIVITY_SQUARE_MIN = 1.0  # squared floors that the largest size moves: with less there is no column
Sizes = tuple[tuple[str, float], ...]


def with_wander(cells: list[Cell], nominal: Nominal) -> list[Cell]:
    """Actuators' cells with what their numbers are known to wander by as noise; others as they are."""
    return [_with_wander_of(cell, nominal) for cell in cells]


def _with_wander_of(cell: Cell, nominal: Nominal) -> Cell:
    replay = cell.whitened
    if not isinstance(replay, Replay) or cell.stage != "actuator":
        return cell
    columns = []
    for joint in replay.joints:
        record = nominal.baseline_remainder("actuator", joint + 1)
        for name, size in record.wander if record is not None else ():
            columns += [
                size * _effect_sensitivity(cell, effect) for effect in candidates_of_effects((name,), (joint + 1,))
            ]
    return (
        replace(cell, whitened=replace(replay, day_to_day_noise=day_noise(np.stack(columns, axis=1))))
        if columns
        else cell
    )


def _effect_sensitivity(cell: Cell, candidate: Candidate) -> Array:
    """How an effect moves the residual (N,), a unit of its size."""
    step = FINITE_DIFFERENCE_STEP_FRAC * candidate.parameter_slots[0].typical_max
    return (residuals_at(cell, (candidate,), np.array([[step]]))[0] - neutral_fit(cell).residual) / step


@dataclass(frozen=True, slots=True)
class _RecordingEquations:
    """One recording's normal equations of all names: `normal_matrix` J'J (k, k), `normal_rhs` -J'r (k,)."""

    normal_matrix: Array
    normal_rhs: Array

    def numbers_given(self, variances: Array) -> tuple[Array, Array]:
        """The numbers (k,), each fitted alone, and their variances by noise, where those of `variances` wander."""
        S = np.diag(np.sqrt(variances))
        inner = self.normal_matrix @ S @ np.linalg.solve(np.eye(len(S)) + S @ self.normal_matrix @ S, S)
        known = np.maximum(
            np.diag(self.normal_matrix - inner @ self.normal_matrix), 1e-12 * np.diag(self.normal_matrix)
        )
        return (self.normal_rhs - inner @ self.normal_rhs) / known, 1.0 / known


def wander_of(cells: list[Cell]) -> Sizes:
    """By how much the effects of one joint's actuator wander over baseline recordings; empty for other cells.

    Model: the effect that is off most, counted in its own error, gets as variance what its numbers have beyond that
           error; then the others in addition, as long as one is off by more than chance. One by one, since a wander of
           the flow gain is seen in each of its neighbours.
    """
    if len(cells) < RECORDINGS_MIN or cells[0].stage != "actuator" or cells[0].joint is None:
        return ()
    names = [
        effect
        for effect in cells[0].candidates
        if _has_single_size(effect) and all(_is_cell_candidate(cell, effect) for cell in cells)
    ]
    days = [_day_normal_equations(cell, names) for cell in cells]
    felt = [
        k
        for k in range(len(names))
        if all(
            day.normal_matrix[k, k] * names[k].parameter_slots[0].typical_max ** 2 > SENSITIVITY_SQUARE_MIN
            for day in days
        )
    ]
    names, days = (
        [names[k] for k in felt],
        [_RecordingEquations(day.normal_matrix[np.ix_(felt, felt)], day.normal_rhs[felt]) for day in days],
    )
    variances = np.zeros(len(names))
    for _ in names:
        numbers, errors = (np.array(x) for x in zip(*(day.numbers_given(variances) for day in days), strict=True))
        off = np.where(variances > 0.0, 0.0, np.mean(numbers**2 / errors, axis=0))
        k = int(np.argmax(off))
        if off[k] < DAILY_VARIATION_CHI2_MIN:
            break
        variances[k] = common_excess(numbers[:, [k]] ** 2, errors[:, [k]])[0]
    return tuple((effect.name, float(np.sqrt(v))) for effect, v in zip(names, variances, strict=True) if v > 0.0)


def _has_single_size(candidate: Candidate) -> bool:
    """Whether an effect has one number, nothing at 0."""
    return (
        candidate.stage == "actuator"
        and len(candidate.parameter_slots) == 1
        and not candidate.fixed_parameters
        and candidate.parameter_slots[0].neutral_value == 0.0
    )


def _is_cell_candidate(cell: Cell, candidate: Candidate) -> bool:
    return any(other.effect_and_joint == candidate.effect_and_joint for other in cell.candidates)


def _day_normal_equations(cell: Cell, names: list[Candidate]) -> _RecordingEquations:
    r = neutral_fit(cell).residual
    J = np.stack([_effect_sensitivity(cell, effect) for effect in names], axis=1)
    return _RecordingEquations(J.T @ J, -J.T @ r)
