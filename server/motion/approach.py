"""Approach from one side, so that backlash lies the same way."""

from dataclasses import dataclass, replace

import numpy as np

from machine.chain import chain_of
from machine.description import Machine
from machine.kinematics import tcp_pose
from machine.poses import pose
from server.motion.contracts import Array, PathPlan, Wall
from server.motion.joint_path import joint_path_along, straight_poses
from server.motion.point_to_point import cartesian_leg, joint_leg, path_end, plan_of
from server.motion.refusal import Refusal, refused_plan, require_goal, require_joints
from server.motion.settings import DEFAULT_PLAN_SETTINGS, PlanSettings

SAME_POSTURE_RAD = 1e-5
# Enough to break each joint's stiction, and more than its gears' play: slew 2 mrad, wrists 0.3 deg peak to peak.
_PLAY_RAD: tuple[float, ...] = tuple(np.deg2rad([0.8, 0.4, 0.4, 0.6, 0.6, 0.6]).tolist())


@dataclass(frozen=True, slots=True)
class ApproachSettings:
    """The last leg: by how much each joint approaches from below (0: it does not matter), and how slowly."""

    play_rad: tuple[float, ...] = _PLAY_RAD
    last_leg_s: float = 2.0


DEFAULT_APPROACH = ApproachSettings()


def play_of(n: int, approach: ApproachSettings = DEFAULT_APPROACH) -> Array:
    """From how far below each of n joints comes (n,) [rad]; joints beyond the settings' list come like its last."""
    return np.array((*approach.play_rad, *(approach.play_rad[-1],) * n)[:n])


def plan_approach(
    machine: Machine,
    q_start: Array,
    T_base_tcp_goal: Array,
    settings: PlanSettings = DEFAULT_PLAN_SETTINGS,
    wall: Wall | None = None,
    approach: ApproachSettings = DEFAULT_APPROACH,
    q_goal: Array | None = None,
) -> PathPlan:
    """Straight move to just before the goal, then a slow last leg in which every joint with backlash turns forward.

    Model:   q_pre = q_goal - play; line to the pose of q_pre, then joints straight to q_goal: gear flanks lie the same
             way after every move, so their play is a constant that looking sees and the next step removes.
    Args:    as `plan_move`; approach: play per joint [rad]; q_goal: the joints of the goal (n,) [rad] where they are
             known already; without them, or where the straight line ends in another posture, they are traced.
    Returns: the plan of both legs, or the status and reason of the one that is not possible.
    Raises:  MotionInputError: shapes, values that are not finite, not a pose.
    """
    chain = chain_of(machine)
    q = require_joints(q_start, chain.n, "q_start")
    goal = require_goal(T_base_tcp_goal, "T_base_tcp_goal")
    if q_goal is not None:
        q_end = require_joints(q_goal, chain.n, "q_goal")
    else:
        direct = joint_path_along(machine, chain, q, straight_poses(tcp_pose(chain, q), goal, settings), settings)
        if isinstance(direct, Refusal):
            return refused_plan(direct, q, np.array([tcp_pose(chain, q), goal]))
        q_end = direct.qs[-1]
    q_pre = q_end - play_of(chain.n, approach)
    first = cartesian_leg(machine, chain, q, tcp_pose(chain, q_pre), settings, wall)
    if q_goal is not None and (isinstance(first, Refusal) or np.abs(path_end(first) - q_pre).max() > SAME_POSTURE_RAD):
        return plan_approach(machine, q_start, T_base_tcp_goal, settings, wall, approach)
    if isinstance(first, Refusal):
        return refused_plan(first, q, np.array([tcp_pose(chain, q), goal]))
    last = joint_leg(
        machine, chain, path_end(first), q_end, _slow_approach_settings(settings, approach.last_leg_s), wall
    )
    if isinstance(last, Refusal):
        return refused_plan(last, q, np.array([tcp_pose(chain, q), goal]))
    return plan_of([first, last])


def _slow_approach_settings(settings: PlanSettings, duration_s: float) -> PlanSettings:
    """Slow and never leading: a shaped reference overshoots its end, which would turn a flank back."""
    return replace(settings, duration_min_s=max(duration_s, settings.duration_min_s), shape_reference=False)


def offset_goal(T_base_tcp: Array, offset_tcp_m: Array) -> Array:
    """Pose (4, 4) shifted along its own axes by (3,) [m], such as a retract of 0.2 m along z_tcp."""
    T = require_goal(T_base_tcp, "T_base_tcp")
    return pose(T[:3, :3], T[:3, 3] + T[:3, :3] @ np.asarray(offset_tcp_m, dtype=float))
