"""Baselines: what a machine file carries, floors raised by a remainder, joined cells, a fit that finds its effects."""

import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from diagnosis_cases import MACHINE_TOML, entry
from made_up_cell import made_up
from scipy.signal import lfilter

from diagnosis.baseline.left_over import prediction_limit
from diagnosis.cells.behind import cells_without, join_cells, shown_behind
from diagnosis.log.nominal import nominal_of
from diagnosis.noise.floor import Floor, Whitener, with_remainder
from diagnosis.search.candidates import candidates_of_effects, parameter_sets_with
from diagnosis.search.fit import Fit, entries_of
from diagnosis.whole_model.parts import library_of
from diagnosis.whole_model.solve import fit_and_prune
from longreach.fit_baseline import with_baseline
from machine.description import parse_machine_toml
from machine.effects.entries import entries_to_toml, pack_effects, parse_entries
from machine.effects.layout import neutral_sets
from machine.effects.registry import EFFECTS
from machine.effects.spec import Effect
from machine.errors import MachineFileError
from machine.remainder import Remainder, parse_remainders, remainders_to_toml

REMAINDER = Remainder("actuator", 2, "", 1.5e-5, 4e-5, (0.7, -0.1))
OF_POINTS = Remainder(
    "structure", None, "tracker", 1e-4, 2e-4, by_axis=(1e-4, 2e-4, 3e-4), oscillation_rad=4e-4, level=1.2
)


def test_a_machine_file_carries_its_baseline() -> None:
    lag = entry("valve_lag", 2, time_constant_s=0.03)
    text = MACHINE_TOML + entries_to_toml([lag]) + remainders_to_toml([REMAINDER, OF_POINTS])
    machine, nominal = parse_machine_toml(text), nominal_of(text)
    assert machine.effects == nominal.baseline_effects == (lag,)
    assert machine.remainders == nominal.baseline_remainders == (REMAINDER, OF_POINTS)
    assert nominal.baseline_remainder("actuator", 2) == REMAINDER
    assert nominal.baseline_remainder("actuator", 1) is None
    assert parse_machine_toml(MACHINE_TOML).effects == ()


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"stage": "weather"}, "stage = 'weather'"),
        ({"stage": "link", "sigma": -1.0}, "sigma = -1"),
        ({"stage": "link", "spread": 1.5}, "a baseline of an older version has to be fitted again".capitalize()),
        ({"stage": "link", "joint": 0}, "joint = 0"),
        ({"stage": "link", "level": 0.5}, "level = 0.5"),
        ({"stage": "link", "colour": 1}, "unknown key 'colour'"),
        ({"stage": "link", "ar": ["x"]}, "ar = 'x'"),
        ({"stage": "structure", "oscillation_rad": -1.0}, "oscillation_rad = -1"),
        ({"stage": "link", "form": [1.0]}, "form = [1.0] is not a table"),
        ({"stage": "link", "form": {"speed": ["x"]}}, "form.speed = 'x'"),
        ({"stage": "actuator", "joint": 1, "wander": {"flow_gain": 0.01}}, "wander.flow_gain: the catalogue has no"),
        ({"stage": "actuator", "joint": 1, "wander": {"payload_error": 1.0}}, "wander.payload_error: the catalogue"),
    ],
)
def test_a_wrong_remainder_is_named(table: dict, words: str) -> None:
    with pytest.raises(MachineFileError, match=re.escape(words)):
        parse_remainders([table])


def test_the_old_key_of_the_slew_oscillation_is_read() -> None:
    (remainder,) = parse_remainders([{"stage": "structure", "on": "tracker", "sigma": 1e-4, "swing_rad": 4e-4}])
    assert remainder.oscillation_rad == 4e-4


def test_a_new_baseline_takes_the_old_ones_place() -> None:
    old = (
        MACHINE_TOML + entries_to_toml([entry("valve_lag", 2, time_constant_s=0.03)]) + remainders_to_toml([REMAINDER])
    )

    class Found:
        effects = (entry("backlash", 1, width_rad=0.001),)
        remainders = ()

    text = with_baseline(old, Found())  # pyright: ignore[reportArgumentType]
    nominal = nominal_of(text)
    assert [effect.name for effect in nominal.baseline_effects] == ["backlash"]
    assert nominal.baseline_remainders == ()
    assert parse_machine_toml(text).joints == parse_machine_toml(MACHINE_TOML).joints


@pytest.mark.parametrize("size", [0.3, 1.0, 5.0])
def test_remainder_and_noise_come_out_white_together(size: float) -> None:
    """Whichever is the larger: a swing (autoregressive) with coloured noise on top of it."""
    rng = np.random.default_rng(1)
    noise = [lfilter([1.0], [1.0, 0.0, 0.6], rng.normal(0.0, size, (4000, 1)), axis=0) for _ in range(2)]
    plain = Floor(np.ones(1), np.ones(1), Whitener(np.zeros((0, 1)), np.ones(1)), True)
    ar, sigma = np.array([[0.9], [-0.5]]), np.array([2.0])
    raised = with_remainder(plain, noise, ar, sigma, np.array([3.0]))
    swing = lfilter([1.0], [1.0, -0.9, 0.5], rng.normal(0.0, 2.0, (4000, 1)), axis=0)
    other = lfilter([1.0], [1.0, 0.0, 0.6], rng.normal(0.0, size, (4000, 1)), axis=0)
    white = raised.whitener.whiten(swing + other)[:, 0]
    assert np.var(white) == pytest.approx(1.0, abs=0.08)
    rho = [float(white[k:] @ white[:-k]) / float(white @ white) for k in range(1, 20)]
    assert np.abs(rho).max() < 0.06
    assert raised.increment_rms[0] == pytest.approx(np.sqrt(10.0))


def test_a_joint_without_a_remainder_keeps_its_floor() -> None:
    plain = Floor(np.ones(2), np.ones(2), Whitener(np.full((1, 2), 0.3), np.ones(2)), True)
    noise = [np.random.default_rng(2).normal(0.0, 1.0, (4000, 2))]
    raised = with_remainder(plain, noise, np.array([[0.5, 0.0]]), np.array([2.0, 0.0]), np.array([3.0, 0.0]))
    assert raised.whitener.innovation_sigma[1] == 1.0
    np.testing.assert_allclose(raised.whitener.ar_coefficients[:, 1], [0.3, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_joined_cells_ask_for_an_effect_once() -> None:
    truth = (0.15, 0.0, 0.0)
    parts = [made_up(truth), made_up(truth)]
    both = join_cells(parts)
    assert both.rows.row_count == 2 * parts[0].rows.row_count
    assert len(both.candidates) == len(parts[0].candidates)
    assert len(np.unique(both.rows.block)) == 2 * len(np.unique(parts[0].rows.block))
    np.testing.assert_array_equal(
        both.whitened(both.baseline_parameters)[0, : parts[0].rows.row_count],
        parts[0].whitened(both.baseline_parameters)[0],
    )
    one, two = (fit_and_prune(cell, library_of(cell)) for cell in (parts[0], both))
    assert [term.effect.effect_and_joint for term in two.best_fit.current_terms if term.is_present] == [
        term.effect.effect_and_joint for term in one.best_fit.current_terms if term.is_present
    ]
    assert (
        two.best_fit.log_posterior_nats < 1.5 * one.best_fit.log_posterior_nats < 0.0
    )  # twice the cost of what is left


def test_a_healthy_recording_stays_below_the_level_that_others_predict() -> None:
    rng = np.random.default_rng(5)
    sets = rng.lognormal(0.1, 0.3, (2000, 7))
    below = [row[-1] < prediction_limit(list(row[:-1])) for row in sets]
    assert np.mean(below) > 0.997
    assert prediction_limit([1.3]) == 1.0


def test_an_effect_can_be_taken_out_of_the_library() -> None:
    cell = made_up((0.15, 0.0, 0.0))
    gone = cell.candidates[0].name
    (less,) = cells_without([cell], (gone,))
    assert gone not in {one.name for one in less.candidates}
    assert len(less.candidates) < len(cell.candidates)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda one: one.name)
def test_whatever_a_fit_names_can_be_written_to_a_machine_file_and_is_the_same_there(effect: Effect) -> None:
    (one, *_) = candidates_of_effects((effect.name,), (1,))
    inside = [
        0.3 * slot.typical_max if one.vector else slot.lower_bound + 0.6 * min(slot.typical_max - slot.lower_bound, 1.0)
        for slot in one.parameter_slots
    ]
    theta = np.array(inside)
    found = Fit((one,), theta, np.zeros(0), np.zeros((0, len(theta))), 0.0)
    back = parse_entries(tomllib.loads(entries_to_toml(entries_of(found))).get("effect"), 1)
    wanted, packed = parameter_sets_with(neutral_sets(1), (one,), theta), pack_effects(back, 1)
    np.testing.assert_allclose(packed.joint_parameters, wanted.joint_parameters, rtol=1e-9)
    np.testing.assert_allclose(packed.machine_parameters, wanted.machine_parameters, rtol=1e-9)


def test_encoders_are_left_to_what_was_measured_behind_them_if_it_sees_them() -> None:
    cell = made_up((0.15, 0.0, 0.0))
    assert shown_behind([cell]) == ()
    assert shown_behind([]) == ()
    seen = replace(cell, candidates=(*cell.candidates, *candidates_of_effects(("encoder_scale",), (1,))))
    assert shown_behind([seen]) == ("encoder_scale",)
