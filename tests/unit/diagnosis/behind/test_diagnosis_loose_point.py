"""A prism that slipped between two looks at one posture, and a floor that a few repeats know badly."""

from dataclasses import replace

import numpy as np
import pytest
from made_up_cell import made_up

from diagnosis.behind.loose_point import loose_point
from diagnosis.refusal.remainder import tests_of as fired_tests

AGAIN = np.array([6, 6, 6])


@pytest.mark.parametrize(
    ("millimetres", "joints", "told"),
    [
        ((0.1, 0.1, 2.0), (7, 7, 7), "'c'"),
        ((0.1, 0.1, 0.4), (7, 7, 7), ""),  # four times is within what a place of its own explains
        ((0.1, 0.1, 2.0), (2, 3, 7), ""),  # nothing else lies beyond its joint: play, a swing
        ((2.0, 0.1, 0.1), (2, 3, 7), "'a'"),  # what lies beyond it stands still
        ((2.0, 2.0, 0.1), (7, 7, 7), ""),  # two of three: nobody knows which
        ((1e-3, 1e-3, 0.1), (7, 7, 7), ""),  # tenths of a millimetre fasten nothing
    ],
)
def test_a_point_is_loose_where_those_beyond_it_repeat(
    millimetres: tuple[float, ...], joints: tuple[int, ...], told: str
) -> None:
    squares = 3 * AGAIN * (1e-3 * np.array(millimetres)) ** 2
    found = loose_point(squares, AGAIN, joints, "abc")
    assert told in found
    assert bool(found) == bool(told)
    assert loose_point(squares, np.array([6, 6, 2]), joints, "abc") == ("" if told == "'c'" else found)


def test_energy_over_a_floor_of_few_repeats_is_no_gap_yet() -> None:
    """Twice the energy by 54 squared differences is a chance of one in two hundred, by thousands of them none."""
    cell = replace(made_up((0.0, 0.0, 0.0)), stage="structure", regressors=())
    residual = np.sqrt(2.0) * np.random.default_rng(3).normal(size=300)
    assert {one.test for one in fired_tests(cell, residual, 1)} == {"energy"}
    assert fired_tests(replace(cell, floor_squares=54), residual, 1) == ()
    assert fired_tests(replace(cell, floor_squares=54), 2.0 * residual, 1)
