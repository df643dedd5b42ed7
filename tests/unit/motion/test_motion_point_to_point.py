"""Point-to-point plans: they reach, obey every limit between the knots, keep off the wall, and say why they refuse."""

from dataclasses import replace

import numpy as np
import pytest
from motion_scenes import Q_USUAL, chain, machine, ooi_ahead, posture, shifted, wall_of

from machine.kinematics import tcp_pose, tcp_poses
from machine.poses import pose
from machine.rotations import geodesic_angle, rotation_from_rotvec
from server.motion.contracts import JointTrajectory, PlanStatus, sample_trajectory
from server.motion.point_to_point import plan_joint_move, plan_move, plan_through
from server.motion.settings import DEFAULT_PLAN_SETTINGS, PAPER_PLAN_SETTINGS, MotionInputError

BOTH = pytest.mark.parametrize("settings", [DEFAULT_PLAN_SETTINGS, PAPER_PLAN_SETTINGS], ids=["shaped", "plain"])


def limits():
    joints = machine().joints
    return (
        np.array([j.qd_max_rad_s for j in joints]),
        np.array([j.qdd_max_rad_s2 for j in joints]),
        np.array([j.q_min_rad for j in joints]),
        np.array([j.q_max_rad for j in joints]),
    )


def assert_obeys_limits(trajectory: JointTrajectory, tcp_share: float):
    qd_max, qdd_max, q_min, q_max = limits()
    t, motion = sample_trajectory(trajectory, 0.003)
    assert (np.abs(motion.qd) <= qd_max).all()
    assert (np.abs(motion.qdd) <= qdd_max).all()
    assert (motion.q >= q_min).all()
    assert (motion.q <= q_max).all()
    points = tcp_poses(chain(), motion.q[::5])[:, :3, 3]
    speed = np.linalg.norm(np.diff(points, axis=0), axis=1) / np.diff(t[::5])
    assert speed.max() <= 1.002 * tcp_share * machine().tcp_speed_max_m_s
    for rates in (trajectory.qd, trajectory.qdd):
        assert np.abs(rates[[0, -1]]).max() == 0.0
    assert np.abs(np.diff(trajectory.t_s) - 0.05).max() < 1e-9


def goal_near(q: np.ndarray, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    T = shifted(q, list(rng.uniform([-0.15, -0.15, -0.3], [0.15, 0.15, 0.1])))
    return pose(rotation_from_rotvec(np.deg2rad(4.0) * rng.normal(size=3)) @ T[:3, :3], T[:3, 3])


@BOTH
@pytest.mark.parametrize("seed", range(8))
def test_plans_reach_and_obey_all_limits_between_the_knots(seed, settings):
    q = posture(seed)
    goal = goal_near(q, seed)
    plan = plan_move(machine(), q, goal, settings)
    assert plan.status is PlanStatus.OK, plan.reason
    assert plan.trajectory is not None
    assert np.abs(plan.trajectory.q[0] - q).max() <= 1e-9
    reached = tcp_pose(chain(), plan.trajectory.q[-1])
    assert 1e3 * np.linalg.norm(reached[:3, 3] - goal[:3, 3]) < 1e-6  # mm
    assert geodesic_angle(reached[:3, :3], goal[:3, :3]) < 1e-9
    assert_obeys_limits(plan.trajectory, 1.3 if settings.shape_reference else 1.0)
    assert plan.tcp_speed_max_m_s <= machine().tcp_speed_max_m_s
    assert plan.duration_s == pytest.approx(plan.trajectory.duration_s)


def test_path_is_a_straight_line_with_an_even_turn():
    goal = goal_near(Q_USUAL, 3)
    plan = plan_move(machine(), Q_USUAL, goal, PAPER_PLAN_SETTINGS)
    assert plan.trajectory is not None
    _, motion = sample_trajectory(plan.trajectory, 0.02)
    points = tcp_poses(chain(), motion.q)[:, :3, 3]
    along = goal[:3, 3] - points[0]
    off = np.linalg.norm(np.cross(points - points[0], along / np.linalg.norm(along)), axis=1)
    assert 1e3 * off.max() < 0.05  # mm
    assert plan.length_m == pytest.approx(np.linalg.norm(along), rel=1e-6)


def test_legs_through_poses_rest_at_each():
    corners = [shifted(Q_USUAL, [0.1, 0.0, 0.0]), shifted(Q_USUAL, [0.1, 0.1, 0.05]), shifted(Q_USUAL, [0.0, 0.0, 0.0])]
    plan = plan_through(machine(), Q_USUAL, corners)
    assert plan.trajectory is not None
    assert_obeys_limits(plan.trajectory, 1.3)
    at_rest = np.flatnonzero(np.abs(plan.trajectory.qd).max(axis=1) == 0.0)
    assert len(at_rest) == 4
    np.testing.assert_allclose(plan.q_end, Q_USUAL, atol=1e-9)


def test_joint_move_ends_on_the_joints_asked_for():
    goal = Q_USUAL + np.deg2rad([5.0, -3.0, 4.0, 10.0, -5.0, 20.0])
    plan = plan_joint_move(machine(), Q_USUAL, goal)
    assert plan.trajectory is not None
    np.testing.assert_allclose(plan.trajectory.q[-1], goal, atol=1e-12)
    assert_obeys_limits(plan.trajectory, 1.3)


def test_staying_is_a_plan_too():
    plan = plan_move(machine(), Q_USUAL, tcp_pose(chain(), Q_USUAL))
    assert plan.status is PlanStatus.OK
    assert plan.length_m < 1e-9


def test_wall_is_respected_and_leaving_it_is_allowed():
    ooi = ooi_ahead(Q_USUAL, 0.5)
    wall = wall_of(ooi, clearance_m=0.1)
    near = plan_move(machine(), Q_USUAL, shifted(Q_USUAL, [0, 0, -0.42]), wall=wall)
    assert near.status is PlanStatus.OK
    assert near.clearance_m == pytest.approx(0.14, abs=1e-6)
    hit = plan_move(machine(), Q_USUAL, shifted(Q_USUAL, [0, 0, -0.50]), wall=wall)
    assert hit.status is PlanStatus.WALL
    assert hit.trajectory is None
    assert "60 mm" in hit.reason
    assert "limit 100 mm" in hit.reason
    tight = replace(wall, clearance_min_m=0.9)
    assert plan_move(machine(), Q_USUAL, shifted(Q_USUAL, [0, 0, 0.1]), wall=tight).status is PlanStatus.OK
    assert plan_move(machine(), Q_USUAL, shifted(Q_USUAL, [0, 0, -0.01]), wall=tight).status is PlanStatus.WALL


def test_wrist_singularity_is_refused_with_its_joint_and_limit():
    q = np.deg2rad([0.0, 40.0, -70.0, 0.0, -14.0, 0.0])
    T = tcp_pose(chain(), q)
    level = pose(rotation_from_rotvec(np.deg2rad(10.0) * T[:3, 1]) @ T[:3, :3], T[:3, 3])
    other = pose(rotation_from_rotvec(np.deg2rad(-10.0) * T[:3, 1]) @ T[:3, :3], T[:3, 3])
    plans = [plan_move(machine(), q, goal) for goal in (level, other)]
    refused = [plan for plan in plans if plan.status is PlanStatus.SINGULAR]
    assert len(refused) == 1
    assert "wrist2" in refused[0].reason
    assert "10.0 deg" in refused[0].reason


def test_out_of_reach_and_joint_limit_name_what_to_do():
    far = plan_move(machine(), Q_USUAL, shifted(Q_USUAL, [0, 0, -3.0]))
    assert far.status is PlanStatus.JOINT_LIMIT  # the boom comes straight before it is too short
    assert "'tilt' would reach" in far.reason
    ahead = pose(np.eye(3), np.array([9.0, 0.0, 1.0]))
    assert plan_move(machine(), Q_USUAL, ahead).status in (PlanStatus.OUT_OF_REACH, PlanStatus.JOINT_LIMIT)
    beyond = Q_USUAL.copy()
    beyond[5] = np.deg2rad(180.0)
    limit = plan_joint_move(machine(), Q_USUAL, beyond)
    assert limit.status is PlanStatus.JOINT_LIMIT
    assert "'wrist3'" in limit.reason
    assert "180.0 deg, limit 169.5 deg" in limit.reason
    start = plan_move(machine(), beyond, tcp_pose(chain(), Q_USUAL))
    assert start.status is PlanStatus.JOINT_LIMIT


def test_limit_met_on_the_way_is_called_a_joint_limit():
    q = np.deg2rad([0.0, 30.0, -90.0, 0.0, -60.0, 165.0])
    T = tcp_pose(chain(), q)
    goals = [pose(rotation_from_rotvec(np.deg2rad(s * 20.0) * T[:3, 2]) @ T[:3, :3], T[:3, 3]) for s in (1.0, -1.0)]
    plans = [plan_move(machine(), q, goal) for goal in goals]
    assert sorted(plan.status.name for plan in plans) == ["JOINT_LIMIT", "OK"]
    assert "'wrist3'" in next(plan.reason for plan in plans if plan.status is PlanStatus.JOINT_LIMIT)


def test_too_slow_a_scale_is_refused():
    crawl = replace(DEFAULT_PLAN_SETTINGS, speed_scale=0.005)
    plan = plan_move(machine(), Q_USUAL, shifted(Q_USUAL, [0.2, 0, 0]), crawl)
    assert plan.status is PlanStatus.TOO_FAST
    assert "limit 120 s" in plan.reason


def test_speed_scale_slows_the_move():
    goal = shifted(Q_USUAL, [0.2, 0, 0])
    half = plan_move(machine(), Q_USUAL, goal, replace(DEFAULT_PLAN_SETTINGS, speed_scale=0.5))
    assert half.tcp_speed_max_m_s <= 0.5 * machine().tcp_speed_max_m_s


@pytest.mark.parametrize("bad", [np.zeros(5), np.full(6, np.nan)])
def test_bad_joints_are_a_broken_contract(bad):
    with pytest.raises(MotionInputError, match="q_start"):
        plan_move(machine(), bad, np.eye(4))


def test_bad_goal_is_a_broken_contract():
    with pytest.raises(MotionInputError, match="T_base_tcp_goal"):
        plan_move(machine(), Q_USUAL, np.diag([1.0, 1.0, -1.0, 1.0]))


def test_near_a_joint_limit_the_reference_does_not_lead_beyond_it():
    q = np.deg2rad([0.0, 30.0, -90.0, 0.0, -60.0, 130.0])
    goal = q + np.deg2rad([0.0, 0.0, 0.0, 0.0, 0.0, 39.0])
    plan = plan_joint_move(machine(), q, goal)
    assert plan.trajectory is not None, plan.reason
    _, motion = sample_trajectory(plan.trajectory, 0.003)
    assert np.rad2deg(motion.q[:, 5].max()) <= 170.0


def test_a_goal_beyond_all_arms_and_a_scale_of_nothing_are_refused_at_once():
    far = pose(np.eye(3), np.array([1e9, 0.0, 0.0]))
    plan = plan_move(machine(), Q_USUAL, far)
    assert plan.status is PlanStatus.OUT_OF_REACH
    assert "1e+09 m away (limit 100 m)" in plan.reason
    for scale in (0.0, -1.0, float("nan")):
        with pytest.raises(MotionInputError, match="speed_scale"):
            replace(DEFAULT_PLAN_SETTINGS, speed_scale=scale)
