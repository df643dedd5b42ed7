"""Rows that several segments share count once."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import recording

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.reading.read import Read, examine_recording
from recording.run import Segment

MADE = recording(("repeat", "repeat", "repeat", "repeat", "steps", "sweep"))
SEGMENTS = MADE.run_info.segments


def examined(*segments: Segment) -> Read:
    return examine_recording(replace(MADE, run_info=replace(MADE.run_info, segments=segments)), Path("made_up"))


def rows_used(whole: Read) -> int:
    times = np.concatenate([one.t_s for one in whole.stretches])
    assert len(np.unique(times.round(6))) == len(times)
    return len(times)


def test_a_segment_over_all_others_adds_nothing() -> None:
    plain = examined(*SEGMENTS)
    whole = Segment("all", "workcycle", SEGMENTS[0].t_start_plc_s, SEGMENTS[-1].t_end_plc_s)
    both = examined(whole, *SEGMENTS)
    assert rows_used(both) == rows_used(plain)
    assert [one.name for one in both.stretches] == [one.name for one in plain.stretches]
    assert {one.code for one in both.findings if one.severity != "note"} == {"gap"}  # where nothing was logged between
    (told,) = [one for one in both.findings if one.code == "segments_overlap"]
    assert "1 segments have no 2 s of their own" in told.text


def test_windows_that_slide_over_a_motion_hold_each_row_once() -> None:
    """A sound recording of which every row lay in seven segments was `outside`."""
    starts = np.arange(SEGMENTS[4].t_start_plc_s, SEGMENTS[5].t_end_plc_s - 3.0, 0.4).tolist()
    windows = [Segment(f"w{k}", "workcycle", start, start + 3.0) for k, start in enumerate(starts)]
    whole = examined(*windows)
    assert rows_used(whole) > 1000
    assert answer_json(budget_of(whole))["verdict"] in ("none", "undecided")  # nobody measured its noise


@pytest.mark.parametrize("shared_s", [0.0, 0.01])
def test_neighbours_may_share_their_ends(shared_s: float) -> None:
    middle = SEGMENTS[4].t_start_plc_s + 6.0
    halves = (
        Segment("first", "steps", SEGMENTS[4].t_start_plc_s, middle + shared_s),
        Segment("second", "sweep", middle, SEGMENTS[4].t_end_plc_s),
    )
    assert "segments_overlap" not in {one.code for one in examined(*halves).findings}


def test_a_segment_beyond_the_log_is_still_told() -> None:
    beyond = Segment("late", "steps", SEGMENTS[-1].t_end_plc_s + 100.0, SEGMENTS[-1].t_end_plc_s + 110.0)
    assert "empty_segment" in {one.code for one in examined(*SEGMENTS, beyond).findings}
