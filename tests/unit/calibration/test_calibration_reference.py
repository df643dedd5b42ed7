"""From a look to a reference: exact in an ideal world, about the tool marker, and with an honest prediction."""

import numpy as np
import pytest

from machine.poses import inverse_pose, pose
from machine.rotations import geodesic_angle, rotation_about, rotation_from_rotvec
from server.calibration.reference import (
    position_reference_paper,
    predicted_error_covariance,
    reference_from_look,
)

T_TCP_TOOL = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0.03], [0, 0, 0, 1]])
T_TCP_CAM = np.array([[0.0, -1, 0, 0.18], [-1, 0, 0, 0.06], [0, 0, -1, 0.5], [0, 0, 0, 1.0]])
T_OOI_GOAL = pose(np.eye(3), np.array([0.0, 0.0, 0.1]))


def scene(seed: int, turn_deg: float = 8.0, T_tcp_cam: np.ndarray = T_TCP_CAM, T_tcp_tool: np.ndarray = T_TCP_TOOL):
    rng = np.random.default_rng(seed)
    T_base_tcp = pose(rotation_from_rotvec(rng.normal(size=3)), np.array([3.0, 0.4, 1.5]))
    T_base_tool = T_base_tcp @ T_tcp_tool
    turn = rotation_from_rotvec(np.deg2rad(turn_deg) * rng.normal(size=3) / np.sqrt(3.0))
    T_base_ooi = T_base_tool @ pose(turn, np.array([0.1, -0.05, -0.6]))
    T_cam_base = inverse_pose(T_base_tcp @ T_tcp_cam)
    return T_base_tcp, T_base_ooi, T_cam_base @ T_base_tool, T_cam_base @ T_base_ooi


def test_one_step_is_exact_when_the_calibration_is():
    tilted = T_TCP_CAM @ pose(rotation_about("x", np.deg2rad(5.0)), np.array([0.01, -0.02, 0.005]))
    for seed in range(10):
        T_base_tcp, T_base_ooi, T_cam_tool, T_cam_ooi = scene(seed, T_tcp_cam=tilted)
        goal = reference_from_look(T_base_tcp, tilted[:3, :3], T_TCP_TOOL, T_cam_tool, T_cam_ooi, T_OOI_GOAL)
        T_ooi_tool = inverse_pose(T_base_ooi) @ goal @ T_TCP_TOOL
        np.testing.assert_allclose(T_ooi_tool, T_OOI_GOAL, atol=1e-9)


def goal_error(T_cam_tool, T_cam_ooi, T_ooi_goal):
    """Tool minus goal as seen: position in OOI axes (3,) [m], and the geodesic angle [rad]."""
    T_ooi_tool = inverse_pose(T_cam_ooi) @ T_cam_tool
    return T_ooi_tool[:3, 3] - T_ooi_goal[:3, 3], geodesic_angle(T_ooi_goal[:3, :3], T_ooi_tool[:3, :3])


def test_commanded_pose_may_differ_from_the_true_one():
    """A constant offset between commanded and true pose (sag, zero errors) cancels, since the goal is a step."""
    T_base_tcp, T_base_ooi, T_cam_tool, T_cam_ooi = scene(3, turn_deg=0.0)
    T_offset = pose(np.eye(3), np.array([0.02, -0.01, 0.03]))
    commanded = T_offset @ T_base_tcp
    goal = reference_from_look(commanded, T_TCP_CAM[:3, :3], T_TCP_TOOL, T_cam_tool, T_cam_ooi, T_OOI_GOAL)
    reached = inverse_pose(T_offset) @ goal
    error_m, angle = goal_error(*_look(reached, T_base_ooi), T_OOI_GOAL)
    assert 1e3 * np.abs(error_m).max() < 1e-6
    assert angle < 1e-9


def _look(T_base_tcp, T_base_ooi):
    T_cam_base = inverse_pose(T_base_tcp @ T_TCP_CAM)
    return T_cam_base @ T_base_tcp @ T_TCP_TOOL, T_cam_base @ T_base_ooi


def test_a_pure_turn_keeps_the_tool_marker_where_it_is():
    T_base_tcp, T_base_ooi, T_cam_tool, T_cam_ooi = scene(5)
    p_ooi_tool = (inverse_pose(T_cam_ooi) @ T_cam_tool)[:3, 3]
    here = pose(np.eye(3), p_ooi_tool)  # the goal is where the marker is: only the orientation is wrong
    goal = reference_from_look(T_base_tcp, T_TCP_CAM[:3, :3], T_TCP_TOOL, T_cam_tool, T_cam_ooi, here)
    moved = (goal @ T_TCP_TOOL)[:3, 3] - (T_base_tcp @ T_TCP_TOOL)[:3, 3]
    assert 1e3 * np.linalg.norm(moved) < 1e-6
    assert geodesic_angle((goal @ T_TCP_TOOL)[:3, :3], T_base_ooi[:3, :3]) < 1e-9


def test_paper_form_with_the_true_rotation_is_exact_and_with_a_tilt_shows_table_4():
    T_base_tcp, T_base_ooi, T_cam_tool, T_cam_ooi = scene(7, turn_deg=0.0)
    R_base_cam = T_base_tcp[:3, :3] @ T_TCP_CAM[:3, :3]
    ref = position_reference_paper(T_base_tcp, R_base_cam, T_cam_tool[:3, 3], T_cam_ooi[:3, 3], 0.1)
    assert 1e3 * np.abs(goal_error(*_look(ref, T_base_ooi), T_OOI_GOAL)[0]).max() < 1e-6
    wrong = R_base_cam @ rotation_about("x", np.deg2rad(5.0))
    tilted = position_reference_paper(T_base_tcp, wrong, T_cam_tool[:3, 3], T_cam_ooi[:3, 3], 0.1)
    error_mm = 1e3 * goal_error(*_look(tilted, T_base_ooi), T_OOI_GOAL)[0]
    assert abs(error_mm[1]) == pytest.approx(1e3 * 0.5 * np.sin(np.deg2rad(5.0)), abs=5.0)  # 5 deg over 0.5 m
    np.testing.assert_array_equal(ref[:3, :3], T_base_tcp[:3, :3])


def test_prediction_covers_what_monte_carlo_finds():
    T_base_tcp, T_base_ooi, T_cam_tool, T_cam_ooi = scene(9)
    rng = np.random.default_rng(0)
    C_rot = np.diag(np.deg2rad([0.8, 0.4, 0.5]) ** 2)
    C_tool = np.diag([1e-6, 1e-6, 1e-6, 1e-8, 1e-8, 25e-8])
    C_ooi = np.diag([4e-6, 4e-6, 1e-6, 4e-8, 4e-8, 1e-6])
    errors = []
    for _ in range(1500):
        R = rotation_from_rotvec(rng.multivariate_normal(np.zeros(3), C_rot)) @ T_TCP_CAM[:3, :3]
        looks = [_disturbed(T, C, rng) for T, C in ((T_cam_tool, C_tool), (T_cam_ooi, C_ooi))]
        goal = reference_from_look(T_base_tcp, R, T_TCP_TOOL, looks[0], looks[1], T_OOI_GOAL)
        errors.append((inverse_pose(T_base_ooi) @ goal @ T_TCP_TOOL)[:3, 3] - T_OOI_GOAL[:3, 3])
    predicted = predicted_error_covariance(
        C_rot,
        T_TCP_CAM[:3, :3],
        T_cam_tool,
        T_cam_ooi,
        T_OOI_GOAL,
        C_tool,
        C_ooi,
        sigma_stretch_frac=0.0,
        sigma_floor_m=0.0,
    )
    found = np.cov(np.array(errors).T)
    np.testing.assert_allclose(np.sqrt(np.diag(found)), np.sqrt(np.diag(predicted)), rtol=0.08)
    with_floor = predicted_error_covariance(C_rot, T_TCP_CAM[:3, :3], T_cam_tool, T_cam_ooi, T_OOI_GOAL, C_tool, C_ooi)
    assert (np.diag(with_floor) > np.diag(predicted)).all()


def _disturbed(T, covariance, rng):
    noise = rng.multivariate_normal(np.zeros(6), covariance)
    return pose(rotation_from_rotvec(noise[:3]) @ T[:3, :3], T[:3, 3] + noise[3:])
