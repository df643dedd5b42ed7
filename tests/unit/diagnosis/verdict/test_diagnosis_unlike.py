"""Joints whose command was far off moved unlike an undisturbed machine: what is left there is a lead, no refusal."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import recording

from diagnosis.answer import answer
from diagnosis.chain.unlike import told_beyond
from diagnosis.diagnose import Diagnosis, diagnose
from diagnosis.reading.read import examine
from diagnosis.refusal.remainder import tests_of as fired_tests
from diagnosis.search.candidates import named
from diagnosis.search.search import search
from machine.effects.entries import make_entry
from machine.effects.layout import ParameterSets
from machine.effects.registry import effect_named
from machine.remainder import USUAL_ENERGY

KINDS = ("repeat", "repeat", "steps", "workcycle")


def diagnosed(name: str, **values: float) -> Diagnosis:
    """A recording with one effect on joint 2."""
    effect = effect_named(name)
    assert effect is not None
    return diagnose(examine(recording(KINDS, (make_entry(effect, 2, values),), 3), Path(name)))


@pytest.fixture(scope="module")
def little_off() -> Diagnosis:
    """A gain that is 3 % too high."""
    return diagnosed("controller_gain_error", gain_frac=0.03)


def test_a_command_that_is_cut_marks_its_joint_and_all_that_hangs_on_it() -> None:
    found = diagnosed("controller_saturation", limit_frac=0.1)
    cells = [one.search.cell for one in found.cells]
    assert {cell.unlike for cell in cells if cell.label == "controller 2"} == {()}  # judged by its own model
    assert {cell.unlike for cell in cells if cell.stage == "actuator"} == {(2,)}
    assert "joint 2 moved unlike its model's commands ask" in str(answer(found)["missing"])


def test_a_gain_that_is_a_little_off_moves_the_joint_alike(little_off: Diagnosis) -> None:
    assert {one.search.cell.unlike for one in little_off.cells} == {()}


def test_behind_joints_that_moved_unlike_energy_alone_is_no_test(little_off: Diagnosis) -> None:
    cell = next(one.search.cell for one in little_off.cells if one.search.cell.stage == "actuator")
    loud = 2.0 * np.random.default_rng(1).normal(size=cell.rows.count)
    behind = replace(cell, stage="structure")
    assert "energy" in {one.test for one in fired_tests(behind, loud, 1)}
    assert "energy" not in {one.test for one in fired_tests(replace(behind, unlike=(2,)), loud, 1)}
    assert "energy" in {one.test for one in fired_tests(replace(cell, unlike=(2,)), loud, 1)}


@pytest.mark.parametrize(
    ("width_rad", "usual", "told"),
    [(0.001, True, False), (0.001, False, True), (0.004, True, True)],
)
def test_behind_joints_that_moved_unlike_a_play_has_to_be_large(
    little_off: Diagnosis, width_rad: float, usual: bool, told: bool
) -> None:
    at = next(one.search.cell for one in little_off.cells if one.search.cell.stage == "actuator")
    rng = np.random.default_rng(3)
    noise, course = rng.normal(size=at.rows.count), np.sin(0.1 * np.arange(at.rows.count))
    play = named(("backlash",), (2,))
    column, per_rad = play[0].slots[0].column, 8e3 / np.linalg.norm(course)

    def left(sets: ParameterSets) -> np.ndarray:
        return noise + per_rad * np.outer(width_rad - sets.joint[:, 1, column], course)

    known = ((USUAL_ENERGY, 1.0),) if usual else ()
    cell = replace(at, stage="structure", joint=None, candidates=play, whitened=left, usual=known)
    behind = search(cell)
    assert [one.name for one in behind.chosen.fit.hypothesis] == ["backlash"]
    assert told_beyond([behind], [replace(behind, cell=at)])[0].chosen is behind.chosen
    (after,) = told_beyond([behind], [replace(behind, cell=replace(at, unlike=(1,)))])
    assert after.cell.unlike == (1,)
    assert [one.name for one in after.chosen.fit.hypothesis] == (["backlash"] if told else [])


def test_behind_the_joints_twice_what_any_day_left_is_asked_for(little_off: Diagnosis) -> None:
    cell = next(one.search.cell for one in little_off.cells if one.search.cell.stage == "actuator")
    loud = np.sqrt(2.0) * np.random.default_rng(1).normal(size=cell.rows.count)  # twice the floor's energy
    known = replace(cell, stage="structure", usual=((USUAL_ENERGY, 1.3),))
    assert "energy" not in {one.test for one in fired_tests(known, loud, 1)}
    assert "energy" in {one.test for one in fired_tests(known, 1.5 * loud, 1)}


def test_a_pattern_of_a_joint_that_moved_unlike_is_no_test(little_off: Diagnosis) -> None:
    cell = next(one.search.cell for one in little_off.cells if one.search.cell.label == "actuator 2")
    swinging = 1.5 * np.sin(0.4 * np.arange(cell.rows.count))
    assert {"autocorrelation", "peak"} <= {one.test for one in fired_tests(cell, swinging, 1)}
    assert fired_tests(replace(cell, unlike=(2,)), swinging, 1) == ()
    assert "autocorrelation" in {one.test for one in fired_tests(replace(cell, unlike=(1,)), swinging, 1)}
