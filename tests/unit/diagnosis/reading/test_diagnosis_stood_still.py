"""A machine that stood still tells of one posture only: nothing is named from it, and no good health either."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_cases import recording

from diagnosis.budget import budget_of
from diagnosis.reading.read import examine_recording
from diagnosis.replay.stretches import Stretch, stood_still

T_S = 0.01 * np.arange(400)


def stretch(enc: Any = None, ref: Any = None) -> Stretch:
    """4 s of these signals."""
    return Stretch("one", "dwell", "", 0.0, 0.01, T_S, ref, enc, None)


def held(moved_rad: float = 0.0) -> np.ndarray:
    """Three joints; the last one goes this far."""
    q = np.tile([0.2, 0.7, -1.5], (len(T_S), 1))
    q[:, 2] += moved_rad * np.sin(T_S)
    return q


@pytest.mark.parametrize(
    ("enc", "ref", "still"),
    [
        (held(), held(), True),
        (held(5e-4), None, True),
        (held(0.01), held(), False),
        (held(), held(0.01), False),  # asked to move, and did not: that is a gap
        (None, held(), False),  # nobody knows
    ],
)
def test_one_posture_is_told_from_motion(enc: Any, ref: Any, still: bool) -> None:
    assert stood_still((stretch(enc, ref), stretch(enc, ref))) is still


def test_two_places_are_two_postures() -> None:
    assert not stood_still((stretch(held()), stretch(held() + 0.1)))
    assert not stood_still(())


def test_holes_in_a_column_are_no_motion() -> None:
    q = held()
    q[5] = np.nan
    assert stood_still((stretch(q),))


def test_a_recording_that_moves_is_judged_and_the_same_one_standing_is_not() -> None:
    made = recording()
    assert budget_of(examine_recording(made, Path("moves"))).verdict == "none"
    moving = examine_recording(made, Path("stands"))
    found = budget_of(replace(moving, stretches=tuple(_frozen(one) for one in moving.stretches)))
    assert found.verdict == "undecided"
    assert "no joint moved" in found.verdict_reason


def _frozen(one: Stretch) -> Stretch:
    """The first row for ever."""
    names = ("ref", "enc", "u")
    first = {
        name: np.tile(values[:1], (one.row_count, 1)) for name in names if (values := getattr(one, name)) is not None
    }
    return replace(one, **first, sent_reference=None)
