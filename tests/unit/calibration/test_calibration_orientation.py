"""Orientation adjustment: the corrected form in every camera mounting, and eq. 7-8's documented counter-example."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from machine.rotations import geodesic_angle, rotation_about, rotation_from_rotvec
from server.calibration.checks import CalibrationInputError
from server.calibration.reference import (
    orientation_reference,
    orientation_reference_paper,
    orientation_reference_paper_axes,
    quat_product_wxyz,
)

R_TCP_CAM = np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])
R_TCP_TOOL = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
START = Rotation.from_euler("xyz", [6, -5, 8], degrees=True).as_matrix()


def seen(R_base_tcp, R_tcp_cam, R_tcp_tool, R_base_ooi):
    R_cam_base = (R_base_tcp @ R_tcp_cam).T
    return R_cam_base @ R_base_tcp @ R_tcp_tool, R_cam_base @ R_base_ooi


def euler_left(R_base_tcp_ref, R_tcp_tool, R_base_ooi):
    return Rotation.from_matrix(R_base_ooi.T @ R_base_tcp_ref @ R_tcp_tool).as_euler("xyz", degrees=True)


def test_quaternion_product_is_the_rotation_product():
    rng = np.random.default_rng(1)
    for _ in range(20):
        a, b = rng.normal(size=(2, 4))
        a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
        xyzw = (Rotation.from_quat(a[[1, 2, 3, 0]]) * Rotation.from_quat(b[[1, 2, 3, 0]])).as_quat()
        ours = quat_product_wxyz(a, b)
        assert abs(ours @ xyzw[[3, 0, 1, 2]]) == pytest.approx(1.0, abs=1e-12)


def test_printed_form_is_right_only_with_parallel_camera_axes():
    tool, ooi = seen(START, np.eye(3), np.eye(3), np.eye(3))
    ref = orientation_reference_paper(START, ooi, tool)
    assert geodesic_angle(ref, np.eye(3)) < 1e-9


def test_counter_example_of_eq_8_with_opencv_axes():
    """Marker facing the camera (180 deg about x): (6, -5, 8) deg become about (-1, -10, 16) deg instead of 0."""
    tool, ooi = seen(START, rotation_about("x", np.pi), np.eye(3), np.eye(3))
    left = euler_left(orientation_reference_paper(START, ooi, tool), np.eye(3), np.eye(3))
    np.testing.assert_allclose(left, [-1.4, -9.9, 16.1], atol=0.1)
    corrected = orientation_reference(START, np.eye(3), tool, ooi)
    np.testing.assert_allclose(euler_left(corrected, np.eye(3), np.eye(3)), 0.0, atol=1e-9)


def test_corrected_form_is_exact_for_any_camera_mount_and_pose():
    rng = np.random.default_rng(2)
    for _ in range(50):
        R_base_tcp, R_base_ooi, R_tcp_cam = (rotation_from_rotvec(v) for v in rng.normal(size=(3, 3)))
        tool, ooi = seen(R_base_tcp, R_tcp_cam, R_TCP_TOOL, R_base_ooi)
        ref = orientation_reference(R_base_tcp, R_TCP_TOOL, tool, ooi)
        assert geodesic_angle(ref @ R_TCP_TOOL, R_base_ooi) < 1e-9


def test_unknown_tool_mounting_leaves_little_and_iterating_removes_it():
    error = rotation_from_rotvec(np.deg2rad([3.0, -4.0, 2.0]))  # 5.4 deg
    X_true = R_TCP_TOOL @ error
    R_base_ooi = np.eye(3)
    R_base_tcp = START @ R_TCP_TOOL.T
    left = []
    for _ in range(3):
        tool, ooi = seen(R_base_tcp, R_TCP_CAM, X_true, R_base_ooi)
        R_base_tcp = orientation_reference(R_base_tcp, R_TCP_TOOL, tool, ooi)
        left.append(np.rad2deg(geodesic_angle(R_base_tcp @ X_true, R_base_ooi)))
    assert 0.3 < left[0] < 1.3  # deg
    assert left[2] < 0.02


def test_paper_axes_form_is_exact_with_the_nominal_mount_and_near_with_a_tilted_one():
    for tilt_deg, bound_deg in ((0.0, 1e-6), (5.0, 1.2)):
        mount = R_TCP_CAM @ rotation_about("x", np.deg2rad(tilt_deg))
        R_base_tcp = START @ R_TCP_TOOL.T
        tool, ooi = seen(R_base_tcp, mount, R_TCP_TOOL, np.eye(3))
        ref = orientation_reference_paper_axes(R_base_tcp, R_TCP_CAM, ooi, tool)
        assert np.rad2deg(geodesic_angle(ref @ R_TCP_TOOL, np.eye(3))) <= bound_deg


def test_no_rotation_is_refused():
    with pytest.raises(CalibrationInputError, match="R_cam_ooi"):
        orientation_reference_paper(np.eye(3), np.diag([1.0, 1.0, -1.0]), np.eye(3))
    with pytest.raises(CalibrationInputError, match=r"\(3, 3\)"):
        orientation_reference(np.eye(4), np.eye(3), np.eye(3), np.eye(3))
