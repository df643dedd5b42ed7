"""One-sided approach: the last motion of every joint is forward, by enough to break it loose."""

import numpy as np
import pytest
from motion_scenes import Q_USUAL, chain, machine, ooi_ahead, posture, shifted, wall_of

from machine.kinematics import tcp_pose
from server.motion.approach import offset_goal, plan_approach, play_of
from server.motion.contracts import PlanStatus, sample_trajectory


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
    np.testing.assert_allclose(travel, play_of(6), atol=1e-9)  # rad
    assert trajectory.t_s[-1] - trajectory.t_s[last_rest] >= 2.0 - 1e-9  # s
    t, motion = sample_trajectory(trajectory, 0.01)
    rising = np.diff(motion.q[t >= trajectory.t_s[last_rest]], axis=0)
    assert rising.min() >= -1e-12  # rad: the reference itself never turns back


def test_approach_passes_on_refusals():
    ooi = ooi_ahead(Q_USUAL, 0.4)
    plan = plan_approach(machine(), Q_USUAL, shifted(Q_USUAL, [0, 0, -0.42]), wall=wall_of(ooi, 0.1))
    assert plan.status is PlanStatus.WALL
    assert plan.trajectory is None


def test_known_joints_of_the_goal_give_the_traced_path():
    goal = shifted(Q_USUAL, [0.05, -0.08, -0.1])
    traced = plan_approach(machine(), Q_USUAL, goal)
    known = plan_approach(machine(), Q_USUAL, goal, q_goal=traced.q_end)
    np.testing.assert_allclose(known.trajectory.q, traced.trajectory.q, atol=1e-9)
    other_posture = traced.q_end + np.array([0.0, 0.0, 0.0, np.pi, 0.0, 0.0])
    again = plan_approach(machine(), Q_USUAL, goal, q_goal=other_posture)
    np.testing.assert_array_equal(again.trajectory.q, traced.trajectory.q)


def test_offset_goal_moves_along_the_tools_own_axes():
    T = tcp_pose(chain(), Q_USUAL)
    np.testing.assert_allclose(offset_goal(T, np.array([0.0, 0.0, 0.2])), shifted(Q_USUAL, [0, 0, 0.2]))
