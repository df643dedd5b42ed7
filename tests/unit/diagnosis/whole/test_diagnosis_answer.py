"""Whole diagnoses of recordings made by a plant that shares no code with the diagnosis."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_cases import likely
from foreign_plant import Fault, write
from typer.testing import CliRunner

from diagnosis.answer import _size_and_direction, _value_with_limits, answer_json
from diagnosis.budget import Budget, budget_of
from diagnosis.fleet.summary import equals_of
from diagnosis.reading.read import read_for_diagnosis
from diagnosis.report.page import report_page
from diagnosis.report.text import report_lines
from diagnosis.search.candidates import candidates_of_effects
from longreach.cli import app
from machine.effects.registry import NAMES, effect_named
from server.api.examples import FREE_FORM

KINDS = ("repeat", "repeat", "repeat", "steps", "workcycle")
SHORT = {"seconds": 10.0, "kinds": KINDS}
KEYS = {
    "verdict",
    "hypotheses",
    "indistinguishable",
    "credible_set_90",
    "localisation",
    "merged_stages",
    "shrink",
    "unexplained",
    "detection_limits",
    "next_experiment",
    "budget",
    "stages",
    "missing",
}


FIELDS = Path(__file__).parents[4] / "docs" / "diagnosis-answer.md"


def diagnosed(tmp_path: Path, fault: Fault, seed: int = 3, **options) -> tuple[Budget, dict]:
    whole = read_for_diagnosis(write(tmp_path / "run", fault, seed, **(options or SHORT)))
    assert whole.has_judgeable_stage, [str(finding) for finding in whole.findings]
    found = budget_of(whole)
    result = answer_json(found)
    assert untold(result) == set()
    return found, result


def untold(result: dict[str, Any]) -> set[str]:
    """Fields of an answer that the document of its fields does not name."""
    return set(_fields(result)) - set(re.findall(r"`(\w+)`", FIELDS.read_text(encoding="utf-8")))


def _fields(stated: Any) -> Iterator[str]:
    """Every key but those that are names themselves: of a parameter, of an experiment."""
    if isinstance(stated, list):
        for item in stated:
            yield from _fields(item)
    if isinstance(stated, dict):
        yield from stated
        for key, value in stated.items():
            named = isinstance(value, dict) and key in ("parameters", "used", "alternatives")
            yield from _fields(list(value.values()) if named else value)


def names(result: dict) -> list[tuple[str, int | None]]:
    return [(one["name"], one["joint"]) for one in likely(result)]


def test_the_example_of_rest_has_the_fields_of_an_answer() -> None:
    example = FREE_FORM["GET /v1/diagnoses/{diagnosis_id}/result"]
    assert untold(example) == set()
    assert untold({"hypotheses": [{"effects": [{"effect": "backlash"}]}]}) == {"effect"}


@pytest.mark.parametrize("limit", [0.00123456789, -0.00123456789, 123456.7, 0.99999999, -5e-9, 0.0])
def test_a_printed_limit_leaves_nothing_out(limit: float) -> None:
    stated = _value_with_limits(np.array([limit, limit, limit]), "1")
    assert stated["low"] <= limit <= stated["high"]
    assert stated["high"] - stated["low"] <= 1.01e-5 * abs(limit)


def test_a_base_is_tilted_about_level_axes_only() -> None:
    (tilt,) = candidates_of_effects(("base_tilt",), ())
    assert [slot.component_index for slot in tilt.parameter_slots] == [
        0,
        1,
    ]  # about the upright it is the bias of the first encoder
    direction = effect_named("base_tilt").direction
    stated = _size_and_direction("tilt_rad", "rad", direction, np.array([[3e-3, 2e-3, 4e-3], [-4e-3, -5e-3, -3e-3]]))
    assert stated["axis"]["value"] == [0.6, -0.8, 0.0]
    assert stated["tilt_rad"]["value"] == pytest.approx(5e-3)


def test_nothing_is_found_where_nothing_is_wrong(tmp_path: Path) -> None:
    _, result = diagnosed(tmp_path, Fault())
    assert result["verdict"] == "none", result["why"]
    assert likely(result) == []
    assert result["shrink"]["overall"]["closed_frac"] is None
    limits = {(one["name"], one["joint"]): one["size"] for one in result["detection_limits"]}
    assert 0.0 < limits["valve_deadband", 1] < 0.01
    assert set(result) >= KEYS
    json.dumps(result, allow_nan=False)


@pytest.mark.parametrize(
    ("fault", "name", "joint", "parameter", "size", "tolerance"),
    [
        (Fault(deadband=(0.02, 0.0)), "valve_deadband", 1, "half_width_frac", 0.02, 5e-4),
        (Fault(lag_s=(0.0, 0.03)), "valve_lag", 2, "time_constant_s", 0.03, 2e-3),
        (Fault(delay_s=0.02), "transport_delay", None, "delay_s", 0.02, 8e-3),
    ],
)
def test_one_effect_is_named_with_its_joint_and_size(
    tmp_path: Path, fault: Fault, name: str, joint: int | None, parameter: str, size: float, tolerance: float
) -> None:
    _, result = diagnosed(tmp_path, fault)
    assert result["verdict"] == "effects", result["why"]
    assert names(result) == [(name, joint)]
    found = likely(result)[0]["parameters"][parameter]
    assert abs(found["value"] - size) < tolerance
    assert found["low"] <= found["value"] <= found["high"]
    assert result["shrink"]["overall"]["closed_frac"] > 0.9
    rows = [result["shrink"]["overall"], *result["shrink"]["stages"]]
    for row in (one for one in rows if one["closed_frac"] is not None):
        before, after, floor = (row[name] ** 2 for name in ("before", "after", "floor"))
        assert row["closed_frac"] == pytest.approx(1.0 - (after - floor) / (before - floor), abs=1e-3)


def test_two_effects_on_different_stages_are_both_named(tmp_path: Path) -> None:
    _, result = diagnosed(tmp_path, Fault(kp=(0.15, 0.0), deadband=(0.0, 0.02)))
    assert result["verdict"] == "effects", result["why"]
    assert names(result) == [("controller_gain_error", 1), ("valve_deadband", 2)]


def test_an_effect_outside_the_catalogue_is_refused_with_a_lead(tmp_path: Path) -> None:
    """A spool that cannot move faster than a limit; the best name closes part of its gap."""
    _, result = diagnosed(tmp_path, Fault(spool_rate=(1.0, np.inf)))
    assert result["verdict"] in ("outside", "undecided")
    fired = [one for one in result["unexplained"] if one["stage"] == "actuator"]
    assert {one["joint"] for one in fired} == {1}
    assert any(one["lead"] for one in fired)
    assert any("lead" in text or "unexplained" in text for text in report_lines(result))


def test_gain_and_encoder_scale_are_one_class_without_a_link_side_measurement(tmp_path: Path) -> None:
    _, result = diagnosed(tmp_path, Fault(gain=(0.1, 0.0)))
    assert names(result) == [("flow_gain_error", 1)]
    classes = [{(one["name"], one["joint"]) for one in members} for members in result["indistinguishable"]]
    assert any({("flow_gain_error", 1), ("encoder_scale", 1)} <= members for members in classes)
    assert result["next_experiment"]["separates"][0] == {"name": "flow_gain_error", "joint": 1}
    assert result["next_experiment"]["why"]


def test_backlash_behind_the_encoder_is_seen_by_a_tracker(tmp_path: Path) -> None:
    options = {"seconds": 8.0, "kinds": ("repeat", "repeat", "workcycle"), "tracker_m": 2e-4}
    _, result = diagnosed(tmp_path, Fault(backlash=(0.0, 0.004)), **options)
    assert names(result) == [("backlash", 2)]
    width = likely(result)[0]["parameters"]["width_rad"]
    assert abs(width["value"] - 0.004) < 4e-4


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (Fault(), []),
        (Fault(length_m=0.01), [("link_length_error", 2)]),
        (Fault(sag_rad_nm=2e-6), [("gravity_sag", 2)]),
        (Fault(bias=(0.0, 0.004)), [("encoder_bias", 2)]),
    ],
)
def test_poses_at_rest_name_structure_and_joint_effects(
    tmp_path: Path, fault: Fault, expected: list[tuple[str, int]]
) -> None:
    _, result = diagnosed(tmp_path, fault, static=40, kinds=())
    assert result["verdict"] == ("effects" if expected else "none"), result["why"]
    assert names(result) == expected


@pytest.mark.parametrize(
    ("fault", "names_allowed"),
    [
        (Fault(camera_late_s=0.03), {("camera_latency", None), ("clock_offset", None)}),
        (Fault(focal=0.01), {("focal_length_error", None)}),
    ],
)
def test_marker_corners_name_the_cameras_effects(
    tmp_path: Path, fault: Fault, names_allowed: set[tuple[str, int | None]]
) -> None:
    """A late camera and a wrong clock are one thing by definition; either name stands for the class."""
    _, result = diagnosed(tmp_path, fault, seconds=8.0, kinds=("repeat", "repeat", "workcycle"), camera_px=0.1)
    assert result["verdict"] == "effects", result["why"]
    assert len(names(result)) == 1
    assert set(names(result)) <= names_allowed


def test_a_tip_that_slides_is_no_effect_of_the_catalogue(tmp_path: Path) -> None:
    _, result = diagnosed(tmp_path, Fault(trolley_m=0.01), static=40, kinds=())
    assert result["verdict"] == "outside"
    assert result["outside_probability"] > 0.5
    assert [one["measurement"] for one in result["shrink"]["stages"]] == ["static"]


def test_the_command_writes_json_and_a_page(tmp_path: Path) -> None:
    made = write(tmp_path / "run", Fault(sag_rad_nm=2e-6), static=40, kinds=())
    files = tmp_path / "answer.json", tmp_path / "answer.html"
    done = CliRunner().invoke(app, ["diagnose", str(made), "--json", str(files[0]), "--html", str(files[1])])
    assert done.exit_code == 0, done.output
    result = json.loads(files[0].read_text())
    assert set(result) >= KEYS
    assert untold(result) == set()
    assert {one["name"] for one in likely(result)} <= set(NAMES)
    text = files[1].read_text()
    assert "gravity_sag" in text
    assert "The model misses the tool by" in text
    assert "<script" not in text
    assert text.count('class="plot"') >= 3  # residual over time, its distribution, its autocorrelation


@pytest.mark.parametrize("spoil", ["nothing there", "no machine", "degrees", "empty"])
def test_bad_input_is_one_clear_line_each_and_exit_code_2(tmp_path: Path, spoil: str) -> None:
    made = tmp_path / "run"
    if spoil != "nothing there":
        write(made, Fault(), static=9, kinds=())
    if spoil == "no machine":
        (made / "machine.toml").unlink()
    if spoil == "degrees":
        rows = (made / "static.csv").read_text().splitlines()
        cells = [row.split(",") for row in rows[1:]]
        far = [",".join([c[0], str(57.3 * float(c[1])), str(57.3 * float(c[2])), *c[3:]]) for c in cells]
        (made / "static.csv").write_text("\n".join([rows[0], *far]))
    if spoil == "empty":
        (made / "static.csv").unlink()
    done = CliRunner().invoke(app, ["diagnose", str(made)])
    assert done.exit_code == 2
    assert "Traceback" not in done.output
    assert "fatal" in done.output


def test_the_page_escapes_what_it_shows(tmp_path: Path) -> None:
    _, result = diagnosed(tmp_path, Fault(), static=12, kinds=())
    text = report_page({**result, "why": "<blink>"}, "<blink>")
    assert "<blink>" not in text
    assert "&lt;blink&gt;" in text


def test_effects_that_cannot_be_distinguished_are_found_from_either() -> None:
    bias, tilt, sag = ({"name": name, "joint": j} for name, j in (("bias", 6), ("tilt", 7), ("sag", 2)))
    result = {"indistinguishable": [[bias, tilt]]}
    assert equals_of(result, bias) == [tilt]
    assert equals_of(result, sag) == []
