"""Clocks whose offset nobody gave: datagrams and pictures are placed by what they show, and what that hides is said."""

from pathlib import Path
from typing import Any

import pytest
from diagnosis_cases import likely
from foreign_plant import OFFSET_S, Fault, write

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.datagrams.clocks import camera_to_plc_s, plc_to_pc_s
from diagnosis.reading.read import Read, read_for_diagnosis


def without_offset(place: Path, fault: Fault) -> Read:
    """A short recording with a camera, without the offset between PLC and PC (3 s)."""
    write(place, fault, seconds=10.0, kinds=("repeat", "repeat", "repeat", "steps", "workcycle"), camera_px=0.1)
    text = (place / "run.toml").read_text(encoding="utf-8")
    (place / "run.toml").write_text(text.replace(f"plc_to_pc_offset_s = {OFFSET_S}\n", ""), encoding="utf-8")
    return read_for_diagnosis(place)


@pytest.mark.parametrize(
    ("fault", "named"),
    [(Fault(focal=0.015), ["focal_length_error"]), (Fault(camera_late_s=0.04), [])],
    ids=["focal length", "late camera"],
)
def test_pictures_are_placed_by_how_they_move(tmp_path: Path, fault: Fault, named: list[str]) -> None:
    whole = without_offset(tmp_path, fault)
    notes = [str(one) for one in whole.findings if one.code == "clock_offset_unknown"]
    assert any("a camera that stamps late cannot be found" in note for note in notes)
    assert "gap" not in {one.code for one in whole.findings}
    found: dict[str, Any] = answer_json(budget_of(whole))
    assert found["verdict"] == ("effects" if named else "none"), found["why"]
    assert [one["name"] for one in likely(found)] == named
    assert not {"camera_latency", "clock_offset"} & {one["name"] for one in found["detection_limits"]}


def test_the_clocks_are_known_but_for_the_links_delay(tmp_path: Path) -> None:
    tables = without_offset(tmp_path, Fault()).tables
    assert tables is not None
    assert plc_to_pc_s(tables) == pytest.approx(OFFSET_S, abs=0.02)
    assert camera_to_plc_s(tables) == -plc_to_pc_s(tables)
