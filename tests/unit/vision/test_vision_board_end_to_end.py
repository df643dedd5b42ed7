"""A ChArUco board as the OOI, from a ray-cast stereo pair through the pose source to a pose with its covariance."""

from dataclasses import replace

import numpy as np
import pytest
from vision_prints import photographed, printed
from vision_scenes import deviation, facing_pose, machine

from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from machine.targets import Board
from server.vision.aruco_source import ArucoPoseSource
from server.vision.contracts import PoseStatus

CHI2_999_OF_6 = 22.5
T_OOI_BOARD = pose(rotation_from_rotvec(np.array([0.0, 0.2, 0.0])), np.array([0.0, 0.02, 0.01]))
BOARD = Board("charuco", "ooi", 7, 5, 0.06, 0.045, 20, False, T_OOI_BOARD)


@pytest.mark.parametrize(("distance_m", "tilt_deg"), [(0.6, 25.0), (1.2, 10.0)])
def test_board_gives_the_pose_of_the_ooi(distance_m, tilt_deg):
    described = replace(machine(), boards=(BOARD,), markers=machine().markers_on("tool"))
    T_cam_ooi = facing_pose(distance_m, tilt_deg, 30.0)
    left, right = photographed(printed(described.dictionary, BOARD), T_cam_ooi, np.random.default_rng(5))

    seen = ArucoPoseSource(described).observe(left, right, 1)

    assert seen.ooi.status is PoseStatus.OK, seen.ooi.reason
    assert seen.tool.status is PoseStatus.NOT_SEEN
    error = deviation(seen.ooi.T_cam_object, T_cam_ooi)
    assert np.linalg.norm(error[3:]) < 0.5e-3, "m"
    assert error @ np.linalg.solve(seen.ooi.covariance, error) < CHI2_999_OF_6


def test_covered_half_of_a_board_still_gives_the_pose():
    described = replace(machine(), boards=(BOARD,), markers=machine().markers_on("tool"))
    T_cam_ooi = facing_pose(0.7, 20.0, 0.0)
    left, right = photographed(printed(described.dictionary, BOARD), T_cam_ooi, np.random.default_rng(6))
    for image in (left, right):
        image[: image.shape[0] // 2] = 90

    seen = ArucoPoseSource(described).observe(left, right, 1)

    assert seen.ooi.status is PoseStatus.OK, seen.ooi.reason
    assert np.linalg.norm(deviation(seen.ooi.T_cam_object, T_cam_ooi)[3:]) < 1e-3, "m"
