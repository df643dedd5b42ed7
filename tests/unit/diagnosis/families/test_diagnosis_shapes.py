"""A gap has a shape before it has a name: functions of the signals that foretell what they were not fitted to."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import folder, recording
from foreign_plant import Fault, write

from diagnosis.baseline.left_over import cells_of
from diagnosis.behind.point_residual import PointResidual
from diagnosis.families.behind import point_columns
from diagnosis.families.driven import SINCE, driven_columns
from diagnosis.families.gain import held_out_nats
from diagnosis.families.narrow import ANGLE_OF
from diagnosis.reading.read import read
from diagnosis.refusal.shapes import (
    LEAST_NATS,
    REFUSED_NATS,
    Shape,
    _refused_from,
    instead,
    left_shapes,
    refusing,
    shapes_of,
)
from diagnosis.search.cell import Cell, Rows, blocks_of, folds_of
from diagnosis.search.fit import neutral_fit
from machine.effects.entries import make_entry
from machine.effects.registry import effect_named
from machine.remainder import usual_shape

N = 1200


def rows(count: int = N) -> Rows:
    block, _ = blocks_of([count // 3] * 3)
    fold, _ = folds_of(["steps", "workcycle", "multisine"], [count // 3] * 3, block)
    zero = np.zeros(count, np.int64)
    return Rows(fold, block, zero, zero)


def test_noise_foretells_nothing_and_a_small_course_is_found() -> None:
    rng = np.random.default_rng(2)
    columns = np.stack([np.sin(0.01 * k * np.arange(N)) for k in range(1, 21)], axis=1)
    quiet = [held_out_nats(columns, rng.normal(size=N), rows()) for _ in range(50)]
    assert max(quiet) < LEAST_NATS
    course = columns[:, 4] * np.sqrt(100.0 / (columns[:, 4] @ columns[:, 4]))  # |s|^2 = 100: 50 nats at most
    found = [held_out_nats(columns, rng.normal(size=N) + course, rows()) for _ in range(20)]
    assert min(found) > LEAST_NATS
    assert max(found) < 80.0


def test_columns_that_are_zero_or_missing_foretell_nothing() -> None:
    r = np.random.default_rng(3).normal(size=N)
    assert held_out_nats(np.zeros((N, 4)), r, rows()) == 0.0
    assert held_out_nats(np.zeros((N, 0)), r, rows()) == 0.0


def cell_with(tmp_path: Path, label: str, **effect: float) -> tuple[Cell, np.ndarray]:
    known = effect_named("valve_deadband")
    assert known is not None
    entries = (make_entry(known, 2, effect),) if effect else ()
    whole = read(folder(tmp_path, recording(("repeat", "repeat", "repeat", "steps", "workcycle"), entries)))
    cell = next(one for one in cells_of(whole) if one.label == label)
    return cell, neutral_fit(cell).residual


def test_a_dead_band_goes_with_the_valve_command_whatever_it_is_called(tmp_path: Path) -> None:
    cell, residual = cell_with(tmp_path, "actuator 2", half_width_frac=0.01)
    found = shapes_of(cell, residual)
    assert found[0].nats > 100.0
    assert "the valve command" in [one.goes_with for one in found]
    assert all(one.stage == "actuator" and one.joint == 2 and not one.measurement for one in found)
    assert found == tuple(sorted(found, key=lambda one: -one.nats))


def test_columns_are_as_many_and_as_white_as_the_residual(tmp_path: Path) -> None:
    cell, residual = cell_with(tmp_path, "link")
    for name, columns in driven_columns(cell).items():
        assert columns.shape[0] == len(residual), name
        for channel in range(6):  # each joint has columns of its own, at its own rows
            own = np.any(columns[cell.rows.channel == channel] != 0.0, axis=0)
            others = np.any(columns[cell.rows.channel != channel] != 0.0, axis=0)
            assert not (own & others).any(), name


def test_without_a_fault_there_is_no_shape(tmp_path: Path) -> None:
    whole = read(folder(tmp_path, recording(("repeat", "repeat", "repeat", "steps", "workcycle"))))
    for cell in cells_of(whole):
        assert shapes_of(cell, neutral_fit(cell).residual) == (), cell.label


def test_points_have_functions_of_posture_and_motion(tmp_path: Path) -> None:
    whole = read(write(tmp_path / "run", Fault(), 3, static=40, seconds=10.0))
    by_stage = {one.label: one for one in cells_of(whole)}
    parts = by_stage["structure"].parts or (by_stage["structure"],)
    for part in parts:
        if not isinstance(part.whitened, PointResidual):
            continue
        columns = point_columns(part.whitened)
        assert {"posture", "waves over the angles", "which point"} <= set(columns)
        bent = 4.0 * columns["posture"][:, 3] + np.random.default_rng(5).normal(size=part.rows.count)
        found = shapes_of(part, bent)
        assert found[0].goes_with in ("posture", "waves over the angles")


def test_only_what_the_undisturbed_machine_does_not_show_is_told(tmp_path: Path) -> None:
    cell, residual = cell_with(tmp_path, "actuator 2", half_width_frac=0.01)
    told = {one.goes_with: one.nats for one in left_shapes(cell, residual, 0.0)}
    nats = told["the valve command"]
    assert nats > 100.0  # no baseline: everything is told
    usual = [(usual_shape(name), found) for name, found in told.items() if name != "the valve command"]
    known = replace(cell, usual=(*usual, (usual_shape("the valve command"), 0.1 * nats)))
    assert [one.goes_with for one in left_shapes(known, residual, 0.0)] == ["the valve command"]
    swinging = replace(cell, usual=(*usual, (usual_shape("the valve command"), nats)))
    assert left_shapes(swinging, residual, 0.0) == ()
    assert left_shapes(known, residual, 20.0 * nats) == ()  # 9 % of a large effect's form


def test_a_gain_that_drifts_goes_with_time_since_the_start_and_refuses_where_its_usual_size_is_known(
    tmp_path: Path,
) -> None:
    """Oil that warms: within each motion of a quarter of a minute the gain hardly changes."""
    cell, _ = cell_with(tmp_path, "actuator 2")
    rising = driven_columns(cell)[SINCE][:, 1]
    assert abs(rising[-400:]).max() > 2.0 * abs(rising[:400]).max()  # it goes on from motion to motion
    noise = np.random.default_rng(5).normal(size=len(rising))
    drifting = noise + rising * np.sqrt(300.0 / (rising @ rising))
    left = shapes_of(cell, drifting)
    assert left[0].goes_with == SINCE
    assert left[0].nats > 60.0
    assert all(one.goes_with != SINCE for one in shapes_of(cell, noise))
    known = replace(cell, usual=((usual_shape("time"), 40.0), (usual_shape(SINCE), 5.0)))
    assert [one.lead for one in refusing(known, left[:1], 0.0)] == [f"goes with {SINCE}"]  # not held to another course
    older = replace(cell, usual=((usual_shape("time"), 0.0),))
    assert refusing(older, left[:1], 0.0) == ()
    assert [one.lead for one in instead(known, drifting, 60.0)] == [f"goes with {SINCE}"]  # a gain stood in for it
    assert instead(known, drifting, left[0].nats) == ()  # a name that gains as much is its equal
    assert instead(older, drifting, 60.0) == ()


@pytest.mark.parametrize("count", [1, 3])
def test_single_moments_are_found_without_a_course(tmp_path: Path, count: int) -> None:
    cell, residual = cell_with(tmp_path, "link")
    spoiled = residual.copy()
    spoiled[100 : 100 + 400 * count : 400] += 9.0
    found = [one for one in shapes_of(cell, spoiled) if one.goes_with == "single moments"]
    assert found
    assert found[0].nats == pytest.approx(20.0 * count, rel=0.4)


def test_a_shape_speaks_against_a_model_only_beside_a_baseline_that_knows_the_usual_ones(tmp_path: Path) -> None:
    cell, residual = cell_with(tmp_path, "actuator 2", half_width_frac=0.01)
    left = left_shapes(cell, residual, 0.0)
    assert refusing(cell, left, 0.0) == ()
    known = replace(
        cell, usual=((usual_shape("the load"), 0.0), (usual_shape(SINCE), 0.0), (usual_shape("single moments"), 1e4))
    )
    left = tuple(one for one in left if one.goes_with != "single moments" and one.nats > REFUSED_NATS)
    fired = refusing(known, left, 0.0)
    assert [one.size for one in fired] == [one.nats for one in left]
    assert {(one.test, one.stage, one.joint, one.share) for one in fired} == {("shape", "actuator", 2, 1.0)}
    assert fired[0].lead == f"goes with {left[0].goes_with}"
    named = refusing(known, left, 3.0 * left[0].nats)  # names that gained three times as much: a quarter is left
    assert named[0].share == pytest.approx(0.25)
    swinging = replace(cell, usual=((usual_shape("time"), left[0].nats),))  # as large, though it went with another
    assert refusing(swinging, left, 0.0) == ()
    assert refusing(replace(known, unlike=(2,)), left, 0.0) == ()  # a motion of which the baseline knows nothing
    assert refusing(replace(known, unlike=(1,)), left, 0.0) == fired


@pytest.mark.parametrize(
    ("measurement", "speaks"), [("tool", True), ("static", True), ("ooi", False), ("tracker", False)]
)
def test_where_nothing_swings_a_shape_is_held_to_its_own_usual_size(measurement: str, speaks: bool) -> None:
    usual = {usual_shape("posture"): 0.0, usual_shape("time"): 7.0}
    shape = Shape("structure", None, measurement, "posture", REFUSED_NATS + 1.0)
    assert (shape.nats > _refused_from(usual, shape)) == speaks
    moments = replace(shape, goes_with="single moments", nats=REFUSED_NATS + 40.0)
    assert moments.nats < _refused_from(usual, moments)
    often = {**usual, usual_shape("posture"): 7.0}
    assert shape.nats < _refused_from(often, shape)


@pytest.mark.parametrize(("goes_with", "speaks"), [("which point", True), ("which marker", True), ("posture", False)])
def test_what_stays_with_a_point_or_a_marker_is_no_swing_and_held_to_its_own_usual_size(
    goes_with: str, speaks: bool
) -> None:
    usual = {usual_shape(goes_with): 1.0, usual_shape("motion"): 60.0}
    shape = Shape("structure", None, "tracker", goes_with, 56.0)
    assert (shape.nats > _refused_from(usual, shape)) == speaks
    assert shape.nats < _refused_from({**usual, usual_shape(goes_with): 6.0}, shape)


@pytest.mark.parametrize(("measurement", "speaks"), [("ooi", False), ("tracker", False), ("static", True)])
def test_an_angles_error_of_what_swings_is_held_to_that_of_any_joint(measurement: str, speaks: bool) -> None:
    usual = {usual_shape(f"{ANGLE_OF} 2"): 0.0, usual_shape(f"{ANGLE_OF} 3"): 47.0}
    shape = Shape("camera", None, measurement, f"{ANGLE_OF} 2", 180.0)
    assert (shape.nats > _refused_from(usual, shape)) == speaks
    assert replace(shape, nats=182.0).nats > _refused_from(usual, shape)
