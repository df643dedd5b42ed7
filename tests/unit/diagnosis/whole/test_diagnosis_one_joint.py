"""Logs as others make them: no repeats, coarse rows with jumps in them, columns in m, a machine that warms."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_cases import confirmed, likely
from one_joint_cases import Machine, recorded

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.reading.read import read_for_diagnosis
from diagnosis.whole_model.quiet_loop import quiet_loop

UNREPEATED = ("multisine", "steps", "sweep")


def told(place: Path, machine: Machine) -> dict[str, Any]:
    return answer_json(budget_of(read_for_diagnosis(recorded(place, machine))))


def names(found: dict[str, Any]) -> list[tuple[str, int | None]]:
    return [(one["name"], one["joint"]) for one in likely(found)]


@pytest.mark.parametrize("log_every", [1, 5])
def test_jumps_that_fall_anywhere_in_a_row_are_no_gap(tmp_path: Path, log_every: int) -> None:
    found = told(tmp_path, Machine(log_every=log_every))
    assert found["verdict"] == "none", found["why"]


def test_beside_them_a_small_gain_is_found(tmp_path: Path) -> None:
    found = told(tmp_path, Machine(gain=lambda _t: 1.02))
    assert found["verdict"] == "effects", found["why"]
    assert [name for name in names(found) if name[0] != "valve_asymmetry"] == [("flow_gain_error", 1)]
    assert "baseline" not in {one["signal"] for one in found["missing"]}, "an answer asks for none"
    gain = confirmed(found)["flow_gain_error", 1]["gain_frac"]["value"]
    assert gain == pytest.approx(0.02, abs=1e-3)  # 0.0003 are the model's step of 1 ms


@pytest.mark.parametrize(("gain", "verdict"), [(1.0, "undecided"), (1.1, "effects")])
def test_a_disturbance_that_nobody_repeated_is_no_gap(tmp_path: Path, gain: float, verdict: str) -> None:
    """2 mrad/s that go on for 0.3 s, a hundredth of the motion: counted as white it refused every answer."""
    spoilt = Machine(kinds=UNREPEATED, disturbance_rad_s=2e-3, disturbance_s=0.3, gain=lambda _t: gain)
    found = told(tmp_path, spoilt)
    assert found["verdict"] == verdict, found["why"]
    assert names(found) == ([("flow_gain_error", 1)] if gain != 1.0 else [])
    assert any("noise was estimated" in one["costs"] for one in found["missing"])


def test_what_slides_may_be_written_in_metres(tmp_path: Path) -> None:
    found = told(tmp_path, Machine(prismatic=True, kinds=UNREPEATED, gain=lambda _t: 1.1))
    assert names(found) == [("flow_gain_error", 1)]


def test_what_turns_may_not(tmp_path: Path) -> None:
    place = recorded(tmp_path, Machine(prismatic=True, kinds=UNREPEATED))
    text = (place / "machine.toml").read_text(encoding="utf-8")
    (place / "machine.toml").write_text(text.replace("prismatic", "revolute"), encoding="utf-8")
    whole = read_for_diagnosis(place)
    assert not whole.has_judgeable_stage
    assert "column 'q_1_m' is in m, but joint 1 of the machine file turns" in " ".join(map(str, whole.findings))


def test_two_units_of_one_column_are_refused(tmp_path: Path) -> None:
    place = recorded(tmp_path, Machine(kinds=UNREPEATED))
    rows = (place / "plc.csv").read_text(encoding="utf-8").splitlines()
    twice = [rows[0] + ",q_1_m", *(f"{row},0.1" for row in rows[1:])]
    (place / "plc.csv").write_text("\n".join(twice), encoding="utf-8")
    assert "there in two units" in " ".join(map(str, read_for_diagnosis(place).findings))


def test_without_a_run_file_what_is_there_is_judged(tmp_path: Path) -> None:
    place = recorded(tmp_path, Machine(kinds=UNREPEATED))
    (place / "run.toml").unlink()
    whole = read_for_diagnosis(place)
    assert whole.has_judgeable_stage
    assert {"no_run_file", "no_segments", "no_repeats"} <= {one.code for one in whole.findings}


def test_an_oil_that_warms_between_repeats_is_refused_not_taken_for_noise(tmp_path: Path) -> None:
    found = told(tmp_path, Machine(gain=lambda t: 1.0 + 0.15 * (1.0 - np.exp(-(t - 100.0) / 40.0))))
    assert found["verdict"] in ("outside", "undecided"), likely(found)
    assert found["unexplained"]


def test_a_gears_wave_is_no_encoders(tmp_path: Path) -> None:
    geared = Machine(kinds=("multisine", "steps", "sweep"), wave=lambda q: 0.01 * np.sin(9.0 * q + 0.4))
    found = told(tmp_path, geared)
    assert found["verdict"] in ("outside", "undecided"), likely(found)
    discs = replace(geared, wave=lambda q: 0.01 * np.sin(2.0 * q + 0.4))
    found = told(tmp_path, discs)
    assert found["verdict"] != "outside", found["why"]


def test_oil_that_swings_after_each_move_is_named_with_its_period(tmp_path: Path) -> None:
    found = told(tmp_path, Machine(oil_hz=4.0))
    assert found["verdict"] == "effects", found["why"]
    named = {one["name"]: one["parameters"] for one in likely(found)}
    assert named["oil_compliance"]["period_s"]["value"] == pytest.approx(1.0 / (2.0 * np.pi * 4.0), rel=0.1)


#: A small arm's joint: the command follows what disturbs it within a tenth of a second.
FAST = Machine(
    kinds=("repeat", "multisine", "repeat", "steps", "repeat"),
    log_every=1,
    speed_rad_s=3.0,
    valve_hz=70.0,
    kp=3.0,
    tau_s=0.0,
    disturbance_rad_s=0.012,
    disturbance_s=0.08,
)


@pytest.mark.parametrize(("seed", "log_every"), [(1, 1), (3, 1), (3, 5)])
def test_a_command_that_answers_what_disturbs_a_sound_machine_is_no_fault(
    tmp_path: Path, seed: int, log_every: int
) -> None:
    """Each had a hysteresis, or the sign of motion foretold what is left: through a fast loop both follow the noise."""
    found = answer_json(budget_of(read_for_diagnosis(recorded(tmp_path, replace(FAST, log_every=log_every), seed))))
    assert found["verdict"] == "none", found["why"]


def test_a_spools_play_in_a_fast_loop_is_named(tmp_path: Path) -> None:
    found = told(tmp_path, replace(FAST, play_frac=0.03))
    assert found["verdict"] == "effects", found["why"]
    assert names(found) == [("valve_hysteresis", 1)]
    width = likely(found)[0]["parameters"]["half_width_frac"]["value"]
    assert width == pytest.approx(0.03, rel=0.03)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_sound_fast_loop_that_nobody_repeated_has_no_fault(tmp_path: Path, seed: int) -> None:
    """Names that follow the command took the noise away, and then stood out of what was left of it."""
    found = answer_json(
        budget_of(read_for_diagnosis(recorded(tmp_path, replace(FAST, kinds=UNREPEATED, log_every=5), seed)))
    )
    assert (found["verdict"], likely(found)) == ("undecided", []), found["why"]


def test_a_loop_that_something_else_commands_as_well_is_not_run(tmp_path: Path) -> None:
    """A name that is there would have gained nothing by what the controller alone gives."""
    found = budget_of(read_for_diagnosis(recorded(tmp_path, replace(FAST, ahead=1.0, play_frac=0.03))))
    cells = [fit.cell for fit in found.part_fits]
    assert [quiet_loop(one) for one in cells if one.stage == "actuator"] == [None]


def test_a_dead_band_that_takes_from_the_full_flow_is_one_fault(tmp_path: Path) -> None:
    """It had a flow gain of minus its width beside it."""
    found = told(tmp_path, Machine(dead_frac=0.05))
    assert found["verdict"] == "effects", found["why"]
    assert names(found) == [("valve_deadband", 1)]
    parameters = likely(found)[0]["parameters"]
    assert parameters["full_flow"]["value"] == "lost"
    assert parameters["half_width_frac"]["value"] == pytest.approx(0.05, rel=0.02)


@pytest.mark.parametrize(
    "spoilt", [{"push": lambda t: -0.01 * (t > 121.0)}, {"gain": lambda t: 1.0 - 0.12 * (t > 121.0)}]
)
def test_what_begins_half_way_is_not_passed_over(tmp_path: Path, spoilt: dict[str, Any]) -> None:
    found = told(tmp_path, replace(FAST, kinds=UNREPEATED, log_every=5, disturbance_rad_s=2e-3, **spoilt))
    assert found["verdict"] in ("outside", "undecided"), likely(found)
