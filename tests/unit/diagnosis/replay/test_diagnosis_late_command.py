"""Commands that arrive late, or before they were sent, in a log whose rows come less often than the PLC's cycles."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from diagnosis_cases import changed, confirmed, entry, recording

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.reading.read import examine_recording
from machine.effects.entries import EffectEntry
from recording.rows import Sent


def named(*effects: EffectEntry) -> dict[tuple[str, int | None], dict[str, Any]]:
    found = answer_json(budget_of(examine_recording(recording(effects=effects), Path("late"))))
    assert found["verdict"] == "effects", found["why"]
    return confirmed(found)


@pytest.mark.parametrize("delay_s", [0.0234, pytest.param(0.03, marks=pytest.mark.slow)])
def test_a_delay_that_rows_leave_by_a_cycle_makes_no_gain_of_quiet_joints(delay_s: float) -> None:
    """Of 29 to 30 ms any is as good in the logged references, and each may be the end of a cycle's wait; half a percent
    of flow on three joints had come of it.
    """
    found = named(entry("transport_delay", None, delay_s=delay_s))
    assert list(found) == [("transport_delay", None)]
    delay = found["transport_delay", None]["delay_s"]
    assert delay["low"] <= delay_s <= delay["high"]
    assert delay["high"] - delay["low"] < 0.003


def test_a_rounded_reference_is_seen_beside_a_long_delay() -> None:
    """Its step is read off the log: no share of what the delay gains is asked of it."""
    found = named(entry("transport_delay", None, delay_s=0.03), entry("reference_quantisation", 2, step_rad=2e-5))
    assert set(found) == {("transport_delay", None), ("reference_quantisation", 2)}
    assert abs(found["reference_quantisation", 2]["step_rad"]["value"] / 2e-5 - 1.0) < 1e-6


@pytest.mark.parametrize("off_s", [0.003, pytest.param(0.0002, marks=pytest.mark.slow)])
def test_an_offset_by_which_commands_arrive_before_they_were_sent_is_told_and_no_fault(off_s: float) -> None:
    """A fifth of a millisecond puts each reference a cycle late: a healthy machine was `outside`, with four names."""
    made = changed(recording(), Sent, lambda _number, row: replace(row, t_pc_s=row.t_pc_s + off_s))
    found = answer_json(budget_of(examine_recording(made, Path("early"))))
    assert found["verdict"] == "none", found["why"]
    (told,) = [one for one in found["findings"] if one["code"] == "clock_offset_wrong"]
    assert f"{1e3 * off_s:.2g} ms before they were sent" in told["text"]
