"""The reader of machine files: every wrong file is refused with field, value and bound."""

import re

import numpy as np
import pytest
from machine_cases import MACHINE, TEXT

from machine.description import parse_machine_toml
from machine.errors import MachineFileError

WRONG = [
    ("fx_px = 528.0", "fx_px = -1.0", "camera.fx_px = -1.0: Input should be greater than 0"),
    ("fx_px = 528.0", "fx_px = nan", "camera.fx_px = nan: Input should be a finite number"),
    ("fx_px = 528.0", 'fx_px = "528"', "camera.fx_px = '528': Input should be a valid number"),
    ("cx_px = 639.5", "cx_px = 1300.0", "camera.cx_px = 1300.0 must lie inside the image, 0 .. 1279 [px]"),
    (
        "cx_px = 639.5",
        "cx_px = 968.0",
        "camera: principal point (968, 359.5) px lies 26 % of the image from its middle",
    ),
    ("width_px = 1280", "width_px = 9000", "camera.width_px = 9000: Input should be less than or equal to 8192"),
    ("width_px = 1280", "width_px = 1280.5", "camera.width_px = 1280.5: Input should be a valid integer"),
    ("[-0.042, 0.011", "[-0.342, 0.011", "camera.distortion = [-0.342, 0.011, 0.0, 0.0, -0.005] folds back at"),
    ("[-0.042, 0.011,", "[-0.042,", "camera.distortion = [-0.042, 0.0, 0.0, -0.005]: List should have at least 5"),
    ("baseline_m = 0.12", "baseline = 0.12", "camera.baseline_m: Field required"),
    ("rate_hz = 60.0", "rate_hz = 60.0\nrate = 3", "camera.rate = 3: Extra inputs are not permitted"),
    ("q_min_deg = -25.0", "q_min_deg = 85.0", "joint 'lift': q_min_deg = 85.0 must be below q_max_deg = 80.0 [deg]"),
    ("q_max_deg = 80.0", "q_max_deg = 400.0", "joint.1 (lift).q_max_deg = 400.0: Input should be less than or equal"),
    (
        "park_deg = 55.0",
        "park_deg = 81.0",
        "joint 'lift': park_deg = 81.0 must lie inside its range, -25.0 .. 80.0 [deg]",
    ),
    ("a_m = 1.95", "a_m = 1950.0", "joint.1 (lift).a_m = 1950.0: Input should be less than or equal to 20"),
    ("a_m = 1.95\n", "", "joint.1 (lift).a_m: Field required"),
    ('type = "revolute"', 'type = "prismatic"', "joint.0 (slew).type = 'prismatic': Input should be 'revolute'"),
    ('"classic"', '"modified"', "joint.0 (slew).dh_convention = 'modified': Input should be 'classic'"),
    ('name = "lift"', 'name = "slew"', "joint: names ['slew', 'slew', "),
    ('name = "lift"', 'name = "lift boom"', "joint.1 (lift boom).name = 'lift boom': String should match pattern"),
    ("mass_kg = 190.0", "mass_kg = -1.0", "joint.1 (lift).mass_kg = -1.0: Input should be greater than or equal to 0"),
    ("qd_max_deg_s = 15.0", "qd_max_deg_s = 0.0", "joint.1 (lift).qd_max_deg_s = 0.0: Input should be greater than 0"),
    ("com_m = [-1.10, 0.0, 0.0]", "com_m = [-1.10, 0.0]", "joint.1 (lift).com_m = [-1.1, 0.0]: List should have"),
    ("tcp_speed_max_m_s = 0.15", "tcp_speed_max_m_s = 5.0", "machine.tcp_speed_max_m_s = 5.0: Input should be less"),
    ("T_flange_tcp = [1.0", "T_flange_tcp = [2.0", "tool.T_flange_tcp is not a pose"),
    ("T_flange_tcp = [1.0", "T_flange_tcp = [-1.0", "tool.T_flange_tcp is not a pose"),
    ("T_tcp_tool = [0.0, 1.0, 0.0, 0.0,", "T_tcp_tool = [", "tool.T_tcp_tool = [-1.0, 0.0, 0.0, 0.0, 0.0"),
    ("id = 1\n", "id = 2\n", "ids [10, 2, 2, 3] repeat"),
    ("id = 1\n", "id = 50\n", "id = 50 is not in DICT_4X4_50, which ends at 49"),
    ("side_m = 0.15", "side_m = 150.0", "markers.marker.1 (1).side_m = 150.0: Input should be less than or equal to 2"),
    ('on = "tool"', 'on = "ooi"', "markers.marker: none has on = 'tool'"),
    ("DICT_4X4_50", "DICT_APRILTAG", "markers.dictionary = 'DICT_APRILTAG': String should match pattern"),
    ("cycle_s = 0.001", "cycle_s = 0.0", "plc.cycle_s = 0.0: Input should be greater than 0"),
    ("[plc]", "[plcs]", "plc: Field required"),
    ("velocity_gain_rad_s = ", "velocity_gain_rad_s = -", "Input should be greater than 0 [rad/s]"),
    ("qd_max_deg_s = ", "qd_max_deg_s = -", "Input should be greater than 0 [deg/s]"),
    ("tcp_speed_max_m_s = ", "tcp_speed_max_m_s = -", "Input should be greater than 0 [m/s]"),
    ('name = "hiab033"', "name = ", "machine file is not TOML"),
    ('name = "hiab033"', 'name = "a"\nserial = 7', "machine.serial = 7: Input should be a valid string"),
    ('name = "hiab033"', 'name = "a"\nserial = "a\\u0007"', "machine.serial = 'a\\x07': String should match pattern"),
]


@pytest.mark.parametrize(("old", "new", "expected"), WRONG)
def test_a_wrong_machine_file_names_field_value_and_bound(old, new, expected):
    assert old in TEXT
    with pytest.raises(MachineFileError, match=re.escape(expected)):
        parse_machine_toml(TEXT.replace(old, new, 1))


@pytest.mark.parametrize(
    "text", ["", "joint = 3", "[[joint]]", "joint = [1]", "machine = []", "\x00", "[markers]\nmarker = [[]]"]
)
def test_any_text_gives_a_machine_file_error(text):
    with pytest.raises(MachineFileError):
        parse_machine_toml(text)


def test_every_number_of_a_file_is_needed_or_has_a_default():
    """Delete the file line by line: each time either the same kind of machine comes out, or a clear error."""
    lines = TEXT.splitlines()
    faults = []
    for k in range(len(lines)):
        try:
            parse_machine_toml("\n".join(lines[:k] + lines[k + 1 :]))
        except MachineFileError as error:
            faults.append(str(error))
    assert len(faults) > 100
    assert max(len(fault) for fault in faults) < 500


def test_machines_of_one_name_are_distinguished_by_their_serial_number():
    assert MACHINE.serial == ""
    numbered = parse_machine_toml(TEXT.replace('name = "hiab033"', 'name = "hiab033"\nserial = "HC-0042 b"', 1))
    assert (numbered.name, numbered.serial) == (MACHINE.name, "HC-0042 b")


def test_a_byte_order_mark_of_a_windows_editor_is_passed_over():
    assert parse_machine_toml("\ufeff" + TEXT).name == MACHINE.name


def test_nominal_machine_in_si():
    lift = MACHINE.joints[1]
    assert [joint.name for joint in MACHINE.joints] == ["slew", "lift", "tilt", "wrist1", "wrist2", "wrist3"]
    assert lift.q_max_rad == pytest.approx(np.deg2rad(80.0))
    assert lift.qd_max_rad_s == pytest.approx(np.deg2rad(15.0))
    assert MACHINE.camera.matrix.tolist() == [[528.0, 0.0, 639.5], [0.0, 528.0, 359.5], [0.0, 0.0, 1.0]]
    assert [marker.marker_id for marker in MACHINE.markers_on("tool")] == [10]
    with pytest.raises(ValueError, match="read-only"):
        MACHINE.T_tcp_tool[0, 0] = 2.0


def test_a_rectified_image_carries_no_distortion_whatever_the_file_says():
    assert any(MACHINE.camera.distortion)
    assert parse_machine_toml(TEXT.replace("rectified = false", "rectified = true")).camera.distortion == (0.0,) * 5


def test_a_principal_point_far_from_the_middle_is_taken_where_it_is_confirmed():
    text = TEXT.replace("cx_px = 639.5", "cx_px = 968.0\noff_centre = true")
    text = text.replace("rectified = false", "rectified = true")
    assert parse_machine_toml(text).camera.cx_px == 968.0
