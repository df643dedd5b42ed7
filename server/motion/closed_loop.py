"""Motion while looking: slow paths to rest from where the reference is and moves now, and where one may join in."""

from dataclasses import dataclass

import numpy as np

from machine.chain import Chain
from machine.description import Machine
from machine.kinematics import tcp_poses
from server.motion.contracts import Array, JointTrajectory, PlanStatus, Wall, sample_trajectory
from server.motion.refusal import Refusal, range_refusal, singular_refusal
from server.motion.settings import DEFAULT_PLAN_SETTINGS
from server.motion.timing import limit_excess
from server.motion.wall_clearance import wall_refusal

KNOT_PERIOD_S = 0.05
ITERATIONS_MAX = 12
DURATION_MAX_S = 60.0
JOIN_LEAD_TIME_S = 0.3  # the link asks for 0.2 s ahead of the playback; the rest is planning and a late command
SINGULARITY_CHECK_STEP = 5  # samples of 0.02 s
TCP_SPEED_FRAC = 0.9  # of the speed limit: the reference is what is planned, the tool may lead it a little


@dataclass(frozen=True, slots=True)
class TailStart:
    """Where a new tail begins: knot `first_knot` is its first one; the motion at the knot before it, at `t_s`."""

    first_knot: int
    t_s: float
    q: Array
    qd: Array
    qdd: Array


def join_after(trajectory: JointTrajectory, t_play_s: float) -> TailStart | None:
    """The first knot that may still be replaced, None where the end is too near."""
    first = int(np.searchsorted(trajectory.t_s, t_play_s + JOIN_LEAD_TIME_S))
    if first < 1 or first >= len(trajectory.t_s):
        return None
    k = first - 1
    return TailStart(first, float(trajectory.t_s[k]), trajectory.q[k], trajectory.qd[k], trajectory.qdd[k])


def at_rest(q: Array) -> TailStart:
    """The beginning of a motion from rest at q (n,)."""
    return TailStart(1, 0.0, q, np.zeros_like(q), np.zeros_like(q))


def path_to_rest(
    machine: Machine,
    chain: Chain,
    start: TailStart,
    q_goal: Array,
    speed_max_m_s: float,
    duration_min_s: float,
    wall: Wall | None,
) -> JointTrajectory | Refusal:
    """From a moving reference to rest at a goal, every joint by one quintic, as slowly as the TCP's speed limit asks.

    Model:   q(t) is the polynomial of degree five that meets position, velocity and acceleration at both ends; its
             duration grows until TCP speed, joint speeds and accelerations are inside their limits between the knots.
    Args:    start: the knot before. q_goal: reference (n,) [rad]. duration_min_s: not sooner than that: a correction
             that needs no more time keeps the end that was planned.
    Returns: knots *after* the start, times on the running trajectory's clock; or why not: too fast, range, singular,
             wall.
    """
    tcp_share = TCP_SPEED_FRAC * speed_max_m_s / machine.tcp_speed_max_m_s
    duration_s = max(duration_min_s, 4.0 * KNOT_PERIOD_S)
    worst = "speed of the TCP"
    for _ in range(ITERATIONS_MAX):
        n = int(np.ceil(duration_s / KNOT_PERIOD_S - 1e-9))
        whole = _quintic_to_rest(start, q_goal, KNOT_PERIOD_S * np.arange(n + 1, dtype=np.float64))
        found = limit_excess(machine, chain, whole, DEFAULT_PLAN_SETTINGS, tcp_share)
        if found.time_factor <= 1.0:
            return _checked_tail(machine, chain, whole, start, wall)
        worst, duration_s = found.limiting_quantity, KNOT_PERIOD_S * n * min(1.02 * found.time_factor, 2.0)
        if duration_s > DURATION_MAX_S:
            break
    text = f"{worst} asks for more than {DURATION_MAX_S:.0f} s; move closer with an ordinary move first"
    return Refusal(PlanStatus.TOO_FAST, text)


def _checked_tail(
    machine: Machine, chain: Chain, whole: JointTrajectory, start: TailStart, wall: Wall | None
) -> JointTrajectory | Refusal:
    _, motion = sample_trajectory(whole, 0.02)
    beyond = range_refusal(machine, motion.q, DEFAULT_PLAN_SETTINGS.joint_margin_rad)
    if beyond is not None:
        return beyond
    _, near = singular_refusal(machine, chain, motion.q[::-SINGULARITY_CHECK_STEP], DEFAULT_PLAN_SETTINGS)
    if near is not None:
        return near
    _, hit = wall_refusal(tcp_poses(chain, motion.q), machine.T_tcp_tool, wall)
    if hit is not None:
        return hit
    return JointTrajectory(whole.t_s[1:] + start.t_s, whole.q[1:], whole.qd[1:], whole.qdd[1:])


def _quintic_to_rest(start: TailStart, q_goal: Array, t_s: Array) -> JointTrajectory:
    """Knots of the quintic from the start's motion to rest at the goal, the start included, times from 0."""
    T, t = float(t_s[-1]), t_s[:, None]
    u = t / T
    h = q_goal - start.q - (start.qd + 0.5 * start.qdd * T) * T
    dv = -(start.qd + start.qdd * T) * T
    da = -start.qdd * T**2
    c3, c4, c5 = 10.0 * h - 4.0 * dv + 0.5 * da, -15.0 * h + 7.0 * dv - da, 6.0 * h - 3.0 * dv + 0.5 * da
    q = start.q + (start.qd + 0.5 * start.qdd * t) * t + (c3 + (c4 + c5 * u) * u) * u**3
    qd = start.qd + start.qdd * t + (3.0 * c3 + (4.0 * c4 + 5.0 * c5 * u) * u) * u**2 / T
    qdd = start.qdd + (6.0 * c3 + (12.0 * c4 + 20.0 * c5 * u) * u) * u / T**2
    q[-1], qd[-1], qdd[-1] = q_goal, 0.0, 0.0
    return JointTrajectory(t_s, q, qd, qdd)


def with_start(tail: JointTrajectory, start: TailStart) -> JointTrajectory:
    """A whole trajectory: the start knot in front of the tail."""
    return JointTrajectory(
        np.concatenate([[start.t_s], tail.t_s]),
        np.vstack([start.q, tail.q]),
        np.vstack([start.qd, tail.qd]),
        np.vstack([start.qdd, tail.qdd]),
    )


def with_tail(trajectory: JointTrajectory, first: int, tail: JointTrajectory) -> JointTrajectory:
    """The trajectory with everything from knot `first` on replaced."""
    return JointTrajectory(
        np.concatenate([trajectory.t_s[:first], tail.t_s]),
        np.vstack([trajectory.q[:first], tail.q]),
        np.vstack([trajectory.qd[:first], tail.qd]),
        np.vstack([trajectory.qdd[:first], tail.qdd]),
    )


def reference_goal(q_goal: Array, q_now: Array, q_ref_now: Array, stall_rad: Array, loose_rad: float = 3e-4) -> Array:
    """Where the reference must end for the encoders to rest at q_goal: its stall beyond it, on the side it comes from.

    Joints with less to go than `loose_rad` keep the offset they have.
    """
    travel = q_goal - q_now
    return q_goal + np.where(np.abs(travel) > loose_rad, np.sign(travel) * stall_rad, q_ref_now - q_now)
