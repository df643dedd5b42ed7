"""Families of few numbers of a valve: what it errs by is told and refused, whatever its fault is called."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_cases import folder, recording

from diagnosis.baseline.left_over import cells_of
from diagnosis.families.valve import SMALL, VALVE, WAY_OF_COMMAND, valve_columns
from diagnosis.families.ways import last_way
from diagnosis.reading.read import read
from diagnosis.refusal.shapes import Shape, _refused_from, left_shapes, refusing, shapes_of
from diagnosis.search.cell import Cell
from machine.effects.entries import make_entry
from machine.effects.registry import effect_named
from machine.remainder import USUAL_ENERGY, usual_shape

KNOWN = ((USUAL_ENERGY, 1.0), *((usual_shape(name), 8.0) for name in VALVE))
OLDER = ((USUAL_ENERGY, 1.0), (usual_shape("the valve command"), 8.0))


@pytest.fixture(scope="module")
def cells(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Cell]:
    """Of a machine whose second valve has a hysteresis, three joints."""
    known = effect_named("valve_hysteresis")
    assert known is not None
    entries = (make_entry(known, 2, {"half_width_frac": 0.005}),)
    made = folder(
        tmp_path_factory.mktemp("valve"), recording(("repeat", "repeat", "repeat", "steps", "workcycle"), entries)
    )
    return {one.label: one for one in cells_of(read(made))}


def bent(cell: Cell, column: np.ndarray, energy: float) -> np.ndarray:
    noise = np.random.default_rng(5).normal(size=cell.rows.count)
    return noise + column * np.sqrt(energy / (column @ column))


def test_the_way_of_a_signal_is_kept_until_it_has_turned_by_twice_the_width() -> None:
    x = np.array([0.0, 0.5, 1.0, 3.0, 2.5, 1.0, 1.2, -1.0])
    assert last_way(x, 1.0).tolist() == pytest.approx([0.0, 0.5, 1.0, 1.0, 0.5, -1.0, -0.8, -1.0])
    assert not last_way(np.full(5, 3.0), 0.1).any()


@pytest.mark.parametrize("family", VALVE)
def test_a_small_course_of_a_family_is_found_by_that_family(cells: dict[str, Cell], family: str) -> None:
    cell = cells["actuator 3"]
    column = valve_columns(cell)[family][:, 0]
    found = {one.goes_with: one.nats for one in shapes_of(cell, bent(cell, column, 60.0))}
    assert found[family] > 15.0


def test_noise_alone_goes_with_no_family(cells: dict[str, Cell]) -> None:
    for label, cell in cells.items():
        noise = np.random.default_rng(7).normal(size=cell.rows.count)
        assert not [one for one in shapes_of(cell, noise) if one.goes_with in VALVE], label


def test_a_hysteresis_goes_with_which_way_the_command_went_without_its_name(cells: dict[str, Cell]) -> None:
    cell = replace(cells["actuator 2"], usual=KNOWN)
    left = left_shapes(cell, cell_residual(cell), 0.0)
    assert left[0].goes_with == WAY_OF_COMMAND
    fired = {one.lead for one in refusing(cell, left, 0.0)}
    assert f"goes with {WAY_OF_COMMAND}" in fired


def test_a_family_is_held_to_its_own_usual_size_and_holds_no_other_course_back() -> None:
    small, wide = (Shape("actuator", 2, "", name, 60.0) for name in (SMALL, "the valve command"))
    usual = {usual_shape("the angle"): 20.0, usual_shape(SMALL): 10.0}
    assert small.nats > _refused_from({**usual, usual_shape("the angle"): 1e3}, small)
    assert wide.nats > _refused_from({**usual, usual_shape(SMALL): 1e3}, wide)
    assert small.nats < _refused_from({**usual, usual_shape(SMALL): 40.0}, small)


@pytest.mark.parametrize("usual", [(), OLDER, KNOWN[1:]])
def test_without_a_baseline_that_knows_them_they_refuse_nothing(
    cells: dict[str, Cell], usual: tuple[tuple[str, float], ...]
) -> None:
    cell = replace(cells["actuator 2"], usual=usual)
    left = left_shapes(cell, cell_residual(cell), 0.0)
    assert not any(one.lead.removeprefix("goes with ") in VALVE for one in refusing(cell, left, 0.0))
    assert usual == KNOWN[1:] or not any(one.goes_with in VALVE for one in left)


def test_only_actuators_have_them(cells: dict[str, Cell]) -> None:
    assert [label for label, cell in cells.items() if valve_columns(cell)] == [
        label for label in cells if label.startswith("actuator")
    ]


def cell_residual(cell: Cell) -> np.ndarray:
    return cell.whitened(cell.base)[0]
