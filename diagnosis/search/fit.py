"""Least squares of a hypothesis in one cell: every column of a Jacobian, and every trial step, in one kernel call."""

from dataclasses import dataclass

import numpy as np

from diagnosis.errors import DiagnosisError
from diagnosis.search.candidates import Candidate, parameter_sets_with
from diagnosis.search.cell import Cell
from machine.effects.entries import EffectEntry, make_entry
from machine.effects.layout import ParameterSets
from machine.effects.registry import effect_of
from machine.errors import MachineFileError
from machine.rotations import Array

SOFT_L1_THRESHOLD = 3.0  # whitened residuals beyond it count linearly (soft-L1)
FINITE_DIFFERENCE_STEP_FRAC = 2e-3  # of the range: large against rounding and kinks
MAX_ITERATIONS = 10
CONVERGENCE_NATS = 0.02
CONVERGENCE_COST_FRAC = 1e-5
# Of what a straight valley would have gained: below it the valley is curved, and followed
CURVED_VALLEY_GAIN_MAX_FRAC = 0.5
TRIAL_DAMPINGS = (1e-6, 1e-2, 1.0)
Hypothesis = tuple[Candidate, ...]


@dataclass(frozen=True, slots=True)
class Fit:
    """Where a hypothesis fits best. `theta` (k,), residual (N,), J (N, k)."""

    hypothesis: Hypothesis
    theta: Array
    residual: Array
    J: Array
    cost_nats: float

    @property
    def k(self) -> int:
        """Numbers that were fitted."""
        return len(self.theta)

    @property
    def by_effect(self) -> tuple[tuple[Candidate, Array], ...]:
        """Each effect with its own numbers (slots,)."""
        return tuple((candidate, self.theta[own]) for candidate, own in self.effect_slices)

    @property
    def effect_slices(self) -> tuple[tuple[Candidate, slice], ...]:
        """Each effect with where its numbers stand among all."""
        ends = np.cumsum([len(candidate.parameter_slots) for candidate in self.hypothesis]).tolist()
        return tuple(
            (candidate, slice(end - len(candidate.parameter_slots), end))
            for candidate, end in zip(self.hypothesis, ends, strict=True)
        )


def soft_l1_costs(residual: Array) -> Array:
    """Soft-L1 cost of each residual [nats]; 1/2 r^2 while small."""
    return SOFT_L1_THRESHOLD**2 * (np.sqrt(1.0 + (residual / SOFT_L1_THRESHOLD) ** 2) - 1.0)


def soft_l1_weights(residual: Array) -> Array:
    """Of each residual in a Gauss-Newton step."""
    return 1.0 / np.sqrt(1.0 + (residual / SOFT_L1_THRESHOLD) ** 2)


def residuals_at(cell: Cell, hypothesis: Hypothesis, thetas: Array) -> Array:
    """Residuals (m, N) at each row of thetas (m, k)."""
    return evaluated_at(cell, parameter_sets_with(cell.baseline_parameters, hypothesis, thetas))


def evaluated_at(cell: Cell, sets: ParameterSets) -> Array:
    """Residuals (sets, N); far off where a model runs away."""
    return np.nan_to_num(cell.whitened(sets), nan=1e3, posinf=1e3, neginf=-1e3)


def neutral_fit(cell: Cell) -> Fit:
    """No effect at all."""
    residual = residuals_at(cell, (), np.zeros((1, 0)))[0]
    return Fit((), np.zeros(0), residual, np.zeros((len(residual), 0)), float(soft_l1_costs(residual).sum()))


def parameter_bounds(hypothesis: Hypothesis) -> tuple[Array, Array]:
    """Lower and upper bounds (k,) each."""
    slots = [slot for candidate in hypothesis for slot in candidate.parameter_slots]
    return np.array([slot.lower_bound for slot in slots]), np.array([slot.upper_bound for slot in slots])


def parameter_spans(hypothesis: Hypothesis) -> Array:
    """The ruler of each number (k,): what good machines have of it, from end to end."""
    return np.array(
        [slot.typical_max - slot.lower_bound for candidate in hypothesis for slot in candidate.parameter_slots]
    )


def residual_jacobian(cell: Cell, hypothesis: Hypothesis, theta: Array, residual: Array) -> Array:
    """(N, k) by finite steps away from the nearer bound, one kernel call."""
    high = parameter_bounds(hypothesis)[1]
    steps = FINITE_DIFFERENCE_STEP_FRAC * parameter_spans(hypothesis)
    signs = np.where(theta + steps > high, -1.0, 1.0)
    moved = theta + np.diag(signs * steps)
    return ((residuals_at(cell, hypothesis, moved) - residual) / (signs * steps)[:, None]).T


def fit_hypothesis(cell: Cell, hypothesis: Hypothesis, start: Array, rounds: int = MAX_ITERATIONS) -> Fit:
    """Gauss-Newton with damping inside bounds from one start.

    Model:  min sum rho(r(theta)); each round solves (J'WJ + d diag) step = -J'Wr for three dampings d and takes the
            best of them, where they gain little also those bent back into the valley; it ends when a round gains
            less than 0.02 nats.
    Raises: DiagnosisError: the start has another length than the hypothesis.
    """
    low, high = parameter_bounds(hypothesis)
    if len(start) != len(low):
        raise DiagnosisError(f"a start has {len(start)} numbers; the hypothesis has {len(low)}")
    theta = np.clip(np.asarray(start, dtype=float), low, high)
    residual = residuals_at(cell, hypothesis, theta)[0]
    cost = float(soft_l1_costs(residual).sum())
    J = residual_jacobian(cell, hypothesis, theta, residual)
    for _ in range(rounds):
        steps = damped_steps(J, residual, parameter_spans(hypothesis))
        trials = np.clip(theta + np.array([*steps, 0.3 * steps[0], 0.1 * steps[0]]), low, high)
        tried = residuals_at(cell, hypothesis, trials)
        totals = soft_l1_costs(tried).sum(axis=1)
        promised = -0.5 * float((trials[0] - theta) @ (J.T @ (soft_l1_weights(residual) * residual)))
        if len(theta) > 1 and cost - float(totals.min()) < CURVED_VALLEY_GAIN_MAX_FRAC * promised:
            bent = np.clip(trials + _curvature_corrections(J, residual, theta, trials, tried), low, high)
            trials, tried = (
                np.concatenate([trials, bent]),
                np.concatenate([tried, residuals_at(cell, hypothesis, bent)]),
            )
            totals = soft_l1_costs(tried).sum(axis=1)
        best = int(np.argmin(totals))
        gained = cost - float(totals[best])
        if gained <= 0.0:
            break
        theta, residual, cost = trials[best], tried[best], float(totals[best])
        J = residual_jacobian(cell, hypothesis, theta, residual)
        if gained < CONVERGENCE_NATS + CONVERGENCE_COST_FRAC * cost:
            break
    kinks = np.clip(_at_kinks(hypothesis, theta), low, high)
    if not np.array_equal(kinks, theta):
        there = residuals_at(cell, hypothesis, kinks)[0]
        if float(soft_l1_costs(there).sum()) < cost:
            theta, residual, cost = kinks, there, float(soft_l1_costs(there).sum())
            J = residual_jacobian(cell, hypothesis, theta, residual)
    return Fit(hypothesis, theta, residual, J, cost)


def _at_kinks(hypothesis: Hypothesis, theta: Array) -> Array:
    """Theta (k,) with what has a kink at the nearest one."""
    if all(candidate.cycle_and_delay_s is None for candidate in hypothesis):
        return theta
    cuts = np.cumsum([len(candidate.parameter_slots) for candidate in hypothesis])[:-1]
    return np.concatenate(
        [candidate.with_whole_delay(own) for candidate, own in zip(hypothesis, np.split(theta, cuts), strict=True)]
    )


def normal_equations(J: Array, residual: Array, span: Array) -> tuple[Array, Array]:
    """H (k, k) and g (k,) of a Gauss-Newton step H step = -g on the soft-L1 cost, numbers counted in their ranges."""
    scaled = J * span
    weighed = scaled * soft_l1_weights(residual)[:, None]
    return weighed.T @ scaled, weighed.T @ residual


def damped_steps(J: Array, residual: Array, span: Array) -> Array:
    """Steps (dampings, k), the least damped first."""
    H, g = normal_equations(J, residual, span)
    diagonal = np.diag(np.diag(H)) + 1e-9 * np.eye(len(g)) * max(1.0, float(np.trace(H)))
    return np.array([np.linalg.lstsq(H + d * diagonal, -g, rcond=None)[0] * span for d in TRIAL_DAMPINGS])


def _curvature_corrections(J: Array, residual: Array, theta: Array, trials: Array, tried: Array) -> Array:
    """What takes trials (m, k) with residuals (m, N) back into a curved valley, to second order."""
    w = soft_l1_weights(residual)[:, None]
    off = tried - residual - (trials - theta) @ J.T
    return -off @ (np.linalg.pinv((J * w).T @ J, hermitian=True) @ (J * w).T).T


def entries_of(found: Fit) -> list[EffectEntry]:
    """A fit as `[[effect]]` entries; sizes that ended at a bound lie on it."""
    out = []
    for candidate, values in found.by_effect:
        effect = effect_of(candidate.name)
        parameters: dict[str, object] = {slot.parameter: value for slot, value in candidate.fixed_parameters}
        if effect.direction is not None:
            size = float(np.linalg.norm(values))
            parameters |= {effect.size.name: min(size, effect.size.highest_value)}
            if size > 0.0:
                along = np.zeros(len(effect.direction.default_vector))  # a base is tilted about its level axes only
                along[: len(values)] = values / size
                parameters[effect.direction.name] = along.tolist()
        else:
            parameters |= {
                slot.parameter: float(value) for slot, value in zip(candidate.parameter_slots, values, strict=True)
            }
        if effect.quantity_choice is not None and candidate.variant_option:
            parameters[effect.quantity_choice.name] = candidate.variant_option
        try:
            out.append(make_entry(effect, candidate.joint, parameters))
        except MachineFileError as error:
            raise DiagnosisError(f"a fitted effect does not fit its own bounds: {error}") from error
    return out
