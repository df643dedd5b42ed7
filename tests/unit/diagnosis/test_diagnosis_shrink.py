"""The closed share below the noise: by what the catalogue foretells, or not at all."""

import numpy as np
import pytest

from diagnosis.shrink import UNKNOWN, Squares, closing

BLOCKS, ROWS = 40, 4000


def sums(gap: float, closed: float, foretold: float) -> Squares:
    """Of blocks with a noise of 100, in sums of squares a block."""
    rng = np.random.default_rng(3)
    noise, wobble = np.full(BLOCKS, 100.0), rng.normal(0.0, 2.0, BLOCKS)
    before = noise - 5.0 + gap + wobble  # the noise is believed to be a little more than it is
    return Squares(before, before - closed - 0.1 * wobble, noise, np.full(BLOCKS, foretold) + 0.1 * wobble, ROWS)


def test_a_gap_below_the_noise_is_what_the_catalogue_foretells() -> None:
    _, _, _, closed, floor_by = closing(sums(gap=4.0, closed=3.8, foretold=4.0))
    assert floor_by == "catalogue"
    share, low, high = closed
    assert share == pytest.approx(0.95, abs=0.03)
    assert low is not None
    assert high is not None
    assert low < 0.95 < high


def test_names_that_close_far_more_than_is_foretold_tell_no_share() -> None:
    _, _, _, closed, floor_by = closing(sums(gap=3.0, closed=58.0, foretold=2.0))
    assert floor_by == "noise"
    assert closed == UNKNOWN


def test_a_gap_that_stands_clear_is_held_against_the_noise() -> None:
    _, _, _, closed, floor_by = closing(sums(gap=105.0, closed=95.0, foretold=2.0))
    assert floor_by == "noise"
    assert closed[0] == pytest.approx(0.95, abs=0.03)
