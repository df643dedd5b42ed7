"""One-sided approach and trims: the last motion of a joint with backlash is always forward."""

import numpy as np
import pytest
from motion_scenes import Q_USUAL, chain, machine, ooi_ahead, posture, shifted, wall_of

from machine.kinematics import tcp_pose
from server.motion.approach import offset_goal, plan_approach, trim_reference
from server.motion.contracts import JointTrajectory, PlanStatus
from server.motion.trajectory import sample

BACKLASH = [0, 3, 4, 5]


@pytest.mark.parametrize("seed", range(6))
def test_backlash_joints_end_forward_by_their_play(seed):
    q = posture(seed)
    rng = np.random.default_rng(seed)
    goal = shifted(q, list(rng.uniform(-0.12, 0.12, size=3)))
    plan = plan_approach(machine(), q, goal)
    assert plan.status is PlanStatus.OK, plan.reason
    assert plan.trajectory is not None
    trajectory = plan.trajectory
    np.testing.assert_allclose(tcp_pose(chain(), trajectory.q[-1]), goal, atol=1e-9)
    last_rest = int(np.flatnonzero(np.abs(trajectory.qd[:-1]).max(axis=1) == 0.0)[-1])
    travel = trajectory.q[-1] - trajectory.q[last_rest]
    assert travel[0] == pytest.approx(0.003, abs=1e-9)  # rad
    np.testing.assert_allclose(np.rad2deg(travel[3:]), 0.4, atol=1e-6)
    assert trajectory.t_s[-1] - trajectory.t_s[last_rest] >= 1.5 - 1e-9  # s
    t, motion = sample(trajectory, 0.01)
    rising = np.diff(motion.q[t >= trajectory.t_s[last_rest]][:, BACKLASH], axis=0)
    assert rising.min() >= -1e-12  # rad: the reference itself never turns back


def test_approach_passes_on_refusals():
    ooi = ooi_ahead(Q_USUAL, 0.4)
    plan = plan_approach(machine(), Q_USUAL, shifted(Q_USUAL, [0, 0, -0.42]), wall=wall_of(ooi, 0.1))
    assert plan.status is PlanStatus.WALL
    assert plan.trajectory is None


def test_trim_shifts_the_reference_by_the_residual():
    residual = np.deg2rad([0.05, 0.2, -0.15, 0.1, 0.05, 0.05])
    plan = trim_reference(machine(), Q_USUAL, residual)
    assert plan.trajectory is not None
    np.testing.assert_allclose(plan.trajectory.q[-1], Q_USUAL + residual, atol=1e-12)
    assert plan.duration_s == pytest.approx(1.0, abs=0.3)  # s, one leg: only joints without backlash go back


def test_trim_backwards_on_a_backlash_joint_comes_from_below():
    residual = np.deg2rad([-0.1, 0.0, 0.0, 0.1, 0.0, -0.2])
    plan = trim_reference(machine(), Q_USUAL, residual)
    assert plan.trajectory is not None
    lowest = plan.trajectory.q.min(axis=0)
    end = Q_USUAL + residual
    assert lowest[0] <= end[0] - 0.003 + 1e-6
    assert lowest[5] <= end[5] - np.deg2rad(0.4) + 1e-6
    np.testing.assert_allclose(plan.trajectory.q[-1], end, atol=1e-12)
    assert plan.duration_s <= 2.6


def test_trim_ignores_what_is_not_worth_it_and_refuses_what_is_too_much():
    small = trim_reference(machine(), Q_USUAL, np.full(6, np.deg2rad(0.001)))
    np.testing.assert_array_equal(small.q_end, Q_USUAL)
    large = trim_reference(machine(), Q_USUAL, np.deg2rad([0, 3.5, 0, 0, 0, 0]))
    assert large.status is PlanStatus.INVALID
    assert "'lift' lacks 3.50 deg" in large.reason
    assert "3.0 deg" in large.reason


def rest_after(q_start: np.ndarray, trajectory: JointTrajectory, stall: np.ndarray) -> np.ndarray:
    """Where joints with a dead band rest: each follows its reference at its stall, like a dragged weight."""
    q = q_start.copy()
    for q_ref in sample(trajectory, 0.01)[1].q:
        q = np.clip(q, q_ref - stall, q_ref + stall)
    return q


@pytest.mark.parametrize("seed", range(5))
def test_trims_come_through_a_dead_band_in_two_and_end_forward(seed):
    rng = np.random.default_rng(seed)
    stall = np.deg2rad([0.4, 0.2, 0.2, 0.3, 0.3, 0.3])
    wanted = Q_USUAL
    q_ref = Q_USUAL + np.deg2rad(rng.uniform(-0.3, 0.3, size=6))
    q = q_ref + stall * rng.choice([-1.0, 1.0], size=6)
    for _ in range(2):
        plan = trim_reference(machine(), q_ref, wanted - q, q_encoder=q)
        assert plan.trajectory is not None
        q = rest_after(q, plan.trajectory, stall)
        q_ref = plan.q_end
    assert np.rad2deg(np.abs(wanted - q)).max() < 0.005
    assert (q_ref - q)[BACKLASH].min() >= 0.0  # resting below the reference: every flank came forward


def test_offset_goal_moves_along_the_tools_own_axes():
    T = tcp_pose(chain(), Q_USUAL)
    np.testing.assert_allclose(offset_goal(T, np.array([0.0, 0.0, 0.2])), shifted(Q_USUAL, [0, 0, 0.2]))
