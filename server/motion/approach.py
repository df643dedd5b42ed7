"""Approach from one side, so that backlash lies the same way; and the small trim after a stall in the dead band."""

from dataclasses import dataclass, replace

import numpy as np

from machine.chain import Chain, chain_of
from machine.description import Machine
from machine.kinematics import tcp_pose, tcp_poses
from machine.poses import pose
from server.motion.contracts import Array, PathPlan, PlanStatus, Wall
from server.motion.joint_path import straight_poses, trace
from server.motion.point_to_point import Leg, cartesian_leg, joint_leg, path_end, plan_of
from server.motion.refusal import Refusal, refused_plan, require_goal, require_joints
from server.motion.settings import DEFAULT_PLAN_SETTINGS, PlanSettings

_SLEW_PLAY_RAD = 0.003  # covers a slew backlash of 2 mrad peak to peak
_WRIST_PLAY_RAD = float(np.deg2rad(0.4))  # covers a wrist backlash of 0.3 deg peak to peak


@dataclass(frozen=True, slots=True)
class ApproachSettings:
    """The last leg: by how much each joint comes from below (0: it does not matter), and how slowly."""

    play_rad: tuple[float, ...] = (_SLEW_PLAY_RAD, 0.0, 0.0, _WRIST_PLAY_RAD, _WRIST_PLAY_RAD, _WRIST_PLAY_RAD)
    last_leg_s: float = 1.5


@dataclass(frozen=True, slots=True)
class TrimSettings:
    """What a trim may do, and from when on it is worth doing."""

    residual_max_rad: float = float(np.deg2rad(3.0))
    residual_min_rad: float = float(np.deg2rad(0.002))  # 0.15 mm at 4 m, one step of an 18 bit encoder
    stall_max_rad: float = float(np.deg2rad(1.5))  # a larger offset at rest is no dead band
    leg_s: float = 1.0


DEFAULT_APPROACH = ApproachSettings()
DEFAULT_TRIM = TrimSettings()


def _play(chain: Chain, approach: ApproachSettings) -> Array:
    play = np.array(approach.play_rad, dtype=float)
    return play if len(play) == chain.n else np.zeros(chain.n)


def plan_approach(
    machine: Machine,
    q_start: Array,
    T_base_tcp_goal: Array,
    settings: PlanSettings = DEFAULT_PLAN_SETTINGS,
    wall: Wall | None = None,
    approach: ApproachSettings = DEFAULT_APPROACH,
) -> PathPlan:
    """Straight move to just before the goal, then a slow last leg in which every joint with backlash turns forward.

    Model:   q_pre = q_goal - play; line to the pose of q_pre, then joints straight to q_goal: gear flanks lie the same
             way after every move, so their play is a constant that looking sees and the next step removes.
    Args:    as `plan_move`; approach: play per joint [rad].
    Returns: the plan of both legs, or the status and reason of the one that is not possible.
    Raises:  MotionInputError: shapes, values that are not finite, not a pose.
    """
    chain = chain_of(machine)
    q = require_joints(q_start, chain.n, "q_start")
    goal = require_goal(T_base_tcp_goal, "T_base_tcp_goal")
    direct = trace(machine, chain, q, straight_poses(tcp_pose(chain, q), goal, settings), settings)
    if isinstance(direct, Refusal):
        return refused_plan(direct, q, np.array([tcp_pose(chain, q), goal]))
    q_goal = direct.qs[-1]
    T_pre = tcp_pose(chain, q_goal - _play(chain, approach))
    first = cartesian_leg(machine, chain, q, T_pre, settings, wall)
    if isinstance(first, Refusal):
        return refused_plan(first, q, np.array([tcp_pose(chain, q), goal]))
    last = joint_leg(machine, chain, path_end(first), q_goal, _creeping(settings, approach.last_leg_s), wall)
    if isinstance(last, Refusal):
        return refused_plan(last, q, np.array([tcp_pose(chain, q), goal]))
    return plan_of([first, last])


def _creeping(settings: PlanSettings, duration_s: float) -> PlanSettings:
    """Slow and never leading: a shaped reference overshoots its end, which would turn a flank back."""
    return replace(settings, duration_min_s=max(duration_s, settings.duration_min_s), shape_reference=False)


def trim_reference(
    machine: Machine,
    q_ref_end: Array,
    q_encoder_residual: Array,
    settings: PlanSettings = DEFAULT_PLAN_SETTINGS,
    trim: TrimSettings = DEFAULT_TRIM,
    approach: ApproachSettings = DEFAULT_APPROACH,
    q_encoder: Array | None = None,
) -> PathPlan:
    """Small move of the reference by what the encoders still lack: undoes the stall db / K in the valve's dead band.

    Model:   a joint at rest stalls where |q_ref - q| = e, on the side it came from. To end on q_wanted coming with sign
             s: q_ref = q_wanted + s e, with e = |q_ref - q_encoder| as it stalls now (0 when the encoder is not given:
             then q_ref += residual, which a reversal makes too short, and the next trim goes on).
             A joint with backlash that must go back goes its play further, then comes forward again.
             Residuals below the smallest one worth a trim are left alone.
    Args:    q_ref_end: present reference (joints,) [rad]; q_encoder_residual: wanted minus encoder (joints,) [rad];
             q_encoder: where the joints rest (joints,) [rad], or None.
    Returns: a plan of about 1 s (2 s with a joint coming back from below); INVALID with reason when a residual is too
             large.
    Raises:  MotionInputError: shapes or values that are not finite.
    """
    chain = chain_of(machine)
    q = require_joints(q_ref_end, chain.n, "q_ref_end")
    residual = require_joints(q_encoder_residual, chain.n, "q_encoder_residual")
    worst = int(np.abs(residual).argmax())
    if abs(residual[worst]) > trim.residual_max_rad:
        text = (
            f"joint '{machine.joints[worst].name}' lacks {np.rad2deg(residual[worst]):.2f} deg, a trim may move "
            f"at most {np.rad2deg(trim.residual_max_rad):.1f} deg; check the joint: blocked, unpowered, badly tuned?"
        )
        return refused_plan(Refusal(PlanStatus.INVALID, text), q)
    targets = _trim_targets(q, residual, _play(chain, approach), trim, q_encoder)
    legs: list[Leg] = []
    for target in targets:
        start = path_end(legs[-1]) if legs else q
        leg = joint_leg(machine, chain, start, target, _creeping(settings, trim.leg_s), None)
        if isinstance(leg, Refusal):
            return refused_plan(leg, q, tcp_poses(chain, np.array(targets)))
        legs.append(leg)
    return plan_of(legs)


def _trim_targets(
    q_ref: Array, residual: Array, play: Array, trim: TrimSettings, q_encoder: Array | None
) -> list[Array]:
    """The references to go to, one after the other."""
    worth = np.abs(residual) >= trim.residual_min_rad
    offset = np.zeros(len(q_ref)) if q_encoder is None else q_ref - np.asarray(q_encoder, dtype=float)
    stall = np.minimum(np.abs(offset), trim.stall_max_rad)
    straight = q_ref + residual - offset + np.sign(residual) * stall
    turns = worth & (residual < 0.0) & (play > 0.0)
    below = np.where(turns, straight - play, q_ref)
    forward = np.where(turns, q_ref + residual - offset + stall, np.where(worth, straight, q_ref))
    return [below, forward] if turns.any() else [forward]


def offset_goal(T_base_tcp: Array, offset_tcp_m: Array) -> Array:
    """Pose (4, 4) shifted along its own axes by (3,) [m], such as a retract of 0.2 m along z_tcp."""
    T = require_goal(T_base_tcp, "T_base_tcp")
    return pose(T[:3, :3], T[:3, 3] + T[:3, :3] @ np.asarray(offset_tcp_m, dtype=float))
