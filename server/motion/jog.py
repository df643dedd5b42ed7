"""Jog: the longest admissible path along one joint or one axis of the tool, slowly, for a button that is held."""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from machine.chain import Chain, chain_of
from machine.description import Machine
from machine.kinematics import tcp_jacobian, tcp_pose
from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from server.motion.contracts import Array, PathPlan, PlanStatus, Wall
from server.motion.point_to_point import PathLeg, cartesian_leg, joint_leg, plan_of
from server.motion.refusal import Refusal, refused_plan, require_joints
from server.motion.settings import PlanSettings

# fmt: off
JogAxis = Literal[
    "joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6", "joint_7", "joint_8",
    "x", "y", "z", "rx", "ry", "rz",
]
# fmt: on
TOOL_AXES: tuple[JogAxis, ...] = ("x", "y", "z", "rx", "ry", "rz")
PRESS_DURATION_MAX_S = 30.0  # of even speed in one press: a button that is stuck does not move the machine for ever
RESOLUTION_M, RESOLUTION_RAD = 1e-3, 5e-4  # where the path is cut at what limits it; a shorter path is refused


@dataclass(frozen=True, slots=True)
class JogSpeed:
    """Speed of the tcp [m/s], and of a joint and of the tool's turn [rad/s]; both hold in every jog."""

    tcp_m_s: float
    turn_rad_s: float


@dataclass(frozen=True, slots=True)
class JogPlan:
    """The path, or the reason for a refusal; `ends_by`: what limits it, empty when only one press's length does."""

    path: PathPlan
    ends_by: str


def jog_axes(n_joints: int) -> tuple[JogAxis, ...]:
    """What a machine of that many joints can jog; the axes of the tool only where six joints hold its pose."""
    joints = tuple(axis for axis in get_args(JogAxis) if axis.startswith("joint_"))[:n_joints]
    return (*joints, *TOOL_AXES) if n_joints >= 6 else joints


def plan_jog(
    machine: Machine,
    q_start: Array,
    axis: JogAxis,
    direction: Literal[-1, 1],
    speed: JogSpeed,
    settings: PlanSettings,
    wall: Wall | None = None,
) -> JogPlan:
    """The longest path in one direction that joint ranges, wall and singularity allow, at most one press long.

    Model:   a joint alone, or the tcp straight along (x, y, z) or about (rx, ry, rz) an axis of its own frame. A path
             that is refused is refused at every greater length, so the greatest admissible one is found by bisection.
             A joint alone may pass a singularity: that is how one is left.
    Args:    q_start: joints (n,) [rad]; direction: +1 or -1.
    Returns: the plan, with the speed as its limit and even between two ramps.
    Raises:  MotionInputError: the shape of q_start, or an axis that this machine does not have.
    """
    chain = chain_of(machine)
    q = require_joints(q_start, chain.n, "q_start")
    if axis not in jog_axes(chain.n):
        text = f"machine '{machine.name}' has no jog axis '{axis}'; choose from {', '.join(jog_axes(chain.n))}"
        return JogPlan(refused_plan(Refusal(PlanStatus.INVALID, text), q, tcp_pose(chain, q)[None]), text)
    slow, slowly = _limit_to_jog_speed(machine, speed, settings)
    travel, resolution = _travel_and_resolution(chain, q, axis, speed)

    def leg(length: float) -> PathLeg | Refusal:
        if axis.startswith("joint_"):
            q_end = q.copy()
            q_end[_joint_index(axis)] += direction * length
            return joint_leg(slow, chain, q, q_end, slowly, wall)
        return cartesian_leg(
            slow, chain, q, tcp_pose(chain, q) @ _displaced_tcp_pose(axis, direction * length), slowly, wall
        )

    longest = leg(travel)
    if not isinstance(longest, Refusal):
        return JogPlan(plan_of([longest]), "")
    refusal, low, high = longest, 0.0, travel
    found: PathLeg | None = None
    while high - low > resolution:
        middle = 0.5 * (low + high)
        tried = leg(middle)
        if isinstance(tried, Refusal):
            refusal, high = tried, middle
        else:
            found, low = tried, middle
    if found is None:
        return JogPlan(refused_plan(refusal, q, tcp_pose(chain, q)[None]), refusal.reason)
    return JogPlan(plan_of([found]), refusal.reason)


def _joint_index(axis: JogAxis) -> int:
    return int(axis.removeprefix("joint_")) - 1


def _displaced_tcp_pose(axis: JogAxis, amount: float) -> Array:
    """T_tcp_moved (4, 4): the tool moved along [m] or turned about [rad] an axis of its own frame."""
    vector = amount * np.eye(3)["xyz".index(axis[-1])]
    return pose(rotation_from_rotvec(vector), np.zeros(3)) if axis.startswith("r") else pose(np.eye(3), vector)


def _travel_and_resolution(chain: Chain, q: Array, axis: JogAxis, speed: JogSpeed) -> tuple[float, float]:
    """Length of one press at even speed, and the resolution of its end, [rad] or [m]."""
    if axis in ("x", "y", "z"):
        return speed.tcp_m_s * PRESS_DURATION_MAX_S, RESOLUTION_M
    if axis.startswith("r"):
        return speed.turn_rad_s * PRESS_DURATION_MAX_S, RESOLUTION_RAD
    lever_m = float(
        np.linalg.norm(tcp_jacobian(chain, q)[:3, _joint_index(axis)])
    )  # constant while this joint moves alone
    return min(speed.turn_rad_s, speed.tcp_m_s / max(lever_m, 1e-9)) * PRESS_DURATION_MAX_S, RESOLUTION_RAD


def _limit_to_jog_speed(machine: Machine, speed: JogSpeed, settings: PlanSettings) -> tuple[Machine, PlanSettings]:
    """The machine with the jog's speeds as its limits, where its own are not lower, and settings that use all of them.

    A plan uses a share of the machine's limits; here the share times the limit is the jog's speed.
    """
    share = settings.limit_share
    turn, tcp = speed.turn_rad_s / share, speed.tcp_m_s / share
    joints = tuple(replace(joint, qd_max_rad_s=min(joint.qd_max_rad_s, turn)) for joint in machine.joints)
    slowly = replace(
        settings, turn_speed_max_rad_s=speed.turn_rad_s, reference_tcp_share=share * settings.reference_tcp_share
    )
    return replace(machine, joints=joints, tcp_speed_max_m_s=min(machine.tcp_speed_max_m_s, tcp)), slowly
