"""Stamps that jitter: about rows that were taken evenly, or as the rows did."""

from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import likely
from foreign_plant import Fault, rewritten, write

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.log.quality import GAP_MIN_MEDIAN_STEPS, too_long
from diagnosis.log.stamps import even_grid, taken_evenly
from diagnosis.reading.read import read_for_diagnosis

STEP_S = 0.01


def moved(t: np.ndarray) -> np.ndarray:
    """Encoders (m, 2) of 16 bits at times t (m,)."""
    q = np.stack([0.3 * np.sin(1.1 * t), 0.2 * np.sin(2.3 * t + 0.4)], axis=1)
    step = 2.0 * np.pi / 2**16
    return np.round(q / step) * step


@pytest.mark.parametrize("late_s", [0.0003, 0.003])
@pytest.mark.parametrize("step_s", [0.01, 0.05])
def test_the_encoders_tell_whether_rows_or_stamps_were_uneven(late_s: float, step_s: float) -> None:
    even = step_s * np.arange(2000)
    stamps = even + np.random.default_rng(1).uniform(-late_s, late_s, len(even))
    grid = even_grid(stamps)
    assert np.abs(grid - even).max() < 0.2 * late_s
    if late_s > 0.05 * step_s:
        assert taken_evenly(moved(even), stamps, grid)
    assert not taken_evenly(moved(stamps), stamps, grid)
    assert not taken_evenly(np.zeros((len(even), 2)), stamps, grid)  # nothing moved: nobody knows
    assert not taken_evenly(None, stamps, grid)


def test_a_late_stamp_is_no_missing_row() -> None:
    t = STEP_S * np.arange(100)
    late = t.copy()
    late[50] += 0.007
    assert not too_long(np.diff(late), STEP_S, GAP_MIN_MEDIAN_STEPS).any()
    assert np.nonzero(too_long(np.diff(np.delete(t, 50)), STEP_S, GAP_MIN_MEDIAN_STEPS))[0].tolist() == [49]
    assert np.nonzero(too_long(np.diff(np.delete(t, [98])), STEP_S, GAP_MIN_MEDIAN_STEPS))[0].tolist() == [97]


def jittered(rows: list) -> None:
    """A log as a PC stamps it, each row up to 3 ms early or late."""
    rng = np.random.default_rng(3)
    for row in rows:
        row["t_plc_s"] = f"{float(row['t_plc_s']) + rng.uniform(-0.003, 0.003):.7f}"


def logged(place: Path, fault: Fault, seconds: float = 20.0) -> Path:
    """A recording without what was sent."""
    write(place, fault, seconds=seconds)
    (place / "sent.csv").unlink()
    return place


@pytest.mark.parametrize("gain", [0.0, -0.2])
def test_a_log_stamped_by_a_pc_is_judged_by_its_machine(tmp_path: Path, gain: float) -> None:
    """Its stamps moved a command's jumps: a healthy machine was refused for what its controller seemed to do."""
    whole = read_for_diagnosis(rewritten(logged(tmp_path / "run", Fault(gain=(gain, 0.0)), 10.0), jittered))
    assert [one.code for one in whole.findings if one.code in ("uneven_stamps", "gap")] == ["uneven_stamps"]
    found = answer_json(budget_of(whole))
    assert found["verdict"] == ("effects" if gain else "none"), found["why"]
    named = [(one["name"], one["joint"]) for one in likely(found)]
    assert named == ([("flow_gain_error", 1)] if gain else [])


def test_where_no_reference_was_logged_its_steps_are_no_gain(tmp_path: Path) -> None:
    """A row shows a command some way up the tooth that each new reference makes: 0.45 % of gain on every joint."""
    found = answer_json(
        budget_of(read_for_diagnosis(rewritten(logged(tmp_path / "run", Fault()), without=("q_ref", "seq"))))
    )
    assert (found["verdict"], likely(found)) == ("none", []), found["why"]
