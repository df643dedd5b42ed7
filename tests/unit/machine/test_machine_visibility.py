"""Markers' corners, and what each eye can see."""

import numpy as np
import pytest
from machine_cases import MACHINE

from machine.camera import project
from machine.errors import MachineError
from machine.markers import marker_corners, object_corners
from machine.poses import inverse_pose, pose
from machine.rotations import rotation_about
from machine.visibility import in_both_eyes, in_eye, marker_in_view, object_in_view

CAMERA = MACHINE.camera
FACING = rotation_about("x", np.pi)  # an object whose z axis points at the camera
PLATE = marker_corners(0.15)


def at(x, y, z, R=FACING):
    return pose(R, np.array([x, y, z]))


def test_corners_are_in_opencv_order():
    assert marker_corners(0.2).tolist() == [[-0.1, 0.1, 0], [0.1, 0.1, 0], [0.1, -0.1, 0], [-0.1, -0.1, 0]]
    with pytest.raises(MachineError, match="above 0 m"):
        marker_corners(0.0)


def test_object_corners_are_in_the_objects_frame():
    corners = object_corners(MACHINE.markers_on("ooi"))
    assert sorted(corners) == [1, 2, 3]
    for marker in MACHINE.markers_on("ooi"):
        square = corners[marker.marker_id]
        sides = np.linalg.norm(np.roll(square, -1, axis=0) - square, axis=1)
        assert sides == pytest.approx([0.15] * 4, abs=1e-9)  # m
        assert square.mean(axis=0) == pytest.approx(marker.T_on_marker[:3, 3], abs=1e-9)
        assert (square[1] - square[0]) / 0.15 == pytest.approx(marker.T_on_marker[:3, 0], abs=1e-9)


def test_a_marker_seen_upright_has_its_first_corner_top_left_in_the_image():
    px = project(CAMERA, PLATE @ FACING.T + [0.0, 0.0, 1.0])
    top_left, top_right, bottom_right, bottom_left = px
    assert top_left[0] < top_right[0]
    assert top_left[1] < bottom_left[1]
    assert bottom_right[0] > bottom_left[0]


def test_each_eye_is_judged_by_its_own_image():
    assert object_in_view(CAMERA, at(0.06, 0.0, 1.0), PLATE, 10.0) == (True, True)
    half_width = 639.5 / 528.0  # of the image at 1 m, before distortion makes it wider
    edge_left = object_in_view(CAMERA, at(-half_width + 0.02, 0.0, 1.0), PLATE, 0.0)
    edge_right = object_in_view(CAMERA, at(half_width + 0.12, 0.0, 1.0), PLATE, 0.0)
    assert edge_left == (True, False)
    assert edge_right == (False, True)


def test_behind_too_near_and_empty():
    assert object_in_view(CAMERA, at(0.0, 0.0, -1.0), PLATE, 0.0) == (False, False)
    assert not in_eye(CAMERA, np.array([[0.0, 0.0, 0.04]]), 0.0)
    assert not in_eye(CAMERA, np.array([[0.0, 0.0, np.nan]]), 0.0)
    with pytest.raises(MachineError, match="at least one"):
        in_eye(CAMERA, np.empty((0, 3)), 0.0)


def test_the_margin_is_swept_past_both_sides():
    px = project(CAMERA, np.array([[0.5, 0.2, 1.0]]))[0]
    nearest = min(*px, CAMERA.width_px - 1 - px[0], CAMERA.height_px - 1 - px[1])
    assert in_eye(CAMERA, np.array([[0.5, 0.2, 1.0]]), nearest - 0.01)
    assert not in_eye(CAMERA, np.array([[0.5, 0.2, 1.0]]), nearest + 0.01)


def test_a_point_that_the_lens_model_folds_into_the_image_is_outside():
    folded = np.array([[2.35, 0.0, 1.0]])  # 67 deg off the axis
    px = project(CAMERA, folded)[0]
    assert 0.0 < px[0] < CAMERA.width_px - 1
    assert not in_eye(CAMERA, folded, 0.0)


@pytest.mark.parametrize(("tilt_deg", "seen"), [(0.0, True), (70.0, True), (77.0, True), (80.0, False), (180.0, False)])
def test_front_facing_ends_at_78_degrees(tilt_deg, seen):
    R = FACING @ rotation_about("x", np.deg2rad(tilt_deg))
    assert object_in_view(CAMERA, at(0.0, 0.0, 1.0, R), PLATE, 10.0)[0] is seen


def test_all_markers_are_in_view_of_the_nominal_camera_at_the_goal_and_at_the_start():
    for b_m in (0.1, 0.6, 0.9):
        T_ooi_tool = pose(np.eye(3), np.array([0.0, 0.0, b_m]))
        T_cam_tool = inverse_pose(MACHINE.T_tcp_cam_left) @ MACHINE.T_tcp_tool
        T_cam_ooi = T_cam_tool @ inverse_pose(T_ooi_tool)
        assert all(marker_in_view(CAMERA, T_cam_ooi, marker, 10.0) for marker in MACHINE.markers_on("ooi"))
        assert all(marker_in_view(CAMERA, T_cam_tool, marker, 10.0) for marker in MACHINE.markers_on("tool"))
        turned = T_cam_ooi @ pose(rotation_about("x", np.pi), np.zeros(3))
        assert not any(marker_in_view(CAMERA, turned, marker, 10.0) for marker in MACHINE.markers_on("ooi"))


def test_both_eyes_is_the_left_and_the_right():
    points = np.array([[0.06, 0.0, 1.0]])
    assert in_both_eyes(CAMERA, points, 0.0)
    assert not in_both_eyes(CAMERA, points - [1.3, 0.0, 0.0], 0.0)
