"""The closed share below the noise: by what the catalogue foretells, or not at all."""

import numpy as np
import pytest

from diagnosis.verdict.shrink import UNKNOWN, Squares, closing

BLOCKS, ROWS = 40, 4000


def sums(gap: float, closed: float, foretold: float) -> Squares:
    """Of blocks with a noise of 100, in sums of squares a block."""
    rng = np.random.default_rng(3)
    noise, wobble = np.full(BLOCKS, 100.0), rng.normal(0.0, 2.0, BLOCKS)
    before = noise - 5.0 + gap + wobble  # the noise is believed to be a little more than it is
    return Squares(before, before - closed - 0.1 * wobble, noise, np.full(BLOCKS, foretold) + 0.1 * wobble, ROWS, 1)


def test_a_gap_below_the_noise_is_what_the_catalogue_foretells() -> None:
    _, _, _, closed, floor_by = closing(sums(gap=4.0, closed=3.8, foretold=4.0))
    assert floor_by == "catalogue"
    share, low, high = closed
    assert share == pytest.approx(0.95, abs=0.03)
    assert low is not None
    assert high is not None
    assert low < 0.95 < high


def test_no_limit_below_the_noise_excludes_that_all_is_closed() -> None:
    more, less = (closing(sums(gap=4.0, closed=closed, foretold=4.0))[3] for closed in (4.4, 3.2))
    assert more[0] == pytest.approx(1.1, abs=0.03)
    assert more[1] == pytest.approx(1.0 - 3.84 / 160.0, abs=0.003)  # a number that is wrong by two of its errors
    assert less[0] == pytest.approx(0.8, abs=0.03)
    assert less[2] == pytest.approx(1.0)


def test_less_left_than_the_noise_says_that_the_noise_is_smaller() -> None:
    made = sums(gap=600.0, closed=650.0, foretold=600.0)  # 45 of a noise of 100 are left
    _, _, _, (share, low, high), floor_by = closing(made)
    assert floor_by == "noise"
    assert share == pytest.approx(1.0)
    assert low == pytest.approx(1.0 - 45.0 / 695.0, abs=0.01)  # were there no noise at all
    assert high == pytest.approx(1.005, abs=0.01)


def test_names_that_close_far_more_than_is_foretold_tell_no_share() -> None:
    _, _, _, closed, floor_by = closing(sums(gap=3.0, closed=58.0, foretold=2.0))
    assert floor_by == "noise"
    assert closed == UNKNOWN


def test_a_gap_that_stands_clear_is_held_against_the_noise() -> None:
    _, _, _, closed, floor_by = closing(sums(gap=105.0, closed=95.0, foretold=2.0))
    assert floor_by == "noise"
    assert closed[0] == pytest.approx(0.95, abs=0.03)


@pytest.mark.parametrize(
    ("gap", "closed", "foretold"),
    [
        (4.0, 3.8, 4.0),  # below the noise
        (105.0, 95.0, 2.0),  # clear of it
        (105.0, 108.0, 2.0),  # a little less left than the noise is said to be
        (600.0, 650.0, 600.0),  # far less
    ],
)
def test_the_share_is_the_one_of_the_printed_numbers(gap: float, closed: float, foretold: float) -> None:
    before, after, floor, (share, _, _), _ = closing(sums(gap, closed, foretold))
    assert share == pytest.approx(1.0 - (after**2 - floor**2) / (before**2 - floor**2), abs=1e-9)
