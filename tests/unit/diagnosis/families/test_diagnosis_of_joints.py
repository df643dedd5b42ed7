"""What tracker and camera show alike of one joint's angle: told without a name, and refused where it shows steadily."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foreign_plant import Fault, write

from diagnosis.baseline.left_over import cells_of
from diagnosis.behind.corner_residual import CornerResidual
from diagnosis.behind.point_residual import PointResidual
from diagnosis.families.gain import held_out_nats, steady_nats
from diagnosis.families.of_joints import OF_JOINTS, columns_of_joints, swing_of, way_of
from diagnosis.reading.read import read
from diagnosis.refusal.shapes import Shape, _refused_from, left_shapes, refusing, shapes_of
from diagnosis.search.candidates import named, put
from diagnosis.search.cell import Cell
from diagnosis.search.fit import neutral_fit
from machine.remainder import USUAL_ENERGY, usual_shape

LOOSE = 1  # the joint with play, 0-based
KNOWN = (
    (USUAL_ENERGY, 1.0),
    *((usual_shape(name(joint)), 0.0) for name in (way_of, swing_of) for joint in (0, 1)),
)


def behind(folder: Path, fault: Fault, camera_px: float) -> Cell:
    made = write(folder / "run", fault, 3, static=10, seconds=10.0, tracker_m=2e-4, camera_px=camera_px)
    whole = read(made)
    (cell,) = (one for one in cells_of(whole) if one.parts)
    return cell


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    return behind(tmp_path_factory.mktemp("sound"), Fault(), 0.1)


@pytest.fixture(scope="module")
def loose(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    return behind(tmp_path_factory.mktemp("loose"), Fault(backlash=(0.0, 8e-4)), 0.0)  # its camera sees no play


def of_joints(cell: Cell, residual: np.ndarray) -> dict[str, Shape]:
    return {one.goes_with: one for one in shapes_of(cell, residual) if one.goes_with.startswith(OF_JOINTS)}


def test_a_play_goes_with_which_way_its_joint_went_and_is_told_of_the_first_measurement(loose: Cell) -> None:
    found = of_joints(loose, neutral_fit(loose).residual)
    own = found[way_of(LOOSE)]
    assert own.nats > 40.0
    assert own.nats > max((one.nats for name, one in found.items() if name != way_of(LOOSE)), default=0.0)
    assert (own.stage, own.measurement) == ("structure", "tracker")


def test_it_refuses_where_a_baseline_knows_its_usual_size(loose: Cell) -> None:
    residual = neutral_fit(loose).residual
    for usual, refused in ((KNOWN, True), (KNOWN[:1], False), (KNOWN[1:], False), ((), False)):
        parts = tuple(replace(part, usual=usual) for part in loose.parts)
        cell = replace(loose, parts=parts)
        fired = {one.lead for one in refusing(cell, left_shapes(cell, residual, 0.0), 0.0)}
        assert (f"goes with {way_of(LOOSE)}" in fired) == refused, usual


def test_a_sound_machine_shows_nothing_of_it(sound: Cell) -> None:
    assert of_joints(sound, neutral_fit(sound).residual) == {}


def test_what_tracker_and_camera_see_of_different_signs_is_no_joints(sound: Cell) -> None:
    _, columns = columns_of_joints(sound)
    column = columns[way_of(LOOSE)][:, 0]
    noise = np.random.default_rng(5).normal(size=len(column))
    alike, opposed = [], []
    for part, own in sound.by_part(column):
        size = np.sqrt(60.0 / max(float(own @ own), 1e-9))
        alike.append(size * own)
        opposed.append((1.0 if isinstance(part.whitened, PointResidual) else -1.0) * size * own)
    assert way_of(LOOSE) in of_joints(sound, noise + np.concatenate(alike))
    assert way_of(LOOSE) not in of_joints(sound, noise + np.concatenate(opposed))


def test_both_ways_of_seeing_an_angle_agree_with_an_arm_that_is_off_by_it(sound: Cell) -> None:
    """The residual of a bias of the encoder is that of an angle that is more by it, in points and in corners."""
    (bias,) = named(("encoder_bias",), (LOOSE + 1,))
    plain = neutral_fit(sound).residual
    moved = sound.whitened(put(sound.base, (bias,), np.array([[1e-4]])))[0] - plain
    signs = []
    for part, own in sound.by_part(moved):
        seen = part.whitened
        if isinstance(seen, PointResidual):
            expected = seen.noise.white(seen.moved_by_each(part.base)[LOOSE].reshape(1, -1))[0]
        elif isinstance(seen, CornerResidual) and seen.on == "ooi":
            expected = seen.placeless(seen.moved_by_each(part.base)[LOOSE][:, None])[:, 0]
        else:
            continue
        along = float(own @ expected) / float(np.linalg.norm(own) * np.linalg.norm(expected))
        assert abs(along) > 0.9
        signs.append(np.sign(along))
    assert len(signs) >= 2
    assert len(set(signs)) == 1


def test_a_few_moments_are_no_steady_course(sound: Cell) -> None:
    _, columns = columns_of_joints(sound)
    B = columns[way_of(LOOSE)]
    noise = np.random.default_rng(5).normal(size=len(B))
    told = np.unique(sound.rows.block[np.any(B != 0.0, axis=1)])
    few = np.isin(sound.rows.block, told[:: len(told) // 3])  # three or four of them
    jerks = noise + np.where(few, 6.0 * B[:, 0] / np.abs(B[:, 0]).max(), 0.0)
    whole = held_out_nats(B, jerks, sound.rows)
    assert steady_nats(B, jerks, sound.rows) < max(5.0, 0.5 * whole)
    course = noise + B[:, 0] * np.sqrt(200.0 / (B[:, 0] @ B[:, 0]))
    assert steady_nats(B, course, sound.rows) > 0.5 * held_out_nats(B, course, sound.rows) > 30.0


@pytest.mark.parametrize("name", [way_of, swing_of])
def test_they_are_held_to_what_any_joint_showed_and_hold_no_other_course_back(name: Callable[[int], str]) -> None:
    shape = Shape("structure", None, "tracker", name(0), 30.0)
    usual = {usual_shape("motion"): 60.0, usual_shape(name(0)): 0.0, usual_shape(name(1)): 3.0}
    assert shape.nats > _refused_from(usual, shape)
    assert shape.nats < _refused_from({**usual, usual_shape(name(2)): 10.0}, shape)
    wide = replace(shape, goes_with="posture", nats=60.0)
    assert wide.nats > _refused_from({usual_shape("motion"): 5.0, usual_shape(name(0)): 1e3}, wide)
