"""What a look's corners say of lens and prints beyond the poses: exact corners by a known truth, and noise."""

import numpy as np
import pytest
from joint_scenes import machine

from machine.camera import project
from machine.markers import marker_corners
from machine.poses import pose, transform_points
from machine.rotations import rotation_from_rotvec
from server.calibration.joint_lens import FOCAL, OOI_PRINT, TOOL_PRINT, LensPrior, eyes_off
from server.calibration.lens_evidence import SIGMA_CORNER_PX, lens_doubts, lens_evidence, mean_evidence
from server.vision.object_pose import PoseSettings, estimate_object_pose
from server.vision.pose_problem import Sighting

FACING = rotation_from_rotvec(np.array([np.pi, 0.0, 0.0]))
T_CAM_TOOL = pose(FACING @ rotation_from_rotvec(np.array([0.2, 0.1, 0.0])), np.array([0.05, 0.18, 0.47]))
T_CAM_OOI = pose(FACING @ rotation_from_rotvec(np.array([0.05, -0.08, 0.02])), np.array([0.05, 0.1, 1.1]))


def seen_by(lens, T_cam_tool, T_cam_ooi, rng):
    """Corners by marker in each eye, and the poses that the product finds in them by the camera file."""
    eyes, corners, poses = eyes_off(machine().camera, lens), {}, []
    shift = np.array([eyes[0].baseline_m, 0.0, 0.0])
    for on, T, printed in (("tool", T_cam_tool, TOOL_PRINT), ("ooi", T_cam_ooi, OOI_PRINT)):
        for marker in machine().markers_on(on):
            on_object = transform_points(marker.T_on_marker, marker_corners(marker.side_m * (1.0 + lens[printed])))
            points = transform_points(T, on_object)
            both = project(eyes[0], points), project(eyes[1], points - shift)
            corners[marker.marker_id] = tuple(px + rng.normal(0.0, 0.5 * SIGMA_CORNER_PX, (4, 2)) for px in both)
        sightings = [Sighting(m, *corners[m.marker_id]) for m in machine().markers_on(on)]
        poses.append(estimate_object_pose(on, sightings, machine().camera, PoseSettings())[0].T_cam_object)
    return corners, poses


def estimated(lens, seed, T_cam_tool=T_CAM_TOOL, T_cam_ooi=T_CAM_OOI):
    """Mean and covariance of the lens unknowns by one look alone."""
    corners, poses = seen_by(np.array(lens), T_cam_tool, T_cam_ooi, np.random.default_rng(seed))
    found = lens_evidence(machine(), *poses, corners, LensPrior())
    covariance = np.linalg.inv(found.information + np.diag(LensPrior().sigma ** -2.0))
    return covariance @ found.information_vector, covariance


@pytest.mark.parametrize("unknown", [TOOL_PRINT, OOI_PRINT])
def test_stereo_contradicts_a_print_that_is_one_per_cent_too_large(unknown):
    for seed in range(5):
        mean, covariance = estimated(0.01 * np.eye(7)[unknown], seed)
        word = "tool marker print" if unknown == TOOL_PRINT else "OOI marker print"
        doubts = lens_doubts(mean, covariance, LensPrior())
        assert len(doubts) == 1, doubts
        assert word in doubts[0]
        assert "measure the printed side" in doubts[0]


def test_nothing_is_said_against_a_camera_and_prints_that_are_right():
    for seed in range(40):
        assert lens_doubts(*estimated(np.zeros(7), seed), LensPrior()) == []


def test_a_tilted_marker_shows_the_focal_length_by_its_perspective_and_a_frontal_one_does_not():
    tilted = pose(FACING @ rotation_from_rotvec(np.array([0.9, 0.3, 0.0])), T_CAM_TOOL[:3, 3])
    sigmas = {}
    for name, T_cam_tool in (("frontal", T_CAM_TOOL), ("tilted", tilted)):
        mean, covariance = estimated(0.05 * np.eye(7)[FOCAL], 1, T_cam_tool)
        sigmas[name] = np.sqrt(covariance[FOCAL, FOCAL])
        assert abs(mean[FOCAL] - 0.05) < 4.0 * sigmas[name] + 0.02, "the prior of 1 % pulls"
    assert sigmas["tilted"] < 0.75 * sigmas["frontal"]
    assert "camera focal length" in "".join(lens_doubts(mean, covariance, LensPrior()))


def test_looks_at_the_same_corners_count_once():
    corners, poses = seen_by(np.zeros(7), T_CAM_TOOL, T_CAM_OOI, np.random.default_rng(0))
    one = lens_evidence(machine(), *poses, corners, LensPrior())
    assert mean_evidence([one, one, one]).information == pytest.approx(one.information)
    assert np.all(mean_evidence([]).information == 0.0)


def test_an_eye_that_sees_no_marker_leaves_evidence_without_stereo():
    corners, poses = seen_by(np.zeros(7), T_CAM_TOOL, T_CAM_OOI, np.random.default_rng(0))
    both = lens_evidence(machine(), *poses, corners, LensPrior()).information[TOOL_PRINT, TOOL_PRINT]
    left_only = {number: (left, None) for number, (left, _) in corners.items()}
    left = lens_evidence(machine(), *poses, left_only, LensPrior()).information[TOOL_PRINT, TOOL_PRINT]
    assert left < 0.01 * both
