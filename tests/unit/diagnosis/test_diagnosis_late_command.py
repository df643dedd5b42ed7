"""Commands that arrive late, in a log whose rows come less often than the PLC's cycles."""

from pathlib import Path
from typing import Any

import pytest
from diagnosis_cases import recording

from diagnosis.answer import answer
from diagnosis.diagnose import diagnose
from diagnosis.reading import examine
from machine.effects.entries import EffectEntry, make_entry
from machine.effects.registry import effect_named


def entry(name: str, joint: int | None, **parameters: object) -> EffectEntry:
    effect = effect_named(name)
    assert effect is not None
    return make_entry(effect, joint, parameters)


def named(*effects: EffectEntry) -> dict[tuple[str, int | None], dict[str, Any]]:
    found = answer(diagnose(examine(recording(effects=effects), Path("late"))))
    assert found["verdict"] == "effects", found["why"]
    return {(one["name"], one["joint"]): one["parameters"] for one in found["hypotheses"][0]["effects"]}


@pytest.mark.parametrize("delay_s", [0.03, 0.0234])
def test_a_delay_that_rows_leave_by_a_cycle_makes_no_gain_of_quiet_joints(delay_s: float) -> None:
    """Of 29 to 30 ms any is as good in the logged references; half a percent of flow on three joints had come of it."""
    found = named(entry("transport_delay", None, delay_s=delay_s))
    assert list(found) == [("transport_delay", None)]
    delay = found["transport_delay", None]["delay_s"]
    assert delay["low"] <= delay_s <= delay["high"]
    assert delay["high"] - delay["low"] < 0.002


def test_a_rounded_reference_is_seen_beside_a_long_delay() -> None:
    """Its step is read off the log: no share of what the delay gains is asked of it."""
    found = named(entry("transport_delay", None, delay_s=0.03), entry("reference_quantisation", 2, step_rad=2e-5))
    assert set(found) == {("transport_delay", None), ("reference_quantisation", 2)}
    assert abs(found["reference_quantisation", 2]["step_rad"]["value"] / 2e-5 - 1.0) < 1e-6
