"""Logs of other machines: encoders behind linkages, rows that are missing everywhere, joints without valve commands."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import changed, entry, likely, recording
from foreign_plant import Fault, write
from one_joint_cases import Machine, recorded

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.localise import totals_of
from diagnosis.noise.floor import encoder_step
from diagnosis.reading.read import examine_recording, read_for_diagnosis
from recording.rows import PlcState


def test_an_encoders_step_is_seen_behind_a_linkage() -> None:
    """A stroke whose length goes with the angle: its steps are 0.9 to 1.1 of the usual one."""
    t = np.linspace(0.0, 40.0, 24000)
    angle = np.round((0.4 * np.sin(0.5 * t) + 0.2 * np.sin(0.13 * t)) / 1e-3)
    stroke = 1e-3 * angle + 0.05 * np.sin(2e-3 * angle)
    assert 0.9e-3 < encoder_step(stroke) < 1.1e-3
    smooth = 0.4 * np.sin(0.5 * t) + 0.2 * np.sin(0.13 * t)
    assert encoder_step(smooth) == 0.0
    assert encoder_step(1e-3 * angle) == pytest.approx(1e-3)


def test_rows_that_are_missing_everywhere_are_filled(tmp_path: Path) -> None:
    place = recorded(tmp_path, Machine(gain=lambda _t: 1.1))
    header, *rows = (place / "plc.csv").read_text(encoding="utf-8").splitlines()
    kept = np.random.default_rng(1).uniform(size=len(rows)) > 0.05
    text = "\n".join([header, *(row for row, keep in zip(rows, kept, strict=True) if keep)])
    (place / "plc.csv").write_text(text + "\n", encoding="utf-8")
    whole = read_for_diagnosis(place)
    assert whole.has_judgeable_stage
    assert "bridged" in {one.code for one in whole.findings}
    found = answer_json(budget_of(whole))
    assert ("flow_gain_error", 1) in [(one["name"], one["joint"]) for one in likely(found)]


def test_shares_of_the_gap_sum_to_one() -> None:
    found = answer_json(
        budget_of(examine_recording(recording(effects=(entry("valve_deadband", 3, half_width_frac=0.05),)), Path("x")))
    )
    totals = [one for one in found["localisation"] if one["joint"] is None and one["axis"] is None]
    parts = [one for one in found["localisation"] if one["joint"] is not None and one["regime"] == "all"]
    assert totals[0]["stage"] == "actuator"
    assert sum(one["share_frac"] for one in totals) == pytest.approx(1.0, abs=1e-5)
    assert sum(one["share_frac"] for one in parts) == pytest.approx(1.0, abs=1e-5)
    assert totals_of(()) == ()


def test_joints_without_valve_commands_are_judged_one_by_one() -> None:
    made = recording(effects=(entry("flow_gain_error", 2, gain_frac=-0.2),))
    blind = changed(made, PlcState, lambda _number, row: replace(row, u_frac=()))
    found = budget_of(examine_recording(blind, Path("x")))
    assert {fit.cell.joint for fit in found.part_fits} >= {1, 2, 3}
    named = [
        line.evidence.effect_term.effect.effect_and_joint for line in found.effect_lines if line.status != "doubtful"
    ]
    assert named in ([("flow_gain_error", 2)], [("controller_gain_error", 2)])
    assert next(place.joint for place in found.localisation.gap_places if place.stage == "actuator") == 2


@pytest.mark.parametrize("lag_s", [0.03, pytest.param(0.0, marks=pytest.mark.slow)])
def test_a_reference_between_rare_rows_is_a_curve(tmp_path: Path, lag_s: float) -> None:
    """Straight lines through its rows cut a healthy machine's corners: a lag of 1.4 ms, and refused for the rest."""
    place = write(tmp_path / "run", Fault(lag_s=(0.0, lag_s)), log_s=0.05)
    (place / "sent.csv").unlink()
    found = answer_json(budget_of(read_for_diagnosis(place)))
    assert found["verdict"] in (("effects", "partly", "undecided") if lag_s else ("none",)), found["why"]
    named = [(one["name"], one["joint"]) for one in likely(found)]
    assert named == ([("valve_lag", 2)] if lag_s else [])
