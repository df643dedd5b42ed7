"""Time laws, the PLC's interpolation, and shaping: the lagging joint follows the plan when the reference leads it."""

import numpy as np
import pytest
from motion_scenes import Q_USUAL, machine, posture, shifted
from scipy.integrate import cumulative_simpson

from server.motion.contracts import (
    JointTrajectory,
    evaluate_trajectory,
    hold_trajectory,
    join_trajectories,
    sample_trajectory,
)
from server.motion.point_to_point import plan_move
from server.motion.settings import PAPER_PLAN_SETTINGS
from server.motion.timing import CruiseLaw, QuinticLaw, servo_lag_of


@pytest.mark.parametrize("law", [QuinticLaw(), CruiseLaw(0.5), CruiseLaw(0.3), CruiseLaw(0.1)])
def test_time_law_ends_and_derivatives(law):
    u = np.linspace(0.0, 1.0, 4001)
    s, *rates = law.derivatives(u, 4)
    assert s[0] == pytest.approx(0.0, abs=1e-12)
    assert s[-1] == pytest.approx(1.0, abs=1e-12)
    assert (rates[0] >= -1e-12).all()
    assert rates[0].max() == pytest.approx(law.peak, rel=1e-6)
    still = 2 if isinstance(law, QuinticLaw) else 4
    for rate in rates[:still]:
        assert np.abs(rate[[0, -1]]).max() < 1e-9
    for lower, upper in zip([s, *rates], rates[:3], strict=False):
        integral = cumulative_simpson(upper, x=u, initial=0.0) + lower[0]
        np.testing.assert_allclose(integral, lower, atol=2e-4 * max(1.0, np.abs(lower).max()))


def test_interpolation_meets_knots_and_is_smooth():
    plan = plan_move(machine(), Q_USUAL, shifted(Q_USUAL, [0.1, 0.05, -0.1]))
    trajectory = plan.trajectory
    assert trajectory is not None
    at = evaluate_trajectory(trajectory, trajectory.t_s)
    np.testing.assert_allclose(at.q, trajectory.q, atol=1e-12)
    np.testing.assert_allclose(at.qd, trajectory.qd, atol=1e-10)
    np.testing.assert_allclose(at.qdd, trajectory.qdd, atol=1e-8)
    t, motion = sample_trajectory(trajectory, 0.001)
    np.testing.assert_allclose(np.gradient(motion.q, t, axis=0)[2:-2], motion.qd[2:-2], atol=1e-5)


def follow(trajectory: JointTrajectory, after_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Nominal joints following a reference: qd = gain (q_ref - q) behind the PT-1 lag; 1 ms steps."""
    lag = servo_lag_of(machine())
    dt = 0.001
    t = np.arange(0.0, trajectory.duration_s + after_s, dt)
    reference = evaluate_trajectory(trajectory, t).q
    q, rate = trajectory.q[0].copy(), np.zeros(6)
    out = np.empty((len(t), 6))
    for k, q_ref in enumerate(reference):
        wanted = lag.gain * (q_ref - q)
        blend = np.where(lag.tau_s > 0.0, -np.expm1(-dt / np.maximum(lag.tau_s, 1e-9)), 1.0)
        rate = rate + blend * (wanted - rate)
        q = q + dt * rate
        out[k] = q
    return t, out


def lateness_deg(shaped: bool, seed: int) -> float:
    q = posture(seed)
    goal = shifted(q, [0.1, 0.1, -0.2])
    plan = plan_move(machine(), q, goal) if shaped else plan_move(machine(), q, goal, PAPER_PLAN_SETTINGS)
    assert plan.trajectory is not None
    _, joints = follow(plan.trajectory, 0.0)
    return float(np.rad2deg(np.abs(joints[-1] - plan.q_end).max()))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_shaped_reference_brings_the_nominal_joint_to_its_end_in_time(seed):
    assert lateness_deg(True, seed) < 0.03  # deg, at the last knot
    assert lateness_deg(False, seed) > 20 * lateness_deg(True, seed)


def test_start_with_a_static_offset_keeps_the_offset():
    """The reference starts where it was last commanded, although the joint stalls 0.2 deg beside it."""
    plan = plan_move(machine(), Q_USUAL, shifted(Q_USUAL, [0.05, 0.0, 0.0]))
    assert plan.trajectory is not None
    np.testing.assert_array_equal(plan.trajectory.q[0], Q_USUAL)


def test_join_and_hold():
    plan = plan_move(machine(), Q_USUAL, shifted(Q_USUAL, [0.05, 0.0, 0.0]))
    assert plan.trajectory is not None
    both = join_trajectories([plan.trajectory, hold_trajectory(plan.q_end, 0.5, 0.05)])
    assert both.duration_s == pytest.approx(plan.duration_s + 0.5)
    assert (np.diff(both.t_s) > 0.0).all()
    np.testing.assert_array_equal(both.q[-1], plan.q_end)
