"""Jog: the longest path that ranges, wall and singularity allow, never faster than the jog's speed."""

from dataclasses import replace

import numpy as np
import pytest
from motion_scenes import Q_USUAL, chain, machine, ooi_ahead, posture, wall_of

from machine.kinematics import sigma_min, tcp_jacobian, tcp_pose, tcp_poses
from machine.rotations import rotvec_from_rotation
from server.motion.contracts import PlanStatus, sample_trajectory
from server.motion.jog import PRESS_DURATION_MAX_S, JogSpeed, jog_axes, plan_jog
from server.motion.settings import DEFAULT_PLAN_SETTINGS
from server.motion.wall_clearance import clearances

SETTINGS = replace(DEFAULT_PLAN_SETTINGS, limit_share=0.8)
SPEED = JogSpeed(tcp_m_s=0.03, turn_rad_s=float(np.deg2rad(2.0)))
LEAD = 1.3  # a shaped reference leads the joints: PlanSettings.reference_tcp_share


def jogged(q, axis, direction, wall=None, speed=SPEED):
    return plan_jog(machine(), q, axis, direction, speed, SETTINGS, wall)


@pytest.mark.parametrize("direction", [-1, 1])
@pytest.mark.parametrize("axis", jog_axes(6))
def test_it_keeps_ranges_speed_and_its_own_axis(axis, direction):
    for seed in range(4):
        q = posture(seed)
        plan = jogged(q, axis, direction).path
        if plan.trajectory is None:
            assert plan.status in (PlanStatus.JOINT_LIMIT, PlanStatus.SINGULAR, PlanStatus.OUT_OF_REACH), plan.reason
            continue
        _, motion = sample_trajectory(plan.trajectory, 0.02)
        assert (motion.q >= chain().q_min - 1e-9).all()
        assert (motion.q <= chain().q_max + 1e-9).all()
        Ts = tcp_poses(chain(), motion.q)
        speeds = np.linalg.norm(np.diff(Ts[:, :3, 3], axis=0), axis=1) / 0.02
        assert speeds.max() <= LEAD * SPEED.tcp_m_s * 1.05  # of the reference; steps of 20 ms at most
        assert plan.tcp_speed_max_m_s <= SPEED.tcp_m_s * 1.001
        assert np.abs(motion.qd).max() <= SPEED.turn_rad_s * 1.001
        require_own_axis(q, plan.q_end, axis, direction)


def require_own_axis(q, q_end, axis, direction):
    """Only what was named has moved, in the direction that was named."""
    if axis.startswith("joint_"):
        moved = q_end - q
        own = int(axis[-1]) - 1
        assert moved[own] * direction > 0.0
        assert np.abs(np.delete(moved, own)).max() == 0.0
        return
    T, T_end = tcp_pose(chain(), q), tcp_pose(chain(), q_end)
    shift = T[:3, :3].T @ (T_end[:3, 3] - T[:3, 3])
    turn = rotvec_from_rotation(T[:3, :3].T @ T_end[:3, :3])
    own, still = (turn, shift) if axis.startswith("r") else (shift, turn)
    number = "xyz".index(axis[-1])
    assert own[number] * direction > 0.0
    assert np.abs(np.delete(own, number)).max() < 1e-9
    assert np.abs(still).max() < 1e-9


@pytest.mark.parametrize("distance_m", [0.8, 0.4, 0.1])
def test_towards_the_wall_it_ends_at_the_clearance(distance_m):
    wall = wall_of(ooi_ahead(Q_USUAL, distance_m), clearance_m=0.05)
    planned = jogged(Q_USUAL, "z", -1, wall)
    T_start = tcp_pose(chain(), Q_USUAL)
    start_m = float(clearances(T_start[None], machine().T_tcp_tool, wall)[0])
    if start_m <= wall.clearance_min_m + 1e-3:
        assert planned.path.trajectory is None
        assert planned.path.status is PlanStatus.WALL
        return
    assert planned.path.trajectory is not None, planned.path.reason
    _, motion = sample_trajectory(planned.path.trajectory, 0.02)
    nearest = clearances(tcp_poses(chain(), motion.q), machine().T_tcp_tool, wall).min()
    assert nearest >= wall.clearance_min_m - 1e-6
    if planned.ends_by:
        assert "wall" in planned.ends_by
        assert nearest <= wall.clearance_min_m + 2e-3  # it comes as near as it may, to the resolution


def test_inside_the_clearance_it_may_only_lead_away():
    wall = wall_of(ooi_ahead(Q_USUAL, 0.4), clearance_m=0.9)
    assert jogged(Q_USUAL, "z", -1, wall).path.status is PlanStatus.WALL
    away = jogged(Q_USUAL, "z", 1, wall).path
    assert away.status is PlanStatus.OK, away.reason


@pytest.mark.parametrize("number", range(1, 7))
def test_a_joint_at_its_limit_moves_back_only(number):
    for limit, inwards in ((chain().q_min, 1), (chain().q_max, -1)):
        q = Q_USUAL.copy()
        q[number - 1] = limit[number - 1]
        outwards = jogged(q, f"joint_{number}", -inwards)
        assert outwards.path.trajectory is None
        assert outwards.path.status is PlanStatus.JOINT_LIMIT
        assert machine().joints[number - 1].name in outwards.ends_by
        assert jogged(q, f"joint_{number}", inwards).path.status is PlanStatus.OK


def test_the_tool_does_not_enter_a_singularity_and_a_single_joint_leaves_it():
    bound = SETTINGS.wrist_pitch_min_rad
    entering = jogged(Q_USUAL, "ry", 1, speed=replace(SPEED, turn_rad_s=0.08))
    assert "singularity" in entering.ends_by
    assert entering.path.trajectory is not None
    _, motion = sample_trajectory(entering.path.trajectory, 0.02)
    assert np.abs(motion.q[:, SETTINGS.wrist_pitch_index]).min() >= bound - 5e-3  # a leading reference overshoots
    q = Q_USUAL.copy()
    q[SETTINGS.wrist_pitch_index] = 0.0
    assert sigma_min(tcp_jacobian(chain(), q)) < SETTINGS.sigma_min_min
    for axis in ("x", "y", "z", "rx"):
        refused = jogged(q, axis, 1).path
        assert refused.trajectory is None
        assert refused.status is PlanStatus.SINGULAR
    assert jogged(q, "joint_5", -1).path.status is PlanStatus.OK


def test_one_press_is_bounded():
    planned = jogged(Q_USUAL, "x", 1)
    assert planned.ends_by == ""
    assert planned.path.length_m == pytest.approx(SPEED.tcp_m_s * PRESS_DURATION_MAX_S, rel=1e-9)
    assert planned.path.duration_s < 2.0 * PRESS_DURATION_MAX_S


def test_an_axis_that_the_machine_does_not_have_is_refused_with_those_it_has():
    planned = jogged(Q_USUAL, "joint_7", 1)
    assert planned.path.trajectory is None
    assert "joint_6" in planned.ends_by
