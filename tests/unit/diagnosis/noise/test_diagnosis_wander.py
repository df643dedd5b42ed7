"""What a machine's numbers wander by from day to day is noise of those numbers, and of nothing else."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import recording

from diagnosis.answer import answer_json
from diagnosis.baseline.baseline import Baseline
from diagnosis.baseline.left_over import cells_of, remainders_of, with_baseline, with_wanders
from diagnosis.budget import budget_of
from diagnosis.known.wander import wander_of
from diagnosis.noise.of_a_day import day_noise
from diagnosis.reading.read import Read, examine_recording
from diagnosis.search.cell import Cell
from diagnosis.search.fit import neutral_fit
from diagnosis.whole_model.parts import library_of
from diagnosis.whole_model.solve import fit_and_prune
from longreach.fit_baseline import report_of
from machine.effects.entries import EffectEntry, make_entry
from machine.effects.registry import effect_named
from machine.remainder import Remainder, parse_remainders, remainders_to_toml

KINDS = ("repeat", "repeat", "repeat", "steps", "workcycle")
WANDER = 0.01


def gain(size: float) -> EffectEntry:
    effect = effect_named("flow_gain_error")
    assert effect is not None
    return make_entry(effect, 2, {"gain_frac": size})


@pytest.fixture(scope="module")
def days() -> list[Read]:
    """Eight undisturbed days of a machine whose second joint is a percent faster or slower on each."""
    rng, out = np.random.default_rng(5), []
    for seed in range(8):
        made = recording(KINDS, (gain(WANDER * float(rng.normal())),), seed)
        out.append(examine_recording(made, Path(f"day {seed}")))
    return out


@pytest.fixture(scope="module")
def known(days: list[Read]) -> tuple[Remainder, ...]:
    return with_wanders(remainders_of(days), days)


def actuator(whole: Read, joint: int) -> Cell:
    return next(one for one in cells_of(whole) if one.label == f"actuator {joint}")


def test_the_number_that_wanders_is_named_with_its_size_and_its_neighbours_are_not(days: list[Read]) -> None:
    found = dict(wander_of([actuator(day, 2) for day in days]))
    assert found["flow_gain_error"] == pytest.approx(WANDER, rel=0.6)
    assert max((size for name, size in found.items() if name != "flow_gain_error"), default=0.0) < WANDER
    assert wander_of([actuator(day, 1) for day in days]) == ()
    assert wander_of([actuator(day, 2) for day in days[:5]]) == ()


def names(whole: Read, known: tuple[Remainder, ...]) -> list[str]:
    cell = actuator(with_baseline(whole, (), known), 2)
    return [
        term.effect.name for term in fit_and_prune(cell, library_of(cell)).best_fit.current_terms if term.is_present
    ]


def test_a_day_within_the_wander_has_no_name_and_a_fault_beyond_it_has(known: tuple[Remainder, ...]) -> None:
    plain = tuple(Remainder(one.stage, one.joint, one.on, one.sigma, one.rms, one.ar) for one in known)
    usual = examine_recording(recording(KINDS, (gain(1.2 * WANDER),), 20), Path("usual"))
    assert names(usual, plain) == ["flow_gain_error"]
    assert names(usual, known) == []
    broken = examine_recording(recording(KINDS, (gain(0.12),), 21), Path("broken"))
    assert names(broken, known) == ["flow_gain_error"]


def test_what_is_beside_the_wanders_direction_is_left_as_it_was() -> None:
    rng = np.random.default_rng(1)
    column, r = rng.normal(size=(50, 1)), rng.normal(size=50)
    white = day_noise(3.0 * column).whiten(r[None])[0]
    along = column[:, 0] / np.linalg.norm(column)
    np.testing.assert_allclose(white - (white @ along) * along, r - (r @ along) * along, atol=1e-12)
    size = 1.0 + 9.0 * float(column[:, 0] @ column[:, 0])
    assert white @ along == pytest.approx((r @ along) / np.sqrt(size))


def test_days_that_wander_come_out_white(days: list[Read], known: tuple[Remainder, ...]) -> None:
    before = [float(np.sum(neutral_fit(actuator(day, 2)).residual ** 2)) for day in days]
    after = [float(np.sum(neutral_fit(actuator(with_baseline(day, (), known), 2)).residual ** 2)) for day in days]
    assert sum(after) < 0.5 * sum(before)


def test_a_wander_goes_through_the_machine_file() -> None:
    record = Remainder("actuator", 2, "", 1e-5, 2e-5, wander=(("flow_gain_error", 0.004), ("valve_lag", 1e-3)))
    assert parse_remainders(tomllib.loads(remainders_to_toml([record]))["remainder"]) == (record,)


def test_a_set_is_made_white_alike_alone_and_among_others() -> None:
    rng = np.random.default_rng(2)
    day, sets = day_noise(rng.normal(size=(999, 4))), rng.normal(size=(7, 999))
    together = day.whiten(sets)
    for one, white in zip(sets, together, strict=True):
        np.testing.assert_array_equal(day.whiten(one[None])[0], white)


def test_an_experiment_is_foretold_with_the_wander_along(known: tuple[Remainder, ...]) -> None:
    effect = effect_named("valve_asymmetry")
    assert effect is not None
    small = make_entry(effect, 2, {"gain_frac": 0.04})
    whole = examine_recording(recording(KINDS, (small,), 22), Path("small"))
    said = answer_json(budget_of(with_baseline(whole, (), known)))
    assert said["next_experiment"] is not None


def test_the_command_says_what_wanders_and_in_which_unit() -> None:
    left = Remainder("actuator", 2, "", 1e-5, 2e-5, wander=(("flow_gain_error", 0.0042), ("valve_lag", 1.1e-3)))
    text = report_of(Baseline((), (left,), ()), 3, 18)
    assert "actuator 2: flow_gain_error wanders by 0.0042 from day to day" in text
    assert "actuator 2: valve_lag wanders by 0.0011 s from day to day" in text
