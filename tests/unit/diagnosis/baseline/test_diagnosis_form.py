"""What a model is wrong by on every undisturbed day is taken as known: fitted on some recordings, true of the next."""

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import entry, folder, recording
from typer.testing import CliRunner

from diagnosis.baseline.left_over import cells_of, forms_of, with_baseline, with_mosts
from diagnosis.errors import DiagnosisError
from diagnosis.known.courses import (
    OSCILLATION_DAMPING_RATIO,
    OSCILLATION_FREQUENCIES_HZ,
    RESPONSE_FAMILY_NAMES,
    Course,
    actuator_responses,
)
from diagnosis.known.form import form_of, with_form
from diagnosis.reading.read import Read, examine_recording
from diagnosis.search.cell import Cell
from diagnosis.search.fit import neutral_fit
from longreach.cli import app
from machine.effects.entries import EffectEntry
from machine.remainder import Remainder, parse_remainders, remainders_to_toml

KINDS = ("repeat", "repeat", "repeat", "steps", "workcycle")


@cache
def day(seed: int, *effects: EffectEntry) -> Read:
    return examine_recording(recording(KINDS, effects, seed), Path(f"day {seed}"))


def actuator(whole: Read, joint: int) -> Cell:
    return next(one for one in cells_of(whole) if one.label == f"actuator {joint}")


def energy(cell: Cell) -> float:
    return float(np.mean(neutral_fit(cell).residual ** 2))


def test_what_is_wrong_every_day_is_foretold_on_the_next_and_hides_no_fault() -> None:
    own = entry("valve_asymmetry", 2, gain_frac=0.005)  # what the model is wrong by, and nobody has named
    days = [day(seed, own) for seed in (1, 2, 3)]
    forms = forms_of(days)
    assert [one.joint for one in forms] == [2]
    next_day = day(4, own)
    plain, known = actuator(next_day, 2), actuator(with_baseline(next_day, (), forms), 2)
    assert energy(plain) > 10.0
    assert energy(known) < 1.2
    broken = day(5, own, entry("valve_deadband", 2, half_width_frac=0.01))
    assert energy(actuator(with_baseline(broken, (), forms), 2)) > 1000.0


def test_noise_has_no_form_and_two_recordings_tell_none() -> None:
    days = [day(seed) for seed in (1, 2, 3)]
    assert forms_of(days) == ()
    own = entry("valve_asymmetry", 2, gain_frac=0.02)
    assert form_of([actuator(day(seed, own), 2) for seed in (4, 5)]) == ()


def test_a_form_goes_through_the_machine_file() -> None:
    record = Remainder("actuator", 2, "", 1e-5, 2e-5, form=(("the angle", (0.5, -1e-3)), ("other joints", (1e-9,))))
    lines = remainders_to_toml([record])
    assert parse_remainders(tomllib.loads(lines)["remainder"]) == (record,)


@pytest.mark.parametrize(
    ("form", "words"),
    [
        ((("the angle", (1.0, 2.0)),), "form.the angle has 2 numbers, 10 wanted"),
        ((("the weather", (1.0,)),), "form.the weather has 1 numbers, no such family"),
    ],
)
def test_a_form_of_another_arm_is_named(form: tuple, words: str) -> None:
    whole = day(1)
    cell, nominal = actuator(whole, 2), whole.nominal_machine
    assert nominal is not None
    other = replace(nominal, baseline_remainders=(Remainder("actuator", 2, "", 0.0, 0.0, form=form),))
    with pytest.raises(DiagnosisError, match=words):
        with_form([cell], other)


def test_the_command_says_it_without_a_traceback(tmp_path: Path) -> None:
    wrong = Remainder("actuator", 2, "", 0.0, 0.0, form=(("the angle", (1.0,)),))
    run = folder(tmp_path, recording(("repeat", "steps")))
    machine = run / "machine.toml"
    machine.write_text(machine.read_text(encoding="utf-8") + remainders_to_toml([wrong]), encoding="utf-8")
    said = CliRunner().invoke(app, ["diagnose", str(run)])
    assert said.exit_code == 2
    assert "form.the angle has 1 numbers, 10 wanted; fit the baseline again" in said.output


def test_what_a_machine_answers_later_is_foretold_too() -> None:
    own = entry("valve_lag", 2, time_constant_s=0.06)
    days = [day(seed, own) for seed in (1, 2, 3)]
    (form,) = (dict(one.form) for one in forms_of(days) if one.joint == 2)
    assert set(form) & set(RESPONSE_FAMILY_NAMES)
    next_day = day(4, own)
    assert energy(actuator(with_baseline(next_day, (), forms_of(days)), 2)) < 0.1 * energy(actuator(next_day, 2))


def test_a_form_asked_about_a_motion_unlike_any_is_left_out() -> None:
    own = entry("valve_asymmetry", 2, gain_frac=0.005)
    days = [day(seed, own) for seed in (1, 2, 3)]
    forms = forms_of(days)
    forms = with_mosts(forms, [with_baseline(one, (), forms) for one in days])
    calm = tuple(replace(one, form_most=1e-3 * one.form_most) for one in forms)
    whole = day(4, own)
    known, unlike = (actuator(with_baseline(whole, (), one), 2) for one in (forms, calm))
    assert energy(known) < energy(unlike)
    formless = tuple(replace(one, form=()) for one in forms)
    assert energy(unlike) == pytest.approx(energy(actuator(with_baseline(whole, (), formless), 2)))


@pytest.mark.parametrize("step_s", [0.001, 0.005, 0.04])
def test_a_swing_is_the_same_at_every_step(step_s: float) -> None:
    t = np.arange(0.0, 4.0, step_s)
    u = np.where(t > 0.2, 1.0, 0.0)
    nothing = np.zeros(len(t))
    own = actuator_responses(Course(step_s, t, nothing, u, nothing, nothing[:, None], t))["swings"]
    omega = 2.0 * np.pi * OSCILLATION_FREQUENCIES_HZ
    s = omega * (-OSCILLATION_DAMPING_RATIO + 1j * np.sqrt(1.0 - OSCILLATION_DAMPING_RATIO**2))
    later = t[-1] - (t[u > 0.0][0])
    expected = (np.exp(s * later) - 1.0) / s
    np.testing.assert_allclose(own[-1], np.concatenate([expected.real, expected.imag]), atol=1e-9)


def test_one_joint_alone_has_no_others_to_answer_to() -> None:
    t = np.arange(100) * 0.01
    found = actuator_responses(Course(0.01, t, t, np.sin(t), 0.0 * t, np.zeros((100, 0)), t))
    assert {name: one.shape for name, one in found.items()} == {
        "echoes": (100, 20),
        "catching up": (100, 35),
        "swings": (100, 18),
        "uneven swings": (100, 18),
        "the other joints' swings": (100, 0),
    }
