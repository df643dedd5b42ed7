"""A prism that slipped between two looks at one posture."""

import numpy as np
import pytest

from diagnosis.behind.loose_point import loose_point

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
