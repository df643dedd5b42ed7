"""A floor that is larger than the motion hides every fault: nothing found in it is no "none"."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.verdict.by_itself import asked_speed, moves_by_itself
from diagnosis.verdict.verdict import Verdict

NONE = Verdict("none", "nothing above the noise floor")


def stretches(speed_rad_s: float) -> Any:
    """Two joints, the second at rest, 100 Hz."""
    t = np.arange(0.0, 10.0, 0.01)
    q = 0.5 * np.sin(t * 2.0 * np.sqrt(2.0) * speed_rad_s)
    return (SimpleNamespace(ref=np.column_stack([q, 0.0 * q]), dt_s=0.01), SimpleNamespace(ref=None, dt_s=0.01))


def test_the_speed_asked_for_is_of_the_reference() -> None:
    assert asked_speed(stretches(0.1), 1) == pytest.approx(0.1, rel=0.1)
    assert asked_speed(stretches(0.1), 2) == 0.0
    assert asked_speed(stretches(0.1)[1:], 1) is None


@pytest.mark.parametrize(
    ("floors", "word"),
    [
        ({1: 0.005, 2: 0.005}, "none"),
        ({1: 0.04}, "undecided"),
        ({2: 0.04}, "undecided"),
        ({2: 0.01}, "none"),  # an encoder's noise
        ({}, "none"),
    ],
)
def test_repeats_that_differ_by_more_than_was_asked_for_are_told(floors: dict[int, float], word: str) -> None:
    found = moves_by_itself(NONE, floors, stretches(0.015))
    assert found.word == word
    assert ("it moves by itself" in found.why) is (word == "undecided")


def test_what_was_named_stays() -> None:
    named = Verdict("effects", "catalogue effects explain the gap")
    assert moves_by_itself(named, {1: 0.5}, stretches(0.015)) is named
