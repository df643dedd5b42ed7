"""Dead-band offset ("stall"): steady-state difference of reference and encoder, signed by the last motion.

A P-controlled valve opens only when kp |q_ref - q| exceeds its dead band, so a joint rests `stall` short of the
reference, on the side it came from. Paths are planned for the encoders; here they become paths of the reference.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from machine.chain import chain_of
from machine.description import Machine
from machine.kinematics import tcp_jacobian
from machine.rotations import Array
from server.motion.contracts import JointTrajectory, PathPlan, Wall, join_trajectories
from server.motion.joint_path import joint_line
from server.motion.point_to_point import plan_joint_move
from server.motion.refusal import refused_plan, require_joints
from server.motion.settings import PlanSettings
from server.motion.wall_clearance import wall_refusal

INITIAL_DEAD_BAND_FRAC = 0.015  # half width of a servo valve's dead band in fraction of full command, until it is seen
DEAD_BAND_MAX_RAD = 0.06  # more is not a dead band but a joint that does not follow
STICTION_BREAK_MIN_RAD = float(np.deg2rad(0.3))  # a motion this long breaks stiction, so its rest shows the stall
STUCK_SHORTFALL_FRAC = 0.6  # of the last motion: a joint that stays short by more did not make that motion
TRAVEL_MIN_RAD = 1e-6
TCP_RESIDUAL_MIN_M = 5e-4  # residual of one joint that is not worth a trim, by its effect at the TCP
ROTATION_LEVER_M = 0.1  # and what its turn does to the tool: 0.5 mm at 0.1 m are 0.3 deg
JOINT_RESIDUAL_MIN_RAD = 6e-5  # two counts of an 18-bit encoder


def first_stall(machine: Machine) -> Array:
    """Stall of each joint before any was seen (n,) [rad]."""
    return np.array([INITIAL_DEAD_BAND_FRAC / joint.kp_frac_per_rad for joint in machine.joints])


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
        wanted = np.where(np.abs(travel) > TRAVEL_MIN_RAD, np.sign(travel) * stall_rad, offset)
        span_s = trajectory.t_s[last] - trajectory.t_s[first]
        u = (trajectory.t_s[first : last + 1] - trajectory.t_s[first]) / span_s
        s, sd, sdd = _quintic_time_law(u)
        rows = slice(first if first == 0 else first + 1, last + 1)
        skip = 0 if first == 0 else 1
        step = wanted - offset
        q[rows] += offset + s[skip:, None] * step
        qd[rows] += sd[skip:, None] * step / span_s
        qdd[rows] += sdd[skip:, None] * step / span_s**2
        offset = wanted
    q[0] = q_ref_now
    return JointTrajectory(trajectory.t_s, q, qd, qdd)


def _quintic_time_law(u: Array) -> tuple[Array, Array, Array]:
    return 10 * u**3 - 15 * u**4 + 6 * u**5, 30 * u**2 * (1 - u) ** 2, 60 * u * (1 - u) * (1 - 2 * u)


def updated_stall(
    stall_rad: Array, q_ref: Array, q_rest: Array, direction: Array, play_rad: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """The stall by a rest, and which joints did not break loose.

    A joint that came from below rests its stall below the reference. One that rests much further off than it did
    before was held by stiction; that rest says nothing about its stall.
    Args:    direction: of each joint's last motion (n,): +1, -1, or 0 if too short to use; play_rad: its length.
    Returns: stall (n,) [rad]; stuck (n,) of bool.
    """
    seen = direction * (q_ref - q_rest)
    stuck = (direction != 0.0) & (seen - stall_rad > STUCK_SHORTFALL_FRAC * play_rad)
    learnt = (direction != 0.0) & ~stuck
    return np.where(learnt, np.clip(seen, 0.0, DEAD_BAND_MAX_RAD), stall_rad), stuck


def last_direction(trajectory: JointTrajectory) -> Array:
    """Direction of each joint in the last leg of a path (n,); 0 where it turned too little to break loose."""
    resting = np.flatnonzero((np.abs(trajectory.qd) < 1e-9).all(axis=1))
    begun = resting[resting < len(trajectory.t_s) - 1]
    travel = trajectory.q[-1] - trajectory.q[begun[-1] if len(begun) else 0]
    return np.where(np.abs(travel) > STICTION_BREAK_MIN_RAD, np.sign(travel), 0.0)


def worth_trimming(machine: Machine, q: Array, residual: Array) -> NDArray[np.bool_]:
    """Which joints are so far short of their goal that the tool shows it: (n,) of bool."""
    J = tcp_jacobian(chain_of(machine), q)
    lever_m = np.linalg.norm(J[:3], axis=0) + ROTATION_LEVER_M
    return np.abs(residual) > np.maximum(TCP_RESIDUAL_MIN_M / lever_m, JOINT_RESIDUAL_MIN_RAD)


def plan_trim(
    machine: Machine,
    q_ref: Array,
    q: Array,
    q_goal: Array,
    stall_rad: Array,
    play_rad: Array,
    settings: PlanSettings,
    wall: Wall | None = None,
) -> PathPlan:
    """Come again from below, by as much as breaks the joint loose, to where the encoders then stand at q_goal.

    Model:   stiction lets a small step of the reference pass, then jumps; a motion of half a degree always ends the
             same stall short. So a joint that is short goes to q_goal - play - stall, then to q_goal + stall.
    Args:    q_ref, q, q_goal: (n,) [rad]; q are the encoders at rest. play_rad: how far below it starts (n,).
             wall: the tool keeps off it on the joints' way, q to q_goal - play to q_goal.
    Returns: a plan of two legs; as `plan_joint_move` when it is not possible.
    """
    short = worth_trimming(machine, q, require_joints(q_goal - q, len(machine.joints), "residual"))
    below = np.where(short, q_goal - play_rad - stall_rad, q_ref)
    plan = _plan_through_targets(machine, q_ref, [below, np.where(short, q_goal + stall_rad, q_ref)], settings)
    way = [q, np.where(short, q_goal - play_rad, q), np.where(short, q_goal, q)]
    return off_the_wall(machine, plan, way, wall)


def off_the_wall(machine: Machine, plan: PathPlan, way: list[Array], wall: Wall | None) -> PathPlan:
    """A plan of the reference, checked against the wall where the joints will be: stall does not move the tool.

    Args:    way: encoders (n,) [rad] from rest to rest, straight in between.
    Returns: the plan with the clearance on that way; refused where the tool comes too near.
    """
    if plan.trajectory is None or wall is None:
        return plan
    chain = chain_of(machine)
    Ts = np.concatenate([joint_line(chain, first, last).Ts_base_tcp for first, last in pairwise(way)])
    clearance_m, hit = wall_refusal(Ts, machine.T_tcp_tool, wall)
    return replace(plan, clearance_m=clearance_m) if hit is None else refused_plan(hit, way[0], Ts)


def _plan_through_targets(machine: Machine, q_ref: Array, targets: list[Array], settings: PlanSettings) -> PathPlan:
    plans, here = [], q_ref
    for target in targets:
        plan = plan_joint_move(machine, here, target, settings)
        if plan.trajectory is None:
            return plan
        plans.append(plan)
        here = plan.trajectory.q[-1]
    first, last = plans
    return PathPlan(
        status=last.status,
        reason="",
        trajectory=join_trajectories([first.trajectory, last.trajectory]),
        Ts_base_tcp=np.concatenate([first.Ts_base_tcp, last.Ts_base_tcp]),
        q_end=last.q_end,
        length_m=first.length_m + last.length_m,
        duration_s=first.duration_s + last.duration_s,
        tcp_speed_max_m_s=max(first.tcp_speed_max_m_s, last.tcp_speed_max_m_s),
        clearance_m=min(first.clearance_m, last.clearance_m),
        sigma_min=min(first.sigma_min, last.sigma_min),
        joint_travel_rad=first.joint_travel_rad + last.joint_travel_rad,
    )
