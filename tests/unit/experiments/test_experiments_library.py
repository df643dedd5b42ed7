"""The library's motions stay within the machine's limits, and survive the way through JSON."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from diagnosis.errors import DiagnosisError
from diagnosis.experiments.described import describe_motions, experiment_of, spline_course
from diagnosis.experiments.library import (
    ACCELERATION_SPEED_RATIO_PER_S,
    JOINT_LIMIT_MARGIN_RAD,
    SAMPLE_PERIOD_S,
    SPEED_LIMIT_FRAC,
    Motion,
    Postures,
    library_motions,
)
from diagnosis.experiments.postures import candidate_postures, gravity_extremes, look_posture_choices
from diagnosis.log.nominal import nominal_of
from machine.effects.layout import neutral_sets

MACHINE = (Path(__file__).parents[3] / "machine" / "machines" / "hiab033.toml").read_text(encoding="utf-8")
CENTRE = np.array([0.3, 0.5, -1.0, 0.2, 0.8, -0.4])


@pytest.fixture(scope="module")
def nominal():
    return nominal_of(MACHINE)


@pytest.fixture(scope="module")
def library(nominal):
    sets = neutral_sets(nominal.n)
    loaded = gravity_extremes(nominal, sets, candidate_postures(nominal, CENTRE, np.random.default_rng(1)), (1, 2))
    assert loaded is not None
    return library_motions(nominal, CENTRE, (1, 2), loaded)


def test_motions_keep_range_speed_and_acceleration(nominal, library):
    gain = nominal.actuators.joints[:, 0]
    for one in library:
        assert (one.q >= nominal.q_min + JOINT_LIMIT_MARGIN_RAD - 1e-9).all(), one.name
        assert (one.q <= nominal.q_max - JOINT_LIMIT_MARGIN_RAD + 1e-9).all(), one.name
        speed = np.gradient(one.q, SAMPLE_PERIOD_S, axis=0)
        assert (np.abs(speed).max(axis=0) <= 1.01 * SPEED_LIMIT_FRAC * gain).all(), one.name
        acceleration = np.abs(np.gradient(speed, SAMPLE_PERIOD_S, axis=0)[2:-2]).max(axis=0)
        assert (acceleration <= 1.3 * ACCELERATION_SPEED_RATIO_PER_S * gain).all(), (one.name, acceleration / gain)


@pytest.mark.parametrize("half_range_rad", [3.0, 0.05, 0.02, 0.0])
def test_they_keep_the_range_wherever_it_was_recorded_and_however_small_it_is(nominal, half_range_rad):
    rng = np.random.default_rng(7)
    low, high = nominal.q_min.copy(), nominal.q_max.copy()
    low[4], high[4] = np.maximum(low[4], -half_range_rad), np.minimum(high[4], half_range_rad)
    narrow = replace(nominal, q_min=low, q_max=high)
    sets = neutral_sets(nominal.n)
    for _ in range(4):
        centre = rng.uniform(low - 0.05, high + 0.05)
        loaded = gravity_extremes(narrow, sets, candidate_postures(narrow, centre, rng), (1, 2, 4))
        for one in library_motions(narrow, centre, (1, 2, 4), loaded):
            assert (one.q >= low - 1e-9).all(), one.name
            assert (one.q <= high + 1e-9).all(), one.name


def test_motions_begin_and_end_at_rest_in_the_same_posture(library):
    for one in library:
        assert np.abs(one.q[0] - CENTRE).max() < 1e-6, one.name
        assert np.abs(one.q[-1] - CENTRE).max() < 2e-3, one.name
        assert np.abs(one.q[1] - one.q[0]).max() < 1e-3, one.name


def test_the_library_holds_what_the_task_names(library):
    names = {one.name for one in library}
    assert {"multisine", "small steps", "steps", "large steps", "slow reversals through zero"} <= names
    assert {"staircase around zero", "hold under load", "the same motion at high and at low load"} <= names
    assert "all joints together" in names


def test_descriptions_survive_json_to_half_a_milliradian(library):
    for one in library:
        back = experiment_of(json.loads(json.dumps(describe_motions(one))))
        assert isinstance(back, Motion)
        rows = len(back.q)
        assert np.abs(back.q - one.q[:rows]).max() < 5e-4, one.name
        assert (back.name, back.segment_kind) == (one.name, one.segment_kind)


def test_postures_survive_json():
    one = Postures("two distances", np.array([[0.1, 0.2], [0.3, 0.4]]))
    back = experiment_of(json.loads(json.dumps(describe_motions(one))))
    assert isinstance(back, Postures)
    assert np.array_equal(back.q, one.q)


def test_what_is_no_description_is_refused():
    with pytest.raises(DiagnosisError, match="not an experiment's description"):
        experiment_of({"kind": "motion", "name": "multisine"})


def test_the_spline_meets_its_knots_and_rests_at_both_ends():
    knots = np.random.default_rng(3).normal(size=(7, 2))
    course = spline_course(knots, 10)
    assert np.allclose(course[::10], knots, atol=1e-12)
    assert np.abs(course[1] - course[0]).max() < 0.1 * np.abs(course[5] - course[0]).max()


def test_looks_differ_in_what_they_are_called_by(nominal):
    sets = neutral_sets(nominal.n)
    qs = candidate_postures(nominal, CENTRE, np.random.default_rng(2))
    found = {one.name: one.q for one in look_posture_choices(nominal, sets, qs, None)}
    near, far = found["postures near each other"], found["postures across the range"]
    assert np.ptp(far, axis=0).max() > 2.0 * np.ptp(near, axis=0).max()


def test_extremes_are_where_gravity_loads_most_and_least(nominal):
    from machine.effects.structure import gravity_torques

    sets = neutral_sets(nominal.n)
    qs = candidate_postures(nominal, CENTRE, np.random.default_rng(1))
    both = gravity_extremes(nominal, sets, qs, (1,))
    assert both is not None
    high, low = (float(abs(gravity_torques(nominal.arm, sets, q[None])[0, 1])) for q in both)
    assert high > 1.3 * low
