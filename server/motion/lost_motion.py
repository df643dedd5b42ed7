"""Stall in the valve's dead band: the reference stands off the encoders by it, and to which side the motion tells.

A P-controlled valve opens only when kp |q_ref - q| exceeds its dead band, so a joint rests `stall` short of the
reference, on the side it came from. Paths are planned for the encoders; here they become paths of the reference.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from machine.chain import chain_of
from machine.description import Machine
from machine.kinematics import tcp_jacobian
from machine.rotations import Array
from server.motion.contracts import JointTrajectory, PathPlan
from server.motion.point_to_point import plan_joint_move
from server.motion.refusal import require_joints
from server.motion.settings import PlanSettings
from server.motion.trajectory import join

FIRST_GUESS_FRAC = 0.015  # half width of a servo valve's dead band in fraction of full command, until it is seen
STALL_MAX_RAD = 0.06  # more is no dead band but a joint that does not follow
MOVED_RAD = 2e-4  # a joint that turned by more has left its dead band, so where it rests tells the stall
TRAVEL_RAD = 1e-6
TIP_SHARE_M = 2e-4  # residual of one joint that is not worth a trim, by its effect at the TCP
RESIDUAL_MIN_RAD = 6e-5  # two counts of an 18-bit encoder


def first_stall(machine: Machine) -> Array:
    """Stall of each joint before any was seen (n,) [rad]."""
    return np.array([FIRST_GUESS_FRAC / joint.kp_frac_per_rad for joint in machine.joints])


def onto_reference(trajectory: JointTrajectory, q_ref_now: Array, stall_rad: Array) -> JointTrajectory:
    """The reference that makes the encoders follow a planned path.

    Model:   q_ref = q_path + offset; offset starts as it is now and goes, over each leg between two rests, to
             sign(travel of that leg) * stall; joints that do not travel keep theirs.
    Args:    trajectory: planned from the encoders' joints. q_ref_now: present reference (n,) [rad]. stall_rad: (n,).
    Returns: the same knots, moved; the first knot is q_ref_now exactly.
    """
    resting = np.flatnonzero((np.abs(trajectory.qd) < 1e-9).all(axis=1))
    bounds = sorted({0, *resting.tolist(), len(trajectory.t_s) - 1})
    q, qd, qdd = trajectory.q.copy(), trajectory.qd.copy(), trajectory.qdd.copy()
    offset = q_ref_now - trajectory.q[0]
    for first, last in pairwise(bounds):
        travel = trajectory.q[last] - trajectory.q[first]
        wanted = np.where(np.abs(travel) > TRAVEL_RAD, np.sign(travel) * stall_rad, offset)
        span_s = trajectory.t_s[last] - trajectory.t_s[first]
        u = (trajectory.t_s[first : last + 1] - trajectory.t_s[first]) / span_s
        s, sd, sdd = _quintic(u)
        rows = slice(first if first == 0 else first + 1, last + 1)
        skip = 0 if first == 0 else 1
        step = wanted - offset
        q[rows] += offset + s[skip:, None] * step
        qd[rows] += sd[skip:, None] * step / span_s
        qdd[rows] += sdd[skip:, None] * step / span_s**2
        offset = wanted
    q[0] = q_ref_now
    return JointTrajectory(trajectory.t_s, q, qd, qdd)


def _quintic(u: Array) -> tuple[Array, Array, Array]:
    return 10 * u**3 - 15 * u**4 + 6 * u**5, 30 * u**2 * (1 - u) ** 2, 60 * u * (1 - u) * (1 - 2 * u)


def updated_stall(stall_rad: Array, q_ref: Array, q_before: Array, q_after: Array, residual: Array) -> Array:
    """What a rest tells about the stall.

    A joint that moved rests its stall away from the reference. One that was asked to move and did not has a larger
    stall than its reference stands off.
    """
    travel, off = q_after - q_before, q_ref - q_after
    moved = np.abs(travel) > MOVED_RAD
    stuck = ~moved & (residual * off > 0.0)
    larger = np.maximum(stall_rad, np.abs(off) + np.abs(residual))
    stall = np.where(moved, np.sign(travel) * off, np.where(stuck, larger, stall_rad))
    return np.clip(stall, 0.0, STALL_MAX_RAD)


def worth_trimming(machine: Machine, q: Array, residual: Array) -> NDArray[np.bool_]:
    """Which joints lack so much that the tool shows it: (n,) of bool."""
    J = tcp_jacobian(chain_of(machine), q)
    lever_m = np.linalg.norm(J[:3], axis=0) + 0.2  # and what the tool turns by
    return np.abs(residual) > np.maximum(TIP_SHARE_M / lever_m, RESIDUAL_MIN_RAD)


def plan_trim(
    machine: Machine, q_ref: Array, q: Array, q_goal: Array, stall_rad: Array, play_rad: Array, settings: PlanSettings
) -> PathPlan:
    """Small path of the reference after which the encoders stand at q_goal.

    Model:   q_ref_new = q_goal + sign(residual) stall. A joint with backlash always ends forward: when it has to go
             back, it first goes to q_goal - play with the stall on the other side.
    Args:    q_ref, q, q_goal: (n,) [rad]; q are the encoders at rest. play_rad: (n,), 0 where there is no play.
    Returns: a plan of one or two legs; as `plan_joint_move` when it is not possible.
    """
    residual = require_joints(q_goal - q, len(machine.joints), "residual")
    lacking = worth_trimming(machine, q, residual)
    back = lacking & (residual < 0.0) & (play_rad > 0.0)
    direction = np.where(back, 1.0, np.sign(residual))
    final = np.where(lacking, q_goal + direction * stall_rad, q_ref)
    targets = [final]
    if back.any():
        targets.insert(0, np.where(back, q_goal - play_rad - stall_rad, np.where(lacking, final, q_ref)))
    return _through(machine, q_ref, targets, settings)


def _through(machine: Machine, q_ref: Array, targets: list[Array], settings: PlanSettings) -> PathPlan:
    plans, here = [], q_ref
    for target in targets:
        plan = plan_joint_move(machine, here, target, settings)
        if plan.trajectory is None:
            return plan
        plans.append(plan)
        here = plan.trajectory.q[-1]
    if len(plans) == 1:
        return plans[0]
    first, last = plans
    return PathPlan(
        status=last.status,
        reason="",
        trajectory=join([first.trajectory, last.trajectory]),
        Ts_base_tcp=np.concatenate([first.Ts_base_tcp, last.Ts_base_tcp]),
        q_end=last.q_end,
        length_m=first.length_m + last.length_m,
        duration_s=first.duration_s + last.duration_s,
        tcp_speed_max_m_s=max(first.tcp_speed_max_m_s, last.tcp_speed_max_m_s),
        clearance_m=min(first.clearance_m, last.clearance_m),
        sigma_min=min(first.sigma_min, last.sigma_min),
        joint_travel_rad=first.joint_travel_rad + last.joint_travel_rad,
    )
