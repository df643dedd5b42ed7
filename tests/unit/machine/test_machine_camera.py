"""The camera model against OpenCV, its inverse, its Jacobian; markers and rotations."""

from importlib.resources import files

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from machine.camera import project, project_stereo, projection_jacobian, undistort_to_rays
from machine.description import parse_machine_toml
from machine.errors import MachineFileError
from machine.markers import marker_corners
from machine.poses import inverse_pose, pose
from machine.rotations import (
    geodesic_angle,
    nearest_rotation,
    quat_wxyz_from_rotation,
    rotation_from_quat_wxyz,
    rotation_from_rotvec,
    rotvec_from_rotation,
)
from machine.visibility import marker_in_view

TEXT = (files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8")
MACHINE = parse_machine_toml(TEXT)
CAMERA = MACHINE.camera
VECTORS = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)


def points(n=500, seed=3):
    rng = np.random.default_rng(seed)
    z = rng.uniform(0.4, 3.0, n)
    return np.stack([rng.uniform(-1.1, 1.1, n) * z, rng.uniform(-0.6, 0.6, n) * z, z], axis=1)


def test_projection_equals_opencv():
    expected, _ = cv2.projectPoints(points(), np.zeros(3), np.zeros(3), CAMERA.matrix, np.array(CAMERA.distortion))
    assert np.abs(project(CAMERA, points()) - expected.reshape(-1, 2)).max() < 1e-9


def test_undistortion_inverts_the_projection():
    rays = points()[:, :2] / points()[:, 2:]
    assert np.abs(undistort_to_rays(CAMERA, project(CAMERA, points())) - rays).max() < 1e-11


def test_projection_jacobian_equals_finite_differences():
    p, h = points(50), 1e-6
    J = projection_jacobian(CAMERA, p)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = h
        numeric = (project(CAMERA, p + step) - project(CAMERA, p - step)) / (2 * h)
        assert np.abs(J[:, :, axis] - numeric).max() < 1e-3  # px/m, of values up to 1e3


def test_right_eye_sees_near_points_further_left():
    left, right = project_stereo(CAMERA, np.array([[0.0, 0.0, 1.0]]))
    assert left[0] == pytest.approx([639.5, 359.5], abs=1e-9)
    assert left[0, 0] - right[0, 0] == pytest.approx(CAMERA.fx_px * CAMERA.baseline_m, rel=2e-3)  # distortion on top


def test_corners_are_in_opencv_order():
    assert marker_corners(0.2).tolist() == [[-0.1, 0.1, 0], [0.1, 0.1, 0], [0.1, -0.1, 0], [-0.1, -0.1, 0]]


def test_markers_face_the_nominal_camera_at_the_goal():
    T_ooi_tool = pose(np.eye(3), np.array([0.0, 0.0, 0.1]))
    T_cam_tool = inverse_pose(MACHINE.T_tcp_cam_left) @ MACHINE.T_tcp_tool
    T_cam_ooi = T_cam_tool @ inverse_pose(T_ooi_tool)
    assert all(marker_in_view(CAMERA, T_cam_ooi, marker, 10.0) for marker in MACHINE.markers_on("ooi"))
    assert all(marker_in_view(CAMERA, T_cam_tool, marker, 10.0) for marker in MACHINE.markers_on("tool"))
    turned = T_cam_ooi @ pose(rotation_from_rotvec(np.array([np.pi, 0.0, 0.0])), np.zeros(3))
    assert not any(marker_in_view(CAMERA, turned, marker, 10.0) for marker in MACHINE.markers_on("ooi"))


@given(VECTORS)
def test_rotation_vectors_survive_the_round_trip(rotvec):
    R = rotation_from_rotvec(rotvec)
    again = rotation_from_rotvec(rotvec_from_rotation(R))
    assert np.abs(again - R).max() < 1e-9
    assert np.abs(R - Rotation.from_rotvec(rotvec).as_matrix()).max() < 1e-12


@given(VECTORS, VECTORS)
def test_rotations_form_a_group(a, b):
    A, B = rotation_from_rotvec(a), rotation_from_rotvec(b)
    assert np.abs(A @ A.T - np.eye(3)).max() < 1e-12
    assert np.linalg.det(A @ B) == pytest.approx(1.0, abs=1e-12)
    assert geodesic_angle(A, B) == pytest.approx(geodesic_angle(B, A), abs=1e-7)
    assert np.abs(nearest_rotation(A + 1e-9) - A).max() < 1e-8


@given(VECTORS)
def test_quaternions_are_wxyz_and_agree_with_scipy(rotvec):
    R = rotation_from_rotvec(rotvec)
    x, y, z, w = Rotation.from_matrix(R).as_quat(canonical=True)
    ours = quat_wxyz_from_rotation(R)
    assert np.abs(np.outer(ours, ours) - np.outer([w, x, y, z], [w, x, y, z])).max() < 1e-9
    assert np.abs(rotation_from_quat_wxyz(ours) - R).max() < 1e-9


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("fx_px = 528.0", "fx_px = -1.0", "camera.fx_px = -1.0"),
        ("q_min_deg = -25.0", "q_min_deg = 85.0", "joint 'lift': q_min_deg = 85.0"),
        ("id = 1\n", "id = 2\n", "ids"),
        ("baseline_m = 0.12", "baseline = 0.12", "camera.baseline"),
        ('name = "hiab033"', "name = ", "not TOML"),
        ("T_flange_tcp = [1.0", "T_flange_tcp = [2.0", "T_flange_tcp is not a pose"),
    ],
)
def test_a_wrong_machine_file_names_the_field_and_its_value(old, new, expected):
    with pytest.raises(MachineFileError, match=expected.replace("[", r"\[").replace("(", r"\(")):
        parse_machine_toml(TEXT.replace(old, new, 1))
