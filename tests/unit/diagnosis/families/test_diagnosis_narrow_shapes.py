"""Families of few numbers behind the encoders: what a name leaves of a kindred one shows in five, not in thirty."""

from dataclasses import replace

import numpy as np
import pytest
from foreign_plant import Fault, write

from diagnosis.baseline.left_over import cells_of
from diagnosis.behind.corner_residual import CornerResidual
from diagnosis.behind.point_residual import PointResidual
from diagnosis.cells.behind import measurement_of
from diagnosis.families.behind import PLACE, WHICH_MARKER
from diagnosis.families.gain import held_out_nats
from diagnosis.families.narrow import ANGLE_OF, LATE, LENS, LOOKS, narrow_corner_columns, narrow_point_columns
from diagnosis.reading.read import read
from diagnosis.refusal.shapes import FEW, REFUSED_NATS, SINGLE_MOMENTS, Shape, _refused_from, refusing, shapes_of
from diagnosis.search.cell import Cell
from machine.remainder import USUAL_ENERGY, usual_shape


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Cell]:
    """What was measured behind the encoders of one sound recording, by measurement."""
    folder = tmp_path_factory.mktemp("narrow") / "run"
    whole = read(write(folder, Fault(), 3, static=40, seconds=10.0, tracker_m=2e-4, camera_px=0.1))
    cells = [part for cell in cells_of(whole) for part in cell.parts or (cell,)]
    return {measurement_of(part): part for part in cells if measurement_of(part)}


def columns_of(part: Cell) -> dict[str, np.ndarray]:
    narrow = narrow_corner_columns if isinstance(part.whitened, CornerResidual) else narrow_point_columns
    return narrow(part.whitened, part.base)


def bent(part: Cell, column: np.ndarray, energy: float) -> np.ndarray:
    """Noise, with a course of so much |s|^2."""
    noise = np.random.default_rng(5).normal(size=part.rows.count)
    return noise + column * np.sqrt(energy / (column @ column))


@pytest.mark.parametrize(
    ("measurement", "family"),
    [
        *((measurement, f"{ANGLE_OF} 2") for measurement in ("static", "tracker", "ooi")),
        *(("ooi", family) for family in (LATE, LENS, LOOKS)),
    ],
)
def test_a_small_course_of_a_family_is_found_by_that_family(
    parts: dict[str, Cell], measurement: str, family: str
) -> None:
    part = parts[measurement]
    column = columns_of(part)[family]
    found = {one.goes_with: one.nats for one in shapes_of(part, bent(part, column[:, -1], 80.0))}
    assert found[family] > 20.0
    wide = [nats for name, nats in found.items() if not name.startswith(FEW)]
    assert found[family] >= max(wide, default=0.0)


def test_noise_alone_goes_with_no_family(parts: dict[str, Cell]) -> None:
    for measurement, part in parts.items():
        told = shapes_of(part, np.random.default_rng(7).normal(size=part.rows.count), REFUSED_NATS)
        assert told == (), measurement


def test_what_the_objects_place_does_is_no_course(parts: dict[str, Cell]) -> None:
    seen = parts["ooi"].whitened
    assert isinstance(seen, CornerResidual)
    own = seen.noise.white(seen.nuisance.T, seen.frames.groups).T
    for name, columns in columns_of(parts["ooi"]).items():
        assert np.abs(own.T @ columns).max() < 1e-6 * np.linalg.norm(own) * np.linalg.norm(columns), name


def test_a_marker_that_was_printed_larger_looks_larger(parts: dict[str, Cell]) -> None:
    """What its pixels would be, seen from the camera: not the very column that is asked."""
    part = parts["ooi"]
    seen = part.whitened
    assert isinstance(seen, CornerResidual)
    first, *others = seen.frames.markers
    grown = (replace(first, side_m=1.02 * first.side_m), *others)
    wrong = replace(seen, frames=replace(seen.frames, markers=grown))
    moved = wrong(part.base)[0] - seen(part.base)[0]
    noise = np.random.default_rng(5).normal(size=part.rows.count)
    found = {one.goes_with: one.nats for one in shapes_of(part, noise + moved)}
    assert found[LOOKS] == max(found.values())
    assert found[LOOKS] > 0.8 * held_out_nats(moved[:, None], noise + moved, part.rows) > 30.0


def test_a_family_refuses_beyond_its_own_usual_size_and_only_where_that_is_known() -> None:
    shape = Shape("camera", None, "ooi", LATE, 40.0)
    usual = {usual_shape("motion"): 60.0, usual_shape(LATE): 10.0}
    assert shape.nats > _refused_from(usual, shape)
    assert shape.nats < _refused_from({**usual, usual_shape(LATE): 20.0}, shape)


def test_an_angles_error_of_what_moves_is_held_to_what_booms_may_do() -> None:
    shape = Shape("structure", None, "static", f"{ANGLE_OF} 2", 20.0)
    moving = Shape("structure", None, "tracker", f"{ANGLE_OF} 2", 45.0)
    usual = {usual_shape("motion"): 60.0, usual_shape(shape.goes_with): 0.0}
    assert shape.nats > _refused_from(usual, shape)
    assert moving.nats > _refused_from(usual, moving)
    assert moving.nats < _refused_from({**usual, usual_shape(shape.goes_with): 2.0}, moving)


@pytest.mark.parametrize("goes_with", [LENS, PLACE])
def test_where_in_the_image_something_moves_is_held_to_any_course_there(goes_with: str) -> None:
    """Undisturbed days show 56 nats of it."""
    seen = Shape("camera", None, "ooi", goes_with, 56.0)
    usual = {usual_shape(goes_with): 2.0, usual_shape("motion by row"): 12.0}
    assert seen.nats < _refused_from(usual, seen) < 90.0
    assert seen.nats > _refused_from(usual, replace(seen, measurement="tool"))  # it goes along with the camera
    assert seen.nats > _refused_from(usual, replace(seen, goes_with=LATE))
    assert seen.nats > _refused_from(usual, replace(seen, goes_with=WHICH_MARKER))


KNOWN = ((USUAL_ENERGY, 1.0), (usual_shape(f"{ANGLE_OF} 1"), 0.0))


def test_beside_a_joint_that_moved_unlike_any_other_day_no_family_of_what_moves_refuses(parts: dict[str, Cell]) -> None:
    left = (Shape("structure", None, "tracker", f"{ANGLE_OF} 1", 60.0),)
    assert refusing(replace(parts["tracker"], usual=KNOWN), left, 0.0)
    assert refusing(replace(parts["tracker"], usual=KNOWN, stuck=(2,)), left, 0.0) == ()
    still = (replace(left[0], measurement="static"),)
    assert refusing(replace(parts["static"], usual=KNOWN, stuck=(2,)), still, 0.0)


def test_jumps_of_a_joint_that_sticks_are_the_single_moments_of_what_swings(parts: dict[str, Cell]) -> None:
    left = (Shape("structure", None, "tracker", SINGLE_MOMENTS, 250.0),)
    moving, still = (replace(parts[name], usual=KNOWN) for name in ("tracker", "static"))
    assert refusing(moving, left, 0.0)
    assert refusing(replace(moving, stuck=(2,)), left, 0.0) == ()
    assert refusing(replace(moving, unlike=(2,)), left, 0.0)  # a square wave has no jump at a moment of its own
    assert refusing(replace(still, stuck=(2,)), (replace(left[0], measurement="static"),), 0.0)


@pytest.mark.parametrize("usual", [((USUAL_ENERGY, 1.0), (usual_shape("motion"), 0.0)), KNOWN[1:]])
def test_an_older_baseline_and_one_of_few_days_refuse_nothing_by_a_family(
    parts: dict[str, Cell], usual: tuple[tuple[str, float], ...]
) -> None:
    left = (Shape("structure", None, "tracker", f"{ANGLE_OF} 1", 60.0),)
    assert refusing(replace(parts["tracker"], usual=usual), left, 0.0) == ()


def test_what_a_family_shows_every_day_holds_no_other_course_back() -> None:
    shape = Shape("structure", None, "tracker", "posture", 60.0)
    usual = {usual_shape("motion"): 5.0, usual_shape(f"{ANGLE_OF} 1"): 50.0}
    assert shape.nats > _refused_from(usual, shape)


def test_of_a_joint_that_stood_still_only_its_zero_is_asked(parts: dict[str, Cell]) -> None:
    measured = parts["static"].whitened
    assert isinstance(measured, PointResidual)
    q = measured.data.q.copy()
    q[:, 0] = 0.3 + 1e-4 * np.random.default_rng(2).normal(size=len(q))
    found = narrow_point_columns(replace(measured, data=replace(measured.data, q=q)), parts["static"].base)
    assert found[f"{ANGLE_OF} 1"].shape[1] == 1
    assert found[f"{ANGLE_OF} 2"].shape[1] > 1
