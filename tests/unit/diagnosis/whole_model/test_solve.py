"""The search for the best set on a made-up part: an effect with a narrow optimum between two that imitate it."""

import numpy as np
import pytest

from diagnosis.search.candidates import Candidate, candidates_of_effects
from diagnosis.search.cell import Cell, ResidualRows
from diagnosis.whole_model.linear import EffectTerm
from diagnosis.whole_model.solve import WholeFit, fit_and_prune, refit_reduced
from machine.effects.layout import ParameterSets, neutral_sets
from machine.rotations import Array

ROWS, BLOCKS = 600, 20
BREAKAWAY, WIDTH = 0.2, 0.004
SIZE = 12.0  # of a breakaway, in noise
Usual = tuple[tuple[str, float], ...] | None


def library() -> tuple[Candidate, ...]:
    """Stiction in its first form, a gain and a leak of joint 1."""
    return (
        *candidates_of_effects(("stiction",), (1,))[:1],
        *candidates_of_effects(("flow_gain_error", "internal_leakage"), (1,)),
    )


def cell_of(usual: Usual, seed: int = 3) -> Cell:
    """Rows that only the right breakaway explains; gain and leak are like it by 0.6."""
    rng = np.random.default_rng(seed)
    own = rng.normal(size=ROWS)
    others = [0.6 * own + 0.8 * rng.normal(size=ROWS) for _ in range(2)]
    noise = rng.normal(size=ROWS)
    slots = [effect.parameter_slots[0] for effect in library()]

    def whitened(sets: ParameterSets) -> Array:
        out = []
        for row in range(sets.set_count):
            breakaway, gain, leak = (sets.get(slot, row) for slot in slots)
            near = np.exp(-(((breakaway - BREAKAWAY) / WIDTH) ** 2))
            model = SIZE * own * near + SIZE * (others[0] * gain / 0.1 + others[1] * leak / 0.01)
            out.append(SIZE * own + noise - model)
        return np.array(out)

    block = np.arange(ROWS) * BLOCKS // ROWS
    rows = ResidualRows(block % 4, block, np.zeros(ROWS, np.int64), np.zeros(ROWS, np.int64))
    base = neutral_sets(1)
    t_s = 0.05 * np.arange(ROWS)
    return Cell(
        "actuator",
        1,
        "rad",
        library(),
        base,
        whitened,
        rows,
        np.ones(ROWS),
        1.0,
        True,
        (),
        t_s,
        baseline_gain_nats=usual,
    )


def names_of(fit: WholeFit) -> dict[str, float]:
    return {term.effect.name: float(term.theta[0]) for term in fit.best_fit.current_terms if term.is_present}


@pytest.mark.parametrize("usual", [None, (("stiction", 5.0),)], ids=["no baseline", "baseline"])
def test_a_narrow_optimum_is_found_and_not_what_imitates_it(usual: Usual) -> None:
    found = names_of(fit_and_prune(cell_of(usual), library()))
    assert found.keys() == {"stiction"}
    assert found["stiction"] == pytest.approx(BREAKAWAY, abs=0.5 * WIDTH)


def test_a_fit_without_some_of_its_effects_is_fitted_again_and_trusted_less() -> None:
    cell = cell_of(None)
    there = {"stiction": BREAKAWAY, "flow_gain_error": 0.002}
    start = tuple(
        EffectTerm(effect, np.array([there.get(effect.name, 0.0)]), effect.name in there) for effect in library()
    )
    whole = fit_and_prune(cell, (), start)
    without = refit_reduced(
        whole, [term for term in whole.best_fit.current_terms if term.effect.name == "flow_gain_error"]
    )
    assert names_of(without).keys() <= {"flow_gain_error"}
    assert np.mean(without.correlation_weight) < 0.2 * np.mean(whole.correlation_weight)
