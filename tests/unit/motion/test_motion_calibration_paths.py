"""Calibration paths: closed, inside view, wall and limits; mirrored or shrunk before they are refused."""

from dataclasses import replace

import numpy as np
import pytest
from motion_scenes import Q_USUAL, chain, machine, ooi_ahead, posture, shifted, wall_of
from test_motion_point_to_point import assert_obeys_limits

from machine.kinematics import tcp_pose, tcp_poses
from machine.rotations import geodesic_angle
from machine.targets import Board
from server.motion.calibration_paths import (
    DEFAULT_PATH_SETTINGS,
    folded_corners,
    markers_in_view,
    paper_corners,
    plan_calibration_path,
)
from server.motion.contracts import PlanStatus, sample_trajectory
from server.motion.settings import MotionInputError


def test_folded_corners_are_a_metre_closed_folded_and_never_towards_the_wall():
    corners = np.vstack((np.zeros(3), folded_corners()))
    steps = np.diff(corners, axis=0)
    assert np.linalg.norm(steps, axis=1).sum() == pytest.approx(1.0, abs=0.05)  # m
    assert (corners[:, 2] >= 0.0).all()
    assert corners[:, 2].max() == pytest.approx(0.10)
    np.testing.assert_array_equal(corners[-1], 0.0)
    directions = steps / np.linalg.norm(steps, axis=1)[:, None]
    information = np.eye(3) * 6 - directions.T @ directions
    values = np.linalg.eigvalsh(information)
    assert values[0] / values[2] > 0.5  # every axis known about as well


def test_paper_corners_follow_eq_17_to_19():
    corners = paper_corners(replace(DEFAULT_PATH_SETTINGS, paper_return=False))
    steps = np.diff(np.vstack((np.zeros(3), corners)), axis=0)
    angles = np.rad2deg(np.arctan2(steps[:, 1], steps[:, 0]))
    np.testing.assert_allclose(angles, [0, 45, 0, 45, 0, 45], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), DEFAULT_PATH_SETTINGS.paper_lengths_m)
    assert (corners[:, 2] == 0.0).all()


@pytest.mark.parametrize("kind", ["folded", "paper"])
@pytest.mark.parametrize("seed", range(4))
def test_paths_return_hold_the_orientation_and_keep_every_bound(kind, seed):
    q = posture(seed)
    rng = np.random.default_rng(seed)
    ooi = ooi_ahead(q, rng.uniform(0.6, 0.9), *rng.uniform(-0.1, 0.1, size=2))
    plan = plan_calibration_path(machine(), q, kind, wall=wall_of(ooi), T_base_ooi_estimate=ooi)
    assert plan.status is PlanStatus.OK, plan.reason
    assert plan.trajectory is not None
    np.testing.assert_allclose(plan.trajectory.q[-1], q, atol=1e-9)
    assert_obeys_limits(plan.trajectory, 1.3)
    assert plan.tcp_speed_max_m_s <= 0.15
    assert plan.duration_s < 20.0
    T = tcp_pose(chain(), q)
    assert max(geodesic_angle(T[:3, :3], each[:3, :3]) for each in plan.Ts_base_tcp) < 1e-9
    assert np.linalg.norm(plan.Ts_base_tcp[:, :3, 3] - ooi[:3, 3], axis=1).min() >= 0.25  # m
    seen = markers_in_view(machine(), plan.Ts_base_tcp, ooi, machine().T_tcp_cam_left[:3, :3], 5.0)
    assert seen.min() >= 1


def test_folded_path_moves_away_from_the_wall_only():
    ooi = ooi_ahead(Q_USUAL, 0.6)
    plan = plan_calibration_path(machine(), Q_USUAL, wall=wall_of(ooi), T_base_ooi_estimate=ooi)
    assert plan.trajectory is not None
    assert plan.clearance_m == pytest.approx(0.66, abs=1e-3)  # that of its start
    _, motion = sample_trajectory(plan.trajectory, 0.05)
    tips = tcp_poses(chain(), motion.q)[:, :3, 3]
    assert (tips @ ooi[:3, 2]).min() >= tips[0] @ ooi[:3, 2] - 0.01


def test_ooi_near_the_images_rim_mirrors_or_shrinks_the_path():
    """All three markers must stay in view: the full path would lose one, a mirrored or smaller one does not."""
    ooi = ooi_ahead(Q_USUAL, 0.35, up_m=-0.18, left_m=-0.3)
    strict = replace(DEFAULT_PATH_SETTINGS, markers_min=3)
    R_tcp_cam = machine().T_tcp_cam_left[:3, :3]
    full = plan_calibration_path(machine(), Q_USUAL)
    assert markers_in_view(machine(), full.Ts_base_tcp, ooi, R_tcp_cam, strict.view_margin_px)[0] == 3
    assert markers_in_view(machine(), full.Ts_base_tcp, ooi, R_tcp_cam, strict.view_margin_px).min() < 3
    plan = plan_calibration_path(machine(), Q_USUAL, T_base_ooi_estimate=ooi, path=strict)
    assert plan.status is PlanStatus.OK, plan.reason
    assert markers_in_view(machine(), plan.Ts_base_tcp, ooi, R_tcp_cam, 5.0).min() == 3
    assert plan.length_m < 0.9 * full.length_m  # m


@pytest.mark.parametrize("target", ["markers", "chess board"])
def test_view_that_cannot_be_kept_is_refused(target):
    ooi = ooi_ahead(Q_USUAL, 0.6)
    greedy = replace(DEFAULT_PATH_SETTINGS, scales=(8.0,))
    board = Board("charuco", "ooi", 5, 4, 0.05, 0.0375, 20, False, np.eye(4))
    described = machine()
    if target == "chess board":
        described = replace(described, boards=(board,), markers=described.markers_on("tool"))
    start = tcp_pose(chain(), Q_USUAL)[None]
    assert markers_in_view(described, start, ooi, described.T_tcp_cam_left[:3, :3], 5.0)[0] >= 1
    turned = ooi.copy()
    turned[:3, 1:3] *= -1.0
    assert markers_in_view(described, start, turned, described.T_tcp_cam_left[:3, :3], 5.0)[0] == 0
    plan = plan_calibration_path(described, Q_USUAL, T_base_ooi_estimate=ooi, path=greedy)
    assert plan.status is PlanStatus.OUT_OF_VIEW
    assert "at least 1" in plan.reason


def test_nearness_to_the_ooi_is_refused_with_the_distance():
    ooi = ooi_ahead(Q_USUAL, 0.15)
    plan = plan_calibration_path(machine(), Q_USUAL, T_base_ooi_estimate=ooi)
    assert plan.status is PlanStatus.WALL
    assert "150 mm from the target" in plan.reason
    assert "limit 250 mm; retract first" in plan.reason
    assert plan.trajectory is None


def test_posture_with_no_room_is_refused_with_a_reason():
    q = np.deg2rad([0.0, 40.0, -70.0, 0.0, -9.0, 0.0])
    plan = plan_calibration_path(machine(), q)
    assert plan.status is PlanStatus.SINGULAR
    assert "wrist2" in plan.reason
    assert "45 %" in plan.reason


def test_unknown_kind_is_a_broken_contract():
    with pytest.raises(MotionInputError, match="spiral"):
        plan_calibration_path(machine(), Q_USUAL, "spiral")  # pyright: ignore[reportArgumentType]


def test_shifted_is_what_it_says():
    moved = shifted(Q_USUAL, [0.1, 0.0, 0.0])[:3, 3] - tcp_pose(chain(), Q_USUAL)[:3, 3]
    assert np.linalg.norm(moved) == pytest.approx(0.1)
