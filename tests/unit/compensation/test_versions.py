"""Versions of a machine: kept, switched effect by effect, and never used on another machine."""

import pytest

from machine.description import parse_machine_toml
from server.compensation.compensation import CompensationError
from server.compensation.versions import MachineVersions, base_id_of
from server.settings import read_machine_text

TEXT = read_machine_text("hiab033")
ANSWER = {
    "recordings": ["one.mcap"],
    "budget": {
        "sentence": "The model misses the tool by 41 mm.",
        "miss_mm": 41.0,
        "left_mm": 3.0,
        "effects": [
            {"name": "valve_lag", "joint": 2, "stage": "actuator", "status": "confirmed", "tool_mm": 1.0,
             "probability": 0.97, "parameters": {"time_constant_s": {"value": 0.03}}},
            {"name": "gravity_sag", "joint": 2, "stage": "structure", "status": "confirmed", "tool_mm": 20.0,
             "probability": 0.99, "parameters": {"compliance_rad_nm": {"value": 1e-6}}},
            {"name": "hand_eye_rotation", "joint": None, "stage": "camera", "status": "confirmed", "tool_mm": 9.0,
             "probability": 0.99, "parameters": {"angle_rad": {"value": 0.02}, "axis": {"value": [0.0, 1.0, 0.0]}}},
            {"name": "encoder_bias", "joint": 3, "stage": "joint", "status": "doubtful", "tool_mm": 7.0,
             "probability": 0.3, "parameters": {"bias_rad": {"value": 0.004}}},
        ],
    },
}  # fmt: skip


def versions(folder, text=TEXT):
    return MachineVersions(folder, parse_machine_toml(text), text)


def test_confirmed_effects_are_kept_and_used_one_by_one(tmp_path):
    desk = versions(tmp_path)
    one = desk.make_version(ANSWER, "0" * 12)
    assert [effect.entry.name for effect in one.effects] == ["gravity_sag", "hand_eye_rotation", "valve_lag"]
    assert [bool(effect.does) for effect in one.effects] == [True, True, False]
    assert desk.in_use is None
    assert desk.compensation() is None
    desk.use_version(one.version_id)
    again = versions(tmp_path)  # after a restart
    assert again.in_use == one
    assert again.compensation().knows_mount
    switched = again.switch_effects(one.version_id, (True, False, False))
    assert not again.compensation().knows_mount
    machine = parse_machine_toml(again.machine_file(switched))
    assert [effect.name for effect in machine.effects] == ["gravity_sag"]
    again.switch_effects(one.version_id, (False, False, True))
    assert again.compensation() is None  # what is left is for a simulation only
    again.use_version("")
    assert versions(tmp_path).in_use is None


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('name = "hiab033"', 'name = "hiab033"\nserial = "7"'),
        ("gravity_base_m_s2 = [0.0, 0.0, -9.81]", "gravity_base_m_s2 = [0.0, 1.7, -9.66]"),
        ("a_m = 1.95", "a_m = 1.96"),
        ("T_tcp_tool = [0.0, 1.0,", "T_tcp_tool = [0.0, -1.0,"),
    ],
    ids=["serial", "gravity", "geometry", "tool"],
)
def test_a_version_of_another_machine_is_never_used(tmp_path, old, new):
    assert old in TEXT
    other = TEXT.replace(old, new, 1)
    if "T_tcp_tool" in old:
        other = other.replace("-1.0, 0.0, 0.0, 0.0,", "1.0, 0.0, 0.0, 0.0,", 1)
    desk = versions(tmp_path)
    one = desk.make_version(ANSWER, "0" * 12)
    desk.use_version(one.version_id)
    theirs = versions(tmp_path, other)
    assert theirs.compensation() is None
    assert "another machine file" in theirs.problem
    with pytest.raises(CompensationError, match="identify again"):
        theirs.use_version(one.version_id)


def test_a_comment_does_not_make_another_machine():
    repainted = parse_machine_toml(TEXT + "\n# repainted\n")
    assert base_id_of(parse_machine_toml(TEXT)) == base_id_of(repainted)


def test_a_budget_that_confirms_nothing_makes_no_version(tmp_path):
    doubtful = {"budget": {"effects": ANSWER["budget"]["effects"][3:]}}
    with pytest.raises(CompensationError, match="confirms no effect"):
        versions(tmp_path).make_version(doubtful, "0" * 12)
    assert versions(tmp_path).list_versions() == ()
