"""First-order effects of a camera calibrated a little wrong, against the whole non-linear computation."""

from dataclasses import replace

import numpy as np
import pytest
from joint_scenes import machine

from machine.camera import project
from machine.markers import marker_corners
from machine.poses import pose, transform_points
from machine.rotations import rotation_from_rotvec
from machine.targets import Board
from server.calibration.joint_lens import (
    LENS_DERIVATIVE_STEPS,
    LENS_PARAMETER_NAMES,
    LensPrior,
    common_covariance,
    eyes_off,
    layout_covariance,
    look_sensitivity,
    odometry_sensitivity,
)
from server.calibration.nuisances import (
    FOCAL_LENGTH,
    LENS,
    OOI_SIDE,
    REMEDIES,
    contributions_by_group,
    largest_in_words,
    lens_groups,
)
from server.vision.goal_error import pose_error

FACING = rotation_from_rotvec(np.array([np.pi, 0.0, 0.0]))
T_CAM_TOOL = pose(FACING @ rotation_from_rotvec(np.array([0.3, 0.1, 0.0])), np.array([0.02, 0.1, 0.5]))
T_CAM_OOI = pose(FACING @ rotation_from_rotvec(np.array([0.05, -0.08, 0.02])), np.array([-0.05, 0.02, 1.2]))
OFF = np.array([0.0015, 1.0, -1.0, 0.002, 0.1, 7e-4, 7e-4])


def corners_of(on, grown=0.0):
    markers = machine().markers_on(on)
    return np.vstack([transform_points(m.T_on_marker, marker_corners(m.side_m * (1.0 + grown))) for m in markers])


def pixels(eyes, points):
    shift = np.array([eyes[0].baseline_m, 0.0, 0.0])
    return np.concatenate([project(eyes[0], points), project(eyes[1], points - shift)], axis=1)


def least_squares_pose(corners, seen, T_start):
    """Gauss-Newton with numerical derivatives over rotation vector (left) and position."""
    camera = machine().camera
    T = T_start
    for _ in range(8):

        def residual(x, T=T):
            moved = pose(rotation_from_rotvec(x[:3]) @ T[:3, :3], T[:3, 3] + x[3:])
            return (pixels((camera, camera), transform_points(moved, corners)) - seen).ravel()

        r = residual(np.zeros(6))
        J = np.column_stack([(residual(1e-6 * one) - r) / 1e-6 for one in np.eye(6)])
        x = -np.linalg.lstsq(J, r, rcond=None)[0]
        T = pose(rotation_from_rotvec(x[:3]) @ T[:3, :3], T[:3, 3] + x[3:])
    return T


@pytest.mark.parametrize("number", range(7), ids=LENS_PARAMETER_NAMES)
@pytest.mark.parametrize(("on", "rows"), [("tool", slice(0, 6)), ("ooi", slice(6, 12))])
def test_a_look_moves_as_the_sensitivity_says(number, on, rows):
    T_true = T_CAM_TOOL if on == "tool" else T_CAM_OOI
    off = OFF[number] * np.eye(7)[number]
    corners, grown = corners_of(on), corners_of(on, off[5] if on == "tool" else off[6])
    seen = pixels(eyes_off(machine().camera, off), transform_points(T_true, grown))
    measured = least_squares_pose(corners, seen, T_true)
    moved = np.concatenate([_rotvec(measured[:3, :3] @ T_true[:3, :3].T), measured[:3, 3] - T_true[:3, 3]])
    told = look_sensitivity(machine(), T_CAM_TOOL, T_CAM_OOI)[rows] @ off
    assert np.allclose(told, moved, atol=0.03 * np.abs(moved).max() + 1e-7)


def test_disparity_scales_the_way_odometry_measures_and_the_principal_point_shears_it():
    bending = odometry_sensitivity(machine().camera, T_CAM_OOI)
    camera = machine().camera
    disparity = 0.1 * bending[4]
    expected = 0.1 * T_CAM_OOI[2, 3] / (camera.fx_px * camera.baseline_m)
    assert np.allclose(np.abs(np.diag(disparity)), expected, rtol=0.35)
    shear = bending[1]
    assert abs(shear[0, 2]) == pytest.approx(1.0 / camera.fx_px, rel=0.3), "a px sideways per way towards the wall"
    assert abs(shear[1, 1]) < 0.2 * abs(shear[0, 2])
    assert np.all(bending[5:] == 0.0), "odometry does not see the prints"


def test_layout_alone_shifts_the_ooi_by_the_mean_of_its_markers():
    prior = LensPrior(sigma_side_frac=0.0, sigma_layout_rad=0.0)
    C = layout_covariance(machine(), T_CAM_OOI, prior)
    n = len(machine().markers_on("ooi"))
    assert np.sqrt(np.diag(C)[3:5]) == pytest.approx([prior.sigma_layout_m / np.sqrt(n)] * 2, rel=0.35)
    assert np.linalg.eigvalsh(C).min() > -1e-15


def test_a_board_hangs_and_is_printed_no_better_than_a_marker():
    prior = LensPrior()
    board = Board("charuco", "ooi", 7, 5, 0.06, 0.045, 20, False, np.eye(4))
    described = replace(machine(), boards=(board,), markers=machine().markers_on("tool"))
    sigmas = np.sqrt(np.diag(layout_covariance(described, T_CAM_OOI, prior)))
    assert (sigmas[:3] > 0.9 * prior.sigma_layout_rad).all()
    assert (sigmas[3:] > 0.9 * prior.sigma_layout_m).all()


def test_the_prior_has_one_sigma_for_each_unknown():
    assert len(LensPrior().sigma) == len(LENS_PARAMETER_NAMES) == len(LENS_DERIVATIVE_STEPS)
    assert (LensPrior().sigma > 0.0).all()


def _rotvec(R):
    return 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])


def test_what_moves_tool_and_ooi_alike_cancels_in_the_error_and_the_way_between_them_does_not():
    tool_at = T_CAM_OOI @ pose(np.eye(3), np.array([0.0, 0.0, 0.1]))
    sigmas = {}
    for name, T_cam_tool in (("near", tool_at), ("far", T_CAM_TOOL)):
        lens = np.zeros((7, 7))
        lens[0, 0] = 0.01**2  # focal length alone
        exact = LensPrior(sigma_layout_m=0.0, sigma_layout_rad=0.0, sigma_side_frac=0.0)
        common = common_covariance(machine(), T_cam_tool, T_CAM_OOI, exact, lens)
        error = pose_error(T_cam_tool, T_CAM_OOI, np.eye(4), np.zeros((6, 6)), np.zeros((6, 6)), common)
        sigmas[name] = error.sigma_position_m
    assert sigmas["near"][2] == pytest.approx(0.01 * 0.1, rel=0.15), "1 % of the 0.1 m between them"
    assert sigmas["far"][2] == pytest.approx(0.01 * 0.7, rel=0.25), "1 % of the 0.7 m of depth between them"


@pytest.mark.parametrize("unknown", [5, 6])
def test_a_print_too_large_widens_the_depth_of_its_own_object(unknown):
    S = look_sensitivity(machine(), T_CAM_TOOL, T_CAM_OOI)[:, unknown]
    own, other = (S[3:6], S[9:12]) if unknown == 5 else (S[9:12], S[3:6])
    assert np.abs(own).max() > 0.1 * (T_CAM_TOOL if unknown == 5 else T_CAM_OOI)[2, 3]
    assert np.all(other == 0.0)


def test_contributions_name_the_source_whose_knowledge_would_help_most():
    J, covariance = np.array([[2.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]), np.diag([1e-6, 1e-6, 1e-8])
    covariance[0, 1] = covariance[1, 0] = 0.5e-6
    found = contributions_by_group(J, covariance, {FOCAL_LENGTH: [0], OOI_SIDE: [1], LENS: [2]})
    total = J @ covariance @ J.T
    left = covariance[1, 1] - covariance[0, 1] ** 2 / covariance[0, 0]  # of the second unknown, the first one known
    assert found[0].variance[0] == pytest.approx(total[0, 0] - left)
    assert FOCAL_LENGTH in largest_in_words(found, 0)
    assert LENS in largest_in_words(found, 1)
    assert all(REMEDIES[name] for name in lens_groups())
