"""docs/frames.md, sentence by sentence: where the frames are and how their axes lie."""

import numpy as np
import pytest
from machine_cases import CHAIN, MACHINE, QS

from machine.kinematics import link_poses, tcp_pose

X, Y, Z = np.eye(3)
UP = np.array([0.0, 0.0, 1.0])


def level(slew_deg, lift_deg, tilt_deg):
    """theta4 = 0, theta5 = lift + tilt, theta6 = 0: the tool is horizontal."""
    return np.deg2rad([slew_deg, lift_deg, tilt_deg, 0.0, lift_deg + tilt_deg, 0.0])


def test_at_zero_the_tcp_is_at_reach_and_height_and_z_points_back():
    T = tcp_pose(CHAIN, np.zeros(6))
    assert T[:3, 3] == pytest.approx([0.16 + 1.95 + 2.10 + 0.55, 0.0, 1.75 + 0.14], abs=1e-12)  # m
    assert T[:3, 2] == pytest.approx([-1.0, 0.0, 0.0], abs=1e-12)


def test_axis_of_joint_6_is_minus_z_tcp_so_n_and_s_span_the_plane_across_it():
    for q in QS[:100]:
        torsion_axis = link_poses(CHAIN, q)[5][:3, 2]
        T = tcp_pose(CHAIN, q)
        assert torsion_axis @ T[:3, 2] == pytest.approx(-1.0, abs=1e-12)
        assert abs(torsion_axis @ T[:3, 0]) + abs(torsion_axis @ T[:3, 1]) < 1e-12
        assert np.abs(T[:3, 3] - link_poses(CHAIN, q)[6][:3, 3]).max() < 1e-12  # link 7 has no length


def test_table_1_twists_and_link_7():
    assert np.rad2deg(CHAIN.dh_alpha_rad) == pytest.approx([90, 0, 90, 90, -90, 90], abs=1e-12)
    assert np.nonzero(CHAIN.dh_a_m)[0].tolist() == [0, 1, 2]
    assert CHAIN.dh_d_m[[1, 4]].tolist() == [0.0, 0.0]
    assert np.abs(CHAIN.T_flange_tcp - [[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]).max() < 1e-12


@pytest.mark.parametrize(("slew", "lift", "tilt"), [(0.0, 40.0, -80.0), (25.0, 55.0, -110.0), (-35.0, 20.0, -60.0)])
def test_level_posture(slew, lift, tilt):
    T = tcp_pose(CHAIN, level(slew, lift, tilt))
    ahead = np.array([np.cos(np.deg2rad(slew)), np.sin(np.deg2rad(slew)), 0.0])
    left = np.cross(UP, ahead)
    assert -T[:3, 2] == pytest.approx(ahead, abs=1e-12)  # the tool looks along -z_tcp
    assert T[:3, 0] == pytest.approx(UP, abs=1e-12)
    assert T[:3, 1] == pytest.approx(left, abs=1e-12)
    tool = T @ MACHINE.T_tcp_tool
    assert tool[:3, 0] == pytest.approx(-left, abs=1e-12)
    assert tool[:3, 1] == pytest.approx(UP, abs=1e-12)
    assert tool[:3, 2] == pytest.approx(-ahead, abs=1e-12)
    assert tool[:3, 3] - T[:3, 3] == pytest.approx(-0.03 * ahead, abs=1e-12)
    cam = T @ MACHINE.T_tcp_cam_left
    assert cam[:3, 0] == pytest.approx(-left, abs=1e-12)
    assert cam[:3, 1] == pytest.approx(-UP, abs=1e-12)
    assert cam[:3, 2] == pytest.approx(ahead, abs=1e-12)
    assert cam[:3, 3] - T[:3, 3] == pytest.approx(0.18 * UP + 0.06 * left - 0.50 * ahead, abs=1e-12)
    middle = cam[:3, 3] + 0.5 * MACHINE.camera.baseline_m * cam[:3, 0]
    assert abs((middle - T[:3, 3]) @ left) < 1e-12  # the torsion axis lies midway below the eyes


def test_link_frames_of_the_table():
    poses = link_poses(CHAIN, np.zeros(6))
    assert poses[1][:3, 3] == pytest.approx([0.16, 0.0, 1.75], abs=1e-12)
    assert poses[1][:3, 2] == pytest.approx(-Y, abs=1e-12)
    assert poses[2][:3, 3] == pytest.approx([2.11, 0.0, 1.75], abs=1e-12)
    assert poses[3][:3, 3] == pytest.approx([2.11, 0.0, 1.89], abs=1e-12)
    assert poses[3][:3, 2] == pytest.approx(X, abs=1e-12)  # along the tilt boom
    assert poses[4][:3, 3] == pytest.approx([4.21, 0.0, 1.89], abs=1e-12)
    assert poses[5][:3, 3] == pytest.approx(poses[4][:3, 3], abs=1e-12)  # spherical wrist
    assert poses[5][:3, 2] == pytest.approx(X, abs=1e-12)  # torsion axis


def test_positive_angles():
    """Slew to the left seen from above, lift up, tilt up."""
    for j, direction in ((0, Y), (1, Z), (2, Z)):
        assert (tcp_pose(CHAIN, 0.1 * np.eye(6)[j])[:3, 3] - tcp_pose(CHAIN, np.zeros(6))[:3, 3]) @ direction > 0.1


def test_the_ooi_is_the_middle_of_its_three_markers_with_unequal_roll_and_not_coplanar():
    markers = MACHINE.markers_on("ooi")
    centres = np.array([marker.T_on_marker[:3, 3] for marker in markers])
    assert centres.mean(axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    assert np.ptp(centres[:, 2]) == pytest.approx(0.04)  # m
    assert all(marker.T_on_marker[2, 2] > 0.9 for marker in markers)
    rolls = [np.rad2deg(np.arctan2(m.T_on_marker[1, 0], m.T_on_marker[0, 0])) for m in markers]
    assert np.ptp(rolls) > 50.0
