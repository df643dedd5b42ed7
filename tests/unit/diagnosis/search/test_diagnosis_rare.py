"""A gap that lies in one block of one stage is cut into pieces; any other is left whole."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.refusal.remainder import steady_energy
from diagnosis.search.cell import Cell, Rows, blocks_of
from diagnosis.search.rare import FOLDS, with_the_event_cut
from machine.effects.layout import neutral_sets

ROWS = 1200


def cell_of(stage: str) -> Cell:
    block, _ = blocks_of([300] * 4)
    fold = np.repeat(np.arange(4), 300)
    zeros = np.zeros(ROWS, dtype=np.int64)
    return Cell(
        stage, 1, "1", (), neutral_sets(1), lambda sets: np.zeros((sets.sets, ROWS)), Rows(fold, block, zeros, zeros),
        np.ones(ROWS), 0.0, True, False, (), np.arange(ROWS) * 0.05,
    )  # fmt: skip


def event(rows: slice) -> np.ndarray:
    residual = np.zeros(ROWS)
    residual[rows] = 20.0
    return residual


def test_one_event_is_left_out_in_turns_and_scored_in_pieces() -> None:
    cell = cell_of("controller")
    cut = with_the_event_cut(cell, event(slice(420, 432))).rows
    inside = cell.rows.block == cell.rows.block[425]
    assert set(cut.fold[inside]) == {4, 5, 6}
    assert len(set(cut.block[420:432])) == 6
    np.testing.assert_array_equal(cut.fold[~inside], cell.rows.fold[~inside])
    np.testing.assert_array_equal(cut.block[~inside], cell.rows.block[~inside])
    assert (np.bincount(cut.block) > 0).all()
    assert FOLDS == 3
    np.testing.assert_array_equal(cut.whole, cell.rows.block)


def test_the_pieces_of_an_event_are_one_where_the_strongest_are_spared() -> None:
    late = event(slice(420, 432))
    assert steady_energy(with_the_event_cut(cell_of("link"), late), late) == 0.0


@pytest.mark.parametrize(("stage", "rows"), [("actuator", slice(420, 432)), ("controller", slice(0, ROWS, 10))])
def test_the_oil_and_what_happens_again_and_again_are_left_as_they_are(stage: str, rows: slice) -> None:
    cell = cell_of(stage)
    assert with_the_event_cut(cell, event(rows)) is cell


def test_a_small_gap_is_left_as_it_is() -> None:
    cell = replace(cell_of("link"), quiet=1.0)
    assert with_the_event_cut(cell, np.random.default_rng(1).normal(size=ROWS)) is cell
