"""What a fit would have been without one kind of trajectory: refitted for the rest, however its cost is bent."""

from dataclasses import replace

import numpy as np
import pytest
from made_up_cell import COLUMNS, GAIN, LAG, N, made_up

from diagnosis.search.fit import fit_hypothesis, neutral_fit, soft_l1_costs
from diagnosis.whole_model.held_out import held_out
from machine.effects.layout import ParameterSets


def test_without_names_nothing_is_refitted() -> None:
    cell = made_up((0.2, 0.0, 0.0))
    found = held_out(cell, neutral_fit(cell))
    assert found.thetas_without_fold.shape == (len(found.fold_numbers), 0)
    assert found.residual_with_effects == pytest.approx(neutral_fit(cell).residual)


def test_a_second_name_that_is_nothing_leaves_the_first_one_to_be_refitted() -> None:
    """A lag cannot be below nothing, where its fit wants to go: what the gain is without a fold is no lag's concern."""
    plain = made_up((0.2, 0.0, -0.05))

    def whitened(sets: ParameterSets) -> np.ndarray:
        return plain.whitened(sets) - np.outer(sets.joint_parameters[:, 0, LAG.column], 40.0 * COLUMNS[0])

    cell = replace(plain, whitened=whitened)
    gain, _, lag = cell.candidates
    alone = fit_hypothesis(cell, (gain,), np.array([0.01]))
    both = fit_hypothesis(cell, (gain, lag), np.append(alone.theta, 0.0))
    assert both.theta[1] == 0.0
    without = [held_out(cell, one) for one in (both, alone)]
    assert without[0].thetas_without_fold[:, 0] == pytest.approx(without[1].thetas_without_fold[:, 0], abs=1e-6)
    assert without[0].residual_with_effects == pytest.approx(without[1].residual_with_effects, abs=1e-3)


def test_a_step_that_leads_astray_is_damped() -> None:
    """A gain that saturates: where it does, a straight step on the rest goes far beyond what serves the rest."""
    plain = made_up((0.0, 0.0, 0.0))
    half = np.arange(N) < N // 2

    def whitened(sets: ParameterSets) -> np.ndarray:
        moved = plain.whitened(sets) - plain.whitened(plain.baseline_parameters)
        size = np.abs(moved) @ np.abs(COLUMNS[0]) / N
        bent = np.where(half, moved, moved * np.exp(-size)[:, None])
        return plain.whitened(plain.baseline_parameters) + bent + np.where(half, 8.0 * COLUMNS[0], 3.0 * COLUMNS[0])

    cell = replace(plain, whitened=whitened)
    found = fit_hypothesis(cell, cell.candidates[:1], np.array([0.2]))
    refitted = held_out(cell, found)
    for fold, theta in zip(refitted.fold_numbers, refitted.thetas_without_fold, strict=True):
        keep = cell.rows.fold != fold
        sets = ParameterSets(
            plain.baseline_parameters.joint_parameters.copy(), plain.baseline_parameters.machine_parameters.copy()
        )
        sets.joint_parameters[:, 0, GAIN.column] = theta[0]
        assert soft_l1_costs(whitened(sets)[0][keep]).sum() <= soft_l1_costs(found.residual[keep]).sum() + 1e-9
