"""Arms at rest with several things wrong at once, as calibration sets show them: which length, and beside what."""

from dataclasses import replace
from typing import Any

import pytest
from diagnosis_cases import MACHINE_TOML, likely
from static_points import examined, packed, static_recording

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.report.text import report_lines
from machine.effects.arm_urdf import arm_from_urdf
from recording.content import Recording
from recording.rows import StaticPoint

FREE = MACHINE_TOML + "\n[points]\ntip = { joint = 6 }\nelbow = { joint = 2 }\n"


CASES = [(2, 0.035, 4, "d", -0.02), (3, -0.03, 4, "d", -0.02), (5, 0.03, 2, "a", -0.02)]


def with_bias(made: Recording, joint: int, bias_rad: float) -> Recording:
    """The same poses as an encoder shows them whose zero is off."""
    rows = []
    for row in made.rows:
        assert isinstance(row, StaticPoint)
        q = list(row.q_rad)
        q[joint - 1] += bias_rad
        rows.append(replace(row, q_rad=tuple(q)))
    return replace(made, rows=tuple(rows))


def told(made: Recording) -> dict[str, Any]:
    return answer_json(budget_of(examined(made)))


def names(found: dict[str, Any]) -> set[tuple[str, int | None, str | None]]:
    first = likely(found)
    return {(one["name"], one["joint"], one["parameters"].get("of", {}).get("value")) for one in first}


@pytest.mark.parametrize(("bias_joint", "bias_rad", "joint", "of", "error_m"), CASES)
def test_a_zero_that_is_off_hides_no_length(
    bias_joint: int, bias_rad: float, joint: int, of: str, error_m: float
) -> None:
    """As the only name an error of d was best told as one of a, and stayed that beside the zero: four wrong names."""
    made = static_recording(packed("link_length_error", joint, error_m=error_m, of=of), FREE)
    found = told(with_bias(made, bias_joint, bias_rad))
    assert found["verdict"] == "effects", found["why"]
    assert names(found) == {("encoder_bias", bias_joint, None), ("link_length_error", joint, of)}
    alike = [{(one["name"], one["joint"]) for one in members} for members in found["indistinguishable"]]
    assert all(len(members) < 4 for members in alike)  # at the sizes named, not those of each as the only name
    probabilities = [one["probability"] for one in found["hypotheses"]]
    assert probabilities == sorted(probabilities, reverse=True)


def test_points_that_no_arm_explains_are_no_noise() -> None:
    """The elbow's point said to be on the wrong link: half a metre of "noise", and nothing above it."""
    wrong = FREE.replace("elbow = { joint = 2 }", "elbow = { joint = 1 }")
    wrong = wrong.replace("tip = { joint = 6 }", "tip = { joint = 1 }")
    found = told(static_recording(packed("link_length_error", 4, error_m=0.0, of="d"), wrong))
    assert found["verdict"] == "undecided"
    assert "the noise was never measured" in found["why"]


def test_two_reflectors_of_one_name_are_no_noise() -> None:
    """What differs in one pose under one name was taken for the floor, and nothing was above it."""
    made = static_recording(packed("link_length_error", 4, error_m=0.02, of="d"), FREE)
    rows = tuple(replace(row, point="tip") for row in made.rows if isinstance(row, StaticPoint))
    found = told(replace(made, rows=rows))
    assert found["verdict"] == "undecided"


@pytest.mark.parametrize("place", ["tip = { joint = 6, xyz_m = [0.0, -0.3, 0.1] }", "tip = { joint = 6 }"])
def test_six_poses_name_what_six_poses_show(place: str) -> None:
    """A mixture of all effects explains each of eighteen numbers: the noise was guessed a tenth of the true one."""
    toml = MACHINE_TOML + "\n[points]\n" + place + "\n"
    for error_m, wanted in ((0.0, "undecided"), (0.02, "effects")):  # a noise that nobody measured
        made = static_recording(packed("link_length_error", 2, error_m=error_m, of="a"), toml, seed=101)
        tip = tuple(row for row in made.rows if isinstance(row, StaticPoint) and row.point == "tip")
        found = told(replace(made, rows=tip[:6]))
        assert found["verdict"] in (wanted, "undecided"), found["why"]
        if wanted == "effects":
            (effect,) = likely(found)
            assert (effect["name"], effect["joint"]) == ("link_length_error", 2)
            assert effect["parameters"]["error_m"]["low"] < error_m < effect["parameters"]["error_m"]["high"]


URDF = """<robot name="two"><link name="base"/><link name="a"/><link name="b"/><link name="c"/>
<joint name="first" type="revolute"><origin xyz="0 0 0.1"/><axis xyz="0 0 1"/>
  <parent link="base"/><child link="a"/></joint>
<joint name="across" type="revolute"><origin xyz="-0.0004 0 0.36"/><axis xyz="0 1 0"/>
  <parent link="a"/><child link="b"/></joint>
<joint name="along" type="revolute"><origin xyz="0.3 0.2 0"/><axis xyz="0 1 0"/>
  <parent link="b"/><child link="c"/></joint>
</robot>"""


def test_a_urdf_length_is_what_parts_two_axes() -> None:
    """36 cm along the last axis are its d; to lengthen that instead of the normal moved the tip nowhere new."""
    arm, _ = arm_from_urdf(URDF, "base", "c")
    assert arm.length_before[1, 0] == pytest.approx([-1.0, 0.0, 0.0])
    assert arm.length_before[2, 0] == pytest.approx([1.0, 0.0, 0.0])  # parallel axes: what is along both is a d
    assert arm.length_before[0, 0] == pytest.approx([0.0, 0.0, 0.0])


def test_where_nothing_can_be_replayed_no_effect_is_no_answer() -> None:
    """Every point has a name that the machine file does not know."""
    elsewhere = MACHINE_TOML + "\n[points]\nwrist = { joint = 6 }\n"
    whole = examined(static_recording(packed("link_length_error", 4, error_m=0.0, of="d"), elsewhere))
    assert any("xyz_m where it is known" in str(one) for one in whole.findings)
    found = answer_json(budget_of(whole))
    assert (found["verdict"], found["hypotheses"]) == ("undecided", [])
    assert not [one for one in report_lines(found) if "no effect" in one]
