"""Two effects that fit alike: the one whose size is the same in every kind of motion is named, given a baseline."""

from dataclasses import replace

import numpy as np
import pytest
from made_up_cell import COLUMNS, GAIN, LAG, made_up

from diagnosis.hypotheses import hypotheses_of
from diagnosis.search.cell import Cell
from diagnosis.whole_model.evidence import evidence_of
from diagnosis.whole_model.invariant import most_invariant
from diagnosis.whole_model.parts import library_of
from diagnosis.whole_model.probability import probability
from diagnosis.whole_model.solve import WholeFit, fit_and_prune, refit_with_exchanged_term
from machine.effects.layout import ParameterSets

GAIN_NAME, LAG_NAME = "flow_gain_error", "valve_lag"
UNUSUAL = (("valve_asymmetry", 0.0),)
Z, APART = 8.0, 3.3  # size of the cause, and of what the other one cannot imitate [noise floors]


def imitated(usual: tuple[tuple[str, float], ...] | None) -> Cell:
    """A gain, and a lag whose column is the gain's in one kind of motion and less of it in the other."""
    plain = made_up((0.0, 0.0, 0.0), noise=1.0)
    own = COLUMNS[0] / np.linalg.norm(COLUMNS[0])
    second = np.where(plain.rows.fold == plain.rows.fold.max(), own, 0.0)
    off = second - own * (own @ second)
    other = Z * own + APART * off / np.linalg.norm(off)
    noise = plain.whitened(plain.baseline_parameters)[0]
    basis = np.linalg.qr(np.stack([own, off], axis=1))[0]
    noise = noise - basis @ (basis.T @ noise)

    def whitened(sets: ParameterSets) -> np.ndarray:
        gain, lag = (sets.joint_parameters[:, 0, slot.column] for slot in (GAIN, LAG))
        return noise + Z * own - 20.0 * (gain[:, None] * Z * own + lag[:, None] * other)

    candidates = tuple(one for one in plain.candidates if one.name in ("flow_gain_error", "valve_lag"))
    return replace(plain, whitened=whitened, candidates=candidates, baseline_gain_nats=usual)


def named(fit: WholeFit) -> list[str]:
    return [term.effect.name for term in fit.best_fit.current_terms if term.is_present]


def imitation(usual: tuple[tuple[str, float], ...] | None) -> WholeFit:
    """The fit by the lag alone."""
    cell = imitated(usual)
    fit = fit_and_prune(cell, library_of(cell))
    assert named(fit) == ["flow_gain_error"]
    gain, lag = (
        next(term for term in fit.best_fit.current_terms if term.effect.name == name) for name in (GAIN_NAME, LAG_NAME)
    )
    return refit_with_exchanged_term(fit, gain, (lag,))


def test_an_imitation_is_doubtful_for_its_scatter_and_gives_way_to_the_cause() -> None:
    fit = imitation(UNUSUAL)
    assert named(fit) == [LAG_NAME]
    (found,) = evidence_of(fit)
    assert found.size_scatter_frac > 0.1
    assert probability(found) < 0.5
    best = most_invariant(fit)
    assert named(best) == [GAIN_NAME]
    assert probability(evidence_of(best)[0]) > 0.9


def test_without_a_baseline_nothing_is_exchanged() -> None:
    fit = imitation(None)
    assert most_invariant(fit) is fit


@pytest.mark.parametrize(("size", "sets"), [(0.0, 1), (0.006, 2)])
def test_what_is_just_not_seen_is_among_the_sets_that_hold_90_percent(size: float, sets: int) -> None:
    cell = replace(made_up((size, 0.0, 0.0)), baseline_gain_nats=UNUSUAL)
    fit = fit_and_prune(cell, library_of(cell))
    assert named(fit) == []
    found = hypotheses_of((), (fit,))
    assert len(found) == sets
    assert found[0].effects == ()
    assert 0.9 <= sum(one.probability for one in found) <= 1.0
    if sets > 1:
        assert found[1].effects[0][0].effect_and_joint == (GAIN_NAME, 1)
