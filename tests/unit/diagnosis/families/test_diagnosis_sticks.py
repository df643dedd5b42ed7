"""A joint that sticks: sought in small steps, along its own motion, and what it knocks at says nothing."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import entry, recording

from diagnosis.baseline.left_over import cells_of, forms_of, with_baseline
from diagnosis.chain.unlike import UNLIKE_NATS, marked, told_who_sticks
from diagnosis.diagnose import Diagnosis, diagnose
from diagnosis.families.driven import Course
from diagnosis.known.form import Otherwise
from diagnosis.leave_out import leave_named_out, without_effect
from diagnosis.reading.read import Read, examine
from diagnosis.refusal.remainder import tests_of as fired_tests
from diagnosis.replay.stage_replay import Replay
from diagnosis.search.candidates import NARROW, named
from diagnosis.search.cell import Cell
from diagnosis.search.fit import costs, evaluated
from machine.effects.entries import EffectEntry

KINDS = ("repeat", "repeat", "repeat", "steps", "workcycle")
BREAKAWAY = 0.0873  # between two of the coarse sizes, and a valley that none of them lies in


def day(seed: int, *effects: EffectEntry) -> Read:
    return examine(recording(KINDS, effects, seed), Path(f"day {seed}"))


def actuator(whole: Read, joint: int) -> Cell:
    return next(one for one in cells_of(whole) if one.label == f"actuator {joint}")


@pytest.fixture(scope="module")
def stuck() -> Diagnosis:
    return diagnose(day(3, entry("stiction", 2, breakaway_frac=BREAKAWAY)))


def cell_of(found: Diagnosis, label: str) -> Cell:
    return next(one.search.cell for one in found.cells if one.search.cell.label == label)


def test_its_valley_is_found_between_coarse_sizes(stuck: Diagnosis) -> None:
    chosen = [effect.key for one in stuck.cells for effect in one.chosen.fit.hypothesis]
    assert chosen == [("stiction", 2)]
    (found,) = (one.chosen.fit.theta for one in stuck.cells if one.chosen.fit.hypothesis)
    assert found[0] == pytest.approx(BREAKAWAY, rel=0.02)
    for candidate in named(("stiction",), (2,)):
        assert np.diff(np.sort(candidate.starts()[:, 0])).max() <= candidate.slots[0].high / NARROW["stiction"] + 1e-12


def test_what_it_knocks_at_speaks_against_no_name(stuck: Diagnosis) -> None:
    beside, own = cell_of(stuck, "actuator 3"), cell_of(stuck, "actuator 2")
    loud = 3.0 * np.random.default_rng(1).normal(size=beside.rows.count)
    assert beside.knocked
    assert fired_tests(beside, loud, 1) == ()
    assert "energy" in {one.test for one in fired_tests(replace(beside, stuck=(), least_nats=0.0), loud, 1)}
    assert not own.knocked
    assert own.moved_unlike == (2,)
    assert own.least_nats < UNLIKE_NATS
    assert "energy" in {one.test for one in fired_tests(own, loud, 1)}


def test_without_its_name_nobody_is_excused_by_it(stuck: Diagnosis) -> None:
    left = without_effect(stuck, "stiction")
    assert not any(one.search.cell.stuck for one in left.cells)
    assert left.verdict.word in ("outside", "undecided")
    (told,) = leave_named_out(stuck)
    assert (told["without"], told["verdict"]) == ("stiction", left.verdict.word)
    assert told["lost_nats"] > 16.0  # by which the two can be told apart


def test_where_nothing_sticks_nobody_is_told() -> None:
    found = diagnose(day(3, entry("valve_deadband", 2, half_width_frac=0.02)))
    searches = [one.search for one in found.cells]
    assert told_who_sticks(searches) is searches
    assert not any(one.cell.moved_unlike for one in searches)


def test_names_where_a_joint_moved_unlike_are_asked_for_more(stuck: Diagnosis) -> None:
    cell = cell_of(stuck, "actuator 3")
    assert marked(cell, (2,)).least_nats == cell.least_nats
    assert marked(cell, (3,)).least_nats == max(cell.least_nats, UNLIKE_NATS)
    assert marked(replace(cell, stage="controller"), (3,)).least_nats == cell.least_nats


def test_the_form_goes_with_how_a_stuck_joint_moves() -> None:
    own = entry("valve_asymmetry", 2, gain_frac=0.02)  # what the model is wrong by every day, and nobody has named
    forms = forms_of([day(seed, own) for seed in (1, 2, 3)])
    sticking = day(4, own, entry("stiction", 2, breakaway_frac=BREAKAWAY))
    cell = actuator(with_baseline(sticking, (), forms), 2)
    replay = cell.whitened
    assert isinstance(replay, Replay)
    still = replace(cell, whitened=replace(replay, parts=tuple(replace(one, moved=()) for one in replay.parts)))
    true = np.array([[BREAKAWAY]])
    moving, fixed = (float(costs(evaluated(one, named(("stiction",), (2,))[:1], true)).sum()) for one in (cell, still))
    assert moving < fixed
    np.testing.assert_array_equal(evaluated(cell, (), np.zeros((1, 0))), evaluated(still, (), np.zeros((1, 0))))


def test_a_joint_that_moves_as_modelled_has_nothing_further_said_of_it() -> None:
    t = np.arange(400) * 0.01
    course = Course(0.01, t, 0.2 * np.sin(t), np.cos(t), np.ones(400), np.zeros((400, 1)), t)
    said = Otherwise.of(course, (("the angle", tuple(np.linspace(0.1, 1.0, 10))), ("echoes", (1.0,) * 20)))
    assert said(course.q) == pytest.approx(0.0, abs=1e-12)
    assert np.abs(said(np.zeros(400))).max() > 0.1
