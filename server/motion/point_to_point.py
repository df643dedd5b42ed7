"""Point to point: straight Cartesian moves, joint moves and chains of straight legs, each from rest to rest."""

from dataclasses import dataclass, replace

import numpy as np

from machine.chain import Chain, chain_of
from machine.description import Machine
from machine.kinematics import tcp_pose, tcp_poses
from server.motion.contracts import Array, PathPlan, PlanStatus, Wall, join_trajectories, sample_trajectory
from server.motion.joint_path import JointPath, joint_line, joint_path_along, straight_poses
from server.motion.refusal import Refusal, range_refusal, refused_plan, require_goal, require_joints, singular_refusal
from server.motion.settings import DEFAULT_PLAN_SETTINGS, PlanSettings
from server.motion.timing import TimedPath, time_path
from server.motion.wall_clearance import wall_refusal

GOAL_DISTANCE_MAX_M = 100.0  # the samples of a longer way would fill the memory before anything is refused


@dataclass(frozen=True, slots=True)
class PathLeg:
    """One rest-to-rest piece: its shape, its timed reference, and its smallest clearance [m] and sigma-min."""

    path: JointPath
    timed_path: TimedPath
    clearance_m: float
    sigma_min: float


def plan_move(
    machine: Machine,
    q_start: Array,
    T_base_tcp_goal: Array,
    settings: PlanSettings = DEFAULT_PLAN_SETTINGS,
    wall: Wall | None = None,
) -> PathPlan:
    """Straight move of the TCP to a pose.

    Model:   line and even turn in Cartesian space, inverse kinematics on the present branch, quintic in time (ramps
             and even speed when the reference is shaped), stretched until joint and TCP limits hold.
    Args:    q_start: the present *reference* (joints,) [rad], knot 0 of the plan; T_base_tcp_goal: nominal pose (4, 4).
    Returns: the plan; a status with its reason and no trajectory when it may not be driven.
    Raises:  MotionInputError: shapes, values that are not finite, not a pose.
    Source:  Makinen et al. 2023, section 4.2 (quintic point-to-point).
    """
    return plan_through(machine, q_start, [require_goal(T_base_tcp_goal, "T_base_tcp_goal")], settings, wall)


def plan_through(
    machine: Machine,
    q_start: Array,
    Ts_base_tcp: list[Array],
    settings: PlanSettings = DEFAULT_PLAN_SETTINGS,
    wall: Wall | None = None,
) -> PathPlan:
    """Straight legs through poses (4, 4), resting at each. Arguments, result and errors as `plan_move`."""
    chain = chain_of(machine)
    q = require_joints(q_start, chain.n, "q_start")
    legs: list[PathLeg] = []
    tried = [tcp_pose(chain, q), *Ts_base_tcp]
    start_refusal = range_refusal(machine, np.array([q]), settings.joint_margin_rad)
    if start_refusal is not None:
        return refused_plan(start_refusal, q, np.array(tried))
    for T_end in tried[1:]:
        leg = cartesian_leg(machine, chain, q, T_end, settings, wall)
        if isinstance(leg, Refusal):
            return refused_plan(leg, np.asarray(q_start), np.array(tried))
        legs.append(leg)
        q = path_end(leg)
    return plan_of(legs)


def plan_joint_move(
    machine: Machine,
    q_start: Array,
    q_goal: Array,
    settings: PlanSettings = DEFAULT_PLAN_SETTINGS,
    wall: Wall | None = None,
) -> PathPlan:
    """Straight move in joint space, such as to park. As `plan_move`, with joints (joints,) [rad] as goal."""
    chain = chain_of(machine)
    start = require_joints(q_start, chain.n, "q_start")
    goal = require_joints(q_goal, chain.n, "q_goal")
    leg = joint_leg(machine, chain, start, goal, settings, wall)
    return (
        refused_plan(leg, start, tcp_poses(chain, np.array([start, goal])))
        if isinstance(leg, Refusal)
        else plan_of([leg])
    )


def cartesian_leg(
    machine: Machine, chain: Chain, q_start: Array, T_end: Array, settings: PlanSettings, wall: Wall | None
) -> PathLeg | Refusal:
    """One straight leg of the TCP from where the joints are to a pose (4, 4)."""
    T_start = tcp_pose(chain, q_start)
    far_m = float(np.linalg.norm(T_end[:3, 3] - T_start[:3, 3]))
    if far_m > GOAL_DISTANCE_MAX_M:
        text = (
            f"the goal is {far_m:.3g} m away (limit {GOAL_DISTANCE_MAX_M:g} m): no arm of this kind reaches so "
            "far; look again"
        )
        return Refusal(PlanStatus.OUT_OF_REACH, text)
    path = joint_path_along(machine, chain, q_start, straight_poses(T_start, T_end, settings), settings)
    return path if isinstance(path, Refusal) else _plan_path_leg(machine, chain, path, settings, wall)


def joint_leg(
    machine: Machine, chain: Chain, q_start: Array, q_end: Array, settings: PlanSettings, wall: Wall | None
) -> PathLeg | Refusal:
    """One leg in joint space, which may pass through the wrist singularity."""
    return _plan_path_leg(machine, chain, joint_line(chain, q_start, q_end), settings, wall, singular_ok=True)


def path_end(leg: PathLeg) -> Array:
    """Joints at the end of a leg (joints,) [rad]."""
    return leg.path.qs[-1]


def _plan_path_leg(
    machine: Machine,
    chain: Chain,
    path: JointPath,
    settings: PlanSettings,
    wall: Wall | None,
    singular_ok: bool = False,
) -> PathLeg | Refusal:
    smallest, singular = singular_refusal(machine, chain, path.qs, settings)
    if singular is not None and not singular_ok:
        return singular
    clearance, wall_hit = wall_refusal(path.Ts_base_tcp, machine.T_tcp_tool, wall)
    if wall_hit is not None:
        return wall_hit
    beyond = range_refusal(machine, path.qs, settings.joint_margin_rad)
    if beyond is not None:
        return beyond
    timed = _timed_inside(machine, chain, path, settings)
    return timed if isinstance(timed, Refusal) else PathLeg(path, timed, clearance, smallest)


def _timed_inside(machine: Machine, chain: Chain, path: JointPath, settings: PlanSettings) -> TimedPath | Refusal:
    """Timed reference inside the joint ranges: where a leading one would leave them, the plain one is taken."""
    timed = time_path(machine, chain, path, settings)
    if isinstance(timed, Refusal) or not settings.shape_reference:
        return timed
    _, reference = sample_trajectory(timed.reference, 0.02)
    if range_refusal(machine, np.vstack((path.qs[:1], reference.q)), 0.0) is None:
        return timed
    return time_path(machine, chain, path, replace(settings, shape_reference=False))


def plan_of(legs: list[PathLeg]) -> PathPlan:
    """The plan made of legs that follow one another."""
    trajectory = join_trajectories([leg.timed_path.reference for leg in legs])
    Ts = np.concatenate([leg.path.Ts_base_tcp for leg in legs])
    qs = np.concatenate([leg.path.qs for leg in legs])
    return PathPlan(
        status=PlanStatus.OK,
        reason="",
        trajectory=trajectory,
        Ts_base_tcp=Ts,
        q_end=qs[-1].copy(),
        length_m=sum(leg.path.length_m for leg in legs),
        duration_s=trajectory.duration_s,
        tcp_speed_max_m_s=max(leg.timed_path.tcp_speed_m_s for leg in legs),
        clearance_m=min(leg.clearance_m for leg in legs),
        sigma_min=min(leg.sigma_min for leg in legs),
        joint_travel_rad=np.abs(np.diff(qs, axis=0)).sum(axis=0),
    )
