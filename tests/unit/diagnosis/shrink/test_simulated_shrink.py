"""The shrink from the simulator's own run: what is added closes the gap there, and only that."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from diagnosis_cases import MACHINE_TOML, recording

from diagnosis.cells.dynamic import stage_cells
from diagnosis.diagnose import Diagnosis
from diagnosis.reading.read import examine
from diagnosis.replay.replayer import replayer_of
from diagnosis.replay.stretches import Stretch
from diagnosis.report.simulated import simulated_section
from diagnosis.search.candidates import named
from diagnosis.search.fit import Fit
from diagnosis.search.search import search
from longreach.simulated_shrink import compare, run, told
from longreach.simulated_shrink.held_out import effects_without
from longreach.simulated_shrink.run import COMMANDS, JOINTS, SimulatedShrinkError, simulated_runs
from machine.effects.entries import EffectEntry
from machine.effects.layout import neutral_sets

HALF_WIDTH = 0.04
DEADBAND = EffectEntry("valve_deadband", 2, (("half_width_frac", HALF_WIDTH),))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    made = recording(("repeat", "repeat", "steps"), (DEADBAND,))
    return examine(made, tmp_path_factory.mktemp("made"))


def found(whole, sizes, word="effects") -> Diagnosis:
    """As much of a diagnosis as is simulated: dead bands by joint, not fitted by any cell."""
    cells = []
    for joint, size in sizes.items():
        fit = Fit(named(("valve_deadband",), (joint,))[:1], np.array([size]), np.zeros(0), np.zeros((0, 1)), 0.0, ())
        cells.append(
            SimpleNamespace(
                chosen=SimpleNamespace(fit=fit),
                search=SimpleNamespace(cell=SimpleNamespace(whitened=None, rows=None)),
            )
        )
    made: Any = SimpleNamespace(verdict=SimpleNamespace(word=word), whole=whole, cells=tuple(cells))
    return cast(Diagnosis, made)


@pytest.fixture(scope="module")
def right(whole):
    return simulated_runs(found(whole, {2: HALF_WIDTH}), MACHINE_TOML)


def test_the_right_effect_closes_the_gap_in_the_simulator_too(right):
    for name in (JOINTS, COMMANDS):
        second = compare.closed(right.errors[name], 1)
        assert second.floor is not None
        assert second.before > 3.0 * second.floor
        assert second.closed_frac is not None
        assert second.closed_frac > 0.95
    first = compare.closed(right.errors[JOINTS], 0)
    assert first.before == pytest.approx(first.after)


def test_a_wrong_size_closes_less_and_a_wrong_joint_opens_a_gap(whole, right):
    wrong = simulated_runs(found(whole, {2: 0.5 * HALF_WIDTH, 3: HALF_WIDTH}), MACHINE_TOML)
    half, third = (compare.closed(wrong.errors[JOINTS], j) for j in (1, 2))
    assert half.closed_frac is not None
    assert half.closed_frac < 0.9
    assert third.after > 3.0 * third.before


def test_both_figures_are_told_in_json_lines_and_page(right):
    result = told.told(right, 0.97)
    assert result["replayed_closed_frac"] == 0.97
    text = "\n".join(told.lines(result))
    assert "joint 2" in text
    assert "97 % closed" in text
    body = simulated_section({"simulated_shrink": result})
    assert "replay says 97.0 %" in body
    assert simulated_section({}) == ""


def test_an_unsettled_diagnosis_and_a_strange_effect_give_no_figure(whole):
    with pytest.raises(SimulatedShrinkError, match="'undecided'"):
        simulated_runs(found(whole, {2: 0.02}, "undecided"), MACHINE_TOML)
    fit = Fit(named(("stiction",), (2,))[:1], np.array([0.02]), np.zeros(0), np.zeros((0, 1)), 0.0, ())
    strange = found(whole, {2: 0.02})
    strange.cells[0].chosen.fit = fit  # type: ignore[misc]
    with pytest.raises(SimulatedShrinkError, match="stiction cannot be simulated"):
        simulated_runs(strange, MACHINE_TOML)


def test_numbers_are_those_that_were_fitted_without_the_stretch(whole):
    replayer = replayer_of(whole.nominal, whole.stretches)
    assert replayer is not None
    base = neutral_sets(6)
    cells = stage_cells("actuator", replayer, whole.stretches, base, base)
    cell = next(one for one in cells if one.joint == 2)
    wanted = named(("valve_deadband",), (2,))[:1]
    searched = search(replace(cell, candidates=wanted))
    one: Any = SimpleNamespace(search=searched, chosen=searched.chosen)
    diagnosis: Any = SimpleNamespace(cells=(one,))
    held = [effects_without(diagnosis, stretch) for stretch in whole.stretches]
    assert all(each.told for each in held)
    sizes = [each.entries[0].value("half_width_frac") for each in held]
    assert sizes[0] == sizes[1]
    assert sizes[0] != sizes[2]
    assert np.allclose(sizes, HALF_WIDTH, rtol=0.1)


def test_the_floor_comes_from_repeats_and_the_share_is_not_clipped():
    rng = np.random.default_rng(3)
    gap = 0.01 * np.sin(np.arange(400.0))[:, None]
    noise = [rng.normal(0.0, 1e-3, (400, 1)) for _ in range(4)]
    same = [compare.Errors(gap + one, one, "A") for one in noise]
    good = compare.closed(same, 0)
    assert good.floor == pytest.approx(1e-3, rel=0.1)
    assert good.closed_frac == pytest.approx(1.0, abs=0.02)
    worse = compare.closed([compare.Errors(gap + one, 2.0 * gap + one, "A") for one in noise])
    assert worse.closed_frac == pytest.approx(-3.0, abs=0.1)
    alone = compare.closed([compare.Errors(gap, 0.5 * gap, "")])
    assert alone.floor is None
    assert alone.closed_frac == pytest.approx(0.75)


def stretch(name, repeat_of):
    return Stretch(name, "workcycle", repeat_of, 0.0, 0.01, np.arange(3) * 0.01, None, None, None)


def test_pieces_of_a_cut_repeat_are_no_repeats():
    """Two parts of one motion differ by the motion: taken for noise, that closes more of the gap than was closed."""
    rng = np.random.default_rng(4)
    gap = 0.01 * np.sin(0.02 * np.arange(1200.0))[:, None]

    def cut(group):
        noise = [rng.normal(0.0, 1e-4, (600, 1)) for _ in range(4)]
        parts = [gap[:600], gap[600:], gap[:600], gap[600:]]
        return [compare.Errors(x + n, 0.5 * x + n, group) for x, n in zip(parts, noise, strict=True)]

    assert compare.closed(cut("A")).floor > 5e-4, "what such a group would do: ten times the noise"
    stretches = tuple(stretch(name, "A") for name in ("a/1", "a/2", "b/1", "b/2"))
    assert run._groups(stretches) == {}
    whole = (stretch("A", ""), stretch("b", "A"), stretch("c/1", "A"))
    assert run._groups(whole) == {"A": "A", "b": "A"}, "the one that the others repeat is one of them"
