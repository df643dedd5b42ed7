"""URDF out: the forward kinematics that Pinocchio computes of the file is ours, with every effect that it can hold."""

import numpy as np
import pytest
from machine_cases import MACHINE

from machine.effects.arm import Arm, DhRow, arm_from_dh, arm_of
from machine.effects.arm_urdf import arm_from_urdf
from machine.effects.encoders import true_angles
from machine.effects.entries import pack_effects, parse_entries
from machine.effects.seen import camera_mount
from machine.effects.structure import tcp_poses
from machine.errors import MachineError
from machine.urdf_out import JointLimits, arm_urdf, edited_urdf, machine_urdf, split_entries

pinocchio = pytest.importorskip("pinocchio")

POSTURES = 1000
EFFECTS = [
    {"name": "encoder_bias", "joint": 2, "parameters": {"bias_rad": 0.03}},
    {"name": "link_length_error", "joint": 2, "parameters": {"error_m": 0.02, "of": "a"}},
    {"name": "link_length_error", "joint": 3, "parameters": {"error_m": -0.01, "of": "d"}},
    {"name": "joint_axis_tilt", "joint": 3, "parameters": {"tilt_rad": 0.01, "about": "y"}},
    {"name": "base_tilt", "parameters": {"tilt_rad": 0.02, "axis": [0.6, 0.8, 0.0]}},
    {"name": "hand_eye_translation", "parameters": {"distance_m": 0.02, "direction": [0.0, 0.6, 0.8]}},
]
SPATIAL = """<robot name="r"><link name="b"/><link name="s"/><link name="l1"/><link name="l2"/><link name="l3"/>
<link name="t"/><!-- kept -->
<joint name="stand" type="fixed"><parent link="b"/><child link="s"/>
<origin xyz="0 0.1 0.3" rpy="0.1 0 0.2"/></joint>
<joint name="j1" type="revolute"><parent link="s"/><child link="l1"/><origin xyz="0 0 0.2"/>
<axis xyz="0 0.6 0.8"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
<joint name="j2" type="prismatic"><parent link="l1"/><child link="l2"/><origin xyz="0.5 0.1 0" rpy="0.3 0.2 0.1"/>
<axis xyz="1 0 0"/><limit lower="0" upper="1" velocity="1" effort="1"/></joint>
<joint name="j3" type="revolute"><parent link="l2"/><child link="l3"/><axis xyz="0 0 -1"/>
<limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
<joint name="tip" type="fixed"><parent link="l3"/><child link="t"/>
<origin xyz="0.2 0 0.1" rpy="0 0.5 0"/></joint></robot>"""


def postures(n: int) -> np.ndarray:
    return np.random.default_rng(3).uniform(-1.5, 1.5, (POSTURES, n))


def largest_miss(text: str, arm: Arm, entries: list[dict], tip: str) -> float:
    """Between Pinocchio's tip and ours, entry by entry of the pose."""
    model = pinocchio.buildModelFromXML(text)
    data, frame = model.createData(), model.getFrameId(tip)
    sets = pack_effects(parse_entries(entries, arm.n), arm.n)
    readings = postures(arm.n)
    ours = tcp_poses(arm, sets, true_angles(sets, readings))
    worst = 0.0
    for reading, T in zip(readings, ours, strict=True):
        pinocchio.framesForwardKinematics(model, data, reading)
        worst = max(worst, float(np.abs(data.oMf[frame].homogeneous - T).max()))
    return worst


@pytest.mark.parametrize("entries", [[], EFFECTS])
def test_the_crane_with_and_without_its_effects(entries):
    held, _ = split_entries(parse_entries(entries, 6))
    text = machine_urdf(MACHINE, held)
    assert largest_miss(text, arm_of(MACHINE), entries, "tcp") < 1e-9
    model = pinocchio.buildModelFromXML(text)
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, np.zeros(6))
    tcp, cam = (data.oMf[model.getFrameId(name)].homogeneous for name in ("tcp", "cam_left"))
    mount = camera_mount(pack_effects(held, 6), MACHINE.T_tcp_cam_left)
    assert np.abs(np.linalg.inv(tcp) @ cam - mount).max() < 1e-9


@pytest.mark.parametrize("convention", ["classic", "modified"])
def test_arms_with_a_sliding_joint_in_both_conventions(convention):
    rows = [
        DhRow(0.1, 0.4, 0.7, 0.2, False, convention),
        DhRow(0.3, 0.1, -0.4, 0.5, True, convention),
        DhRow(0.2, -0.2, 1.1, -0.3, False, convention),
    ]
    T = np.eye(4)
    T[:3, 3] = 0.1, 0.2, 0.3
    arm = arm_from_dh(rows, T)
    held, _ = split_entries(parse_entries(EFFECTS, 3))
    limits = JointLimits(np.full(3, -2.0), np.full(3, 2.0), np.full(3, np.inf))
    text = arm_urdf("three", ["a", "b", "c"], arm, held, limits, None)
    assert largest_miss(text, arm, EFFECTS, "tcp") < 1e-9


def test_a_robots_own_urdf_keeps_all_but_its_origins():
    arm, names = arm_from_urdf(SPATIAL, "b", "t")
    held, _ = split_entries(parse_entries(EFFECTS, 3))
    text = edited_urdf(SPATIAL, "b", "t", names, held, np.eye(4))
    assert largest_miss(text, arm, EFFECTS, "t") < 1e-9
    assert largest_miss(edited_urdf(SPATIAL, "b", "t", names, (), None), arm, [], "t") < 1e-9
    assert "kept" in text
    assert text.count("<limit") == SPATIAL.count("<limit")
    with pytest.raises(MachineError, match="from child to parent"):
        edited_urdf(SPATIAL, "l1", "s", ["j1"], held, None)


def test_what_a_urdf_cannot_hold_is_said():
    entries = parse_entries(
        [
            *EFFECTS,
            {"name": "gravity_sag", "joint": 2, "parameters": {"compliance_rad_nm": 1e-6}},
            {"name": "encoder_scale", "joint": 3, "parameters": {"scale_frac": 0.01}},
            {"name": "backlash", "joint": 3, "parameters": {"width_rad": 0.01}},
        ],
        6,
    )
    held, left_out = split_entries(entries)
    assert len(held) == len(EFFECTS)
    assert left_out == (
        "gravity_sag of joint 2: a URDF's links are rigid",
        "encoder_scale of joint 3: a URDF takes a joint's reading as its angle",
        "backlash of joint 3: it acts at stage joint",
    )
