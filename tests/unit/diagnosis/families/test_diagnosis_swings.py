"""What a joint's motion sets swinging behind it is seen without a name for it, and refuses beside a baseline."""

from dataclasses import replace

import numpy as np
import pytest
from foreign_plant import Fault, write

from diagnosis.behind.point_residual import PointResidual
from diagnosis.cells.behind import behind_cells
from diagnosis.families.behind import swing_columns
from diagnosis.reading.read import read
from diagnosis.refusal.shapes import left_shapes, refusing, shapes_of
from diagnosis.search.candidates import named
from diagnosis.search.cell import Cell
from diagnosis.search.fit import evaluated
from diagnosis.search.search import search
from machine.effects.entries import pack_under

SEEN = "swings of joint 2"
SWING = np.array([[0.1, 1.7, 0.04]])  # between two of the bank's frequencies, and narrower


@pytest.fixture(scope="module")
def tracked(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    made = write(tmp_path_factory.mktemp("swings") / "run", Fault(), seconds=10.0, tracker_m=2e-4)
    whole = read(made)
    assert whole.nominal is not None
    (cell,) = behind_cells(whole, pack_under((), 2))
    return cell


def residuals(cell: Cell, joint: int | None) -> np.ndarray:
    """Noise, and the swing of that joint in it."""
    noise = np.random.default_rng(1).normal(size=cell.rows.count)
    if joint is None:
        return noise
    swing = named(("link_flexibility",), (joint,))
    plain = evaluated(cell, (), np.zeros((1, 0)))[0]
    return noise + evaluated(cell, swing, SWING)[0] - plain


def test_a_swing_is_foretold_by_the_joint_that_sets_it_off(tracked: Cell) -> None:
    found = shapes_of(tracked, residuals(tracked, 2))
    assert found[0].goes_with == SEEN
    assert found[0].nats > 100.0


def test_noise_swings_nowhere(tracked: Cell) -> None:
    assert not [one for one in shapes_of(tracked, residuals(tracked, None)) if one.goes_with.startswith("swings")]


@pytest.mark.parametrize(
    ("usual", "unlike", "refused"),
    [
        ((("shape motion", 60.0), (f"shape {SEEN}", 20.0)), (), True),
        ((("shape motion", 60.0), (f"shape {SEEN}", 1e5)), (), False),  # it swings as much every day
        ((("shape motion", 60.0),), (), False),  # a baseline from before these were sought
        ((("shape motion", 60.0), (f"shape {SEEN}", 20.0)), (1,), False),  # jumps of a joint set everything swinging
        ((), (), False),  # no baseline: a lead only
    ],
)
def test_it_refuses_beyond_its_own_size_undisturbed(
    tracked: Cell, usual: tuple[tuple[str, float], ...], unlike: tuple[int, ...], refused: bool
) -> None:
    cell = replace(tracked, usual=usual, unlike=unlike)
    fired = refusing(cell, left_shapes(cell, residuals(tracked, 2), 0.0), 0.0)
    assert (SEEN in {one.lead.removeprefix("goes with ") for one in fired}) == refused


def test_poses_at_rest_swing_nowhere(tracked: Cell) -> None:
    seen = tracked.whitened
    assert isinstance(seen, PointResidual)
    assert set(swing_columns(seen, tracked.base)) == {"swings of joint 1", SEEN}
    assert swing_columns(replace(seen, paths=()), tracked.base) == {}


def test_a_swing_between_two_frequencies_has_its_name(tracked: Cell) -> None:
    """Of five frequencies none had been in the valley of one of 1.5 Hz, which is a tenth of that wide."""
    swing = named(("link_flexibility",), (2,))
    plain = evaluated(tracked, (), np.zeros((1, 0)))[0]
    more = plain - evaluated(tracked, swing, np.array([[0.1, 1.47, 0.03]]))[0]
    moved = replace(tracked, whitened=lambda sets: tracked.whitened(sets) + more)
    (found,) = search(moved).chosen.fit.by_effect
    assert found[0].key == ("link_flexibility", 2)
    np.testing.assert_allclose(found[1], [0.1, 1.47, 0.03], rtol=0.25)
