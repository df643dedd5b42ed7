"""The URDF against our kinematics, read by two other parsers."""

import io
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio
import pytest
import yourdfpy
from machine_cases import CHAIN, MACHINE, QS

from machine.kinematics import link_poses, tcp_jacobian, tcp_pose
from machine.rotations import rotation_about
from machine.urdf import urdf_text
from machine.urdf_shapes import roll_pitch_yaw

TEXT = urdf_text(MACHINE)


def test_pinocchio_reads_the_same_kinematics_over_1000_joint_vectors():
    model = pinocchio.buildModelFromXML(TEXT)
    data, frame = model.createData(), model.getFrameId("tcp")
    assert [model.names[i] for i in range(1, 7)] == [joint.name for joint in MACHINE.joints]
    for q in QS:
        J = pinocchio.computeFrameJacobian(model, data, q, frame, pinocchio.LOCAL_WORLD_ALIGNED)
        pinocchio.framesForwardKinematics(model, data, q)
        assert np.abs(tcp_pose(CHAIN, q) - data.oMf[frame].homogeneous).max() < 1e-9
        assert np.abs(tcp_jacobian(CHAIN, q) - J).max() < 1e-9


def test_yourdfpy_reads_the_same_kinematics_over_1000_joint_vectors():
    urdf = yourdfpy.URDF.load(io.StringIO(TEXT), build_scene_graph=True, load_meshes=False)
    for q in QS:
        urdf.update_cfg(q)
        assert np.abs(urdf.get_transform("tcp", "base") - tcp_pose(CHAIN, q)).max() < 1e-9


def test_every_frame_of_the_table_is_there():
    urdf = yourdfpy.URDF.load(io.StringIO(TEXT))
    for q in QS[:20]:
        urdf.update_cfg(q)
        T_base_tcp, links = tcp_pose(CHAIN, q), link_poses(CHAIN, q)
        cam = T_base_tcp @ MACHINE.T_tcp_cam_left
        right = cam.copy()
        right[:3, 3] += MACHINE.camera.baseline_m * cam[:3, 0]
        wanted = {f"link_{i}": links[i] for i in range(1, 7)}
        wanted |= {"flange": links[6], "tool": T_base_tcp @ MACHINE.T_tcp_tool, "cam_left": cam, "cam_right": right}
        for name, T in wanted.items():
            assert np.abs(urdf.get_transform(name, "base") - T).max() < 1e-9, name


def test_limits_are_those_of_the_machine_file():
    for element, joint in zip(ET.fromstring(TEXT).findall("joint[@type='revolute']"), MACHINE.joints, strict=True):
        limit = element.find("limit")
        assert limit is not None
        assert float(limit.attrib["lower"]) == pytest.approx(joint.q_min_rad, abs=1e-9)
        assert float(limit.attrib["upper"]) == pytest.approx(joint.q_max_rad, abs=1e-9)
        assert float(limit.attrib["velocity"]) == pytest.approx(joint.qd_max_rad_s, abs=1e-9)


def test_it_is_drawn_as_one_crane():
    """The shapes span from the floor to the tool's tip, and no moving part floats free of the next."""
    urdf = yourdfpy.URDF.load(io.StringIO(TEXT))
    q = np.deg2rad([0.0, 40.0, -85.0, 0.0, -40.0, 0.0])
    urdf.update_cfg(q)
    low, high = urdf.scene.bounds
    tip = tcp_pose(CHAIN, q)[:3, 3]
    assert low[2] == pytest.approx(-0.12, abs=0.01)
    assert high[0] == pytest.approx(tip[0], abs=0.1)
    assert high[2] > 1.75 + 1.95 * np.sin(np.deg2rad(40.0))
    drawn = {link.name for link in urdf.robot.links if link.visuals}
    assert drawn >= {"base", *(f"link_{i}" for i in range(1, 7)), "tcp", "tool", "cam_left"}


@pytest.mark.parametrize("pitch_deg", [-90.0, 90.0, 0.0, 33.0])
def test_roll_pitch_yaw_gives_the_rotation_back(pitch_deg):
    R = rotation_about("z", 0.7) @ rotation_about("y", np.deg2rad(pitch_deg)) @ rotation_about("x", -1.9)
    roll, pitch, yaw = roll_pitch_yaw(R)
    again = rotation_about("z", yaw) @ rotation_about("y", pitch) @ rotation_about("x", roll)
    assert np.abs(again - R).max() < 1e-12
