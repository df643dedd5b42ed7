"""The path of the closed loop while it is driven: where the goal is seen, and the new tail that leads there."""

from dataclasses import dataclass

import numpy as np

from machine.inverse import inverse_nearest
from machine.rotations import Array
from server.calibration.reference import reference_from_look
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.jobs.plans.looking import mount_rotation
from server.jobs.plans.pair_gate import PairGate
from server.jobs.plans.seeing import corrected_poses
from server.jobs.requests import Correct, MachineReading, NextPair, PairSeen
from server.motion.closed_loop import JOIN_LEAD_TIME_S, TailStart, join_after, path_to_rest, reference_goal, with_tail
from server.motion.contracts import JointTrajectory, PlanStatus
from server.motion.joint_path import joint_line
from server.motion.refusal import Refusal
from server.motion.seen_goal import SeenGoal
from server.motion.settings import DEFAULT_PLAN_SETTINGS
from server.motion.wall_clearance import wall_refusal

TURN_MAX_RAD = DEFAULT_PLAN_SETTINGS.jump_max_rad  # of any joint: more for a way this short is a change of branch
CORRECTION_MIN_M = 0.0003  # the goal moved by less: not worth a new tail


@dataclass(slots=True)
class SteeredPath:
    """The path under way and what is known while it is."""

    seen_goal: SeenGoal
    T_aimed: Array
    current_trajectory: JointTrajectory
    start_reading: MachineReading  # where it began
    corrections_enabled: bool
    offered_trajectory: JointTrajectory | None = None
    T_offered: Array | None = None
    n_pairs: int = 0
    n_corrections: int = 0
    n_refused: int = 0


def off_goal(ctx: PlanContext, steered: SteeredPath, seen: PairSeen) -> str:
    """Take a good pair in; or why its goal cannot be believed."""
    T_goal, sigma_m, way_m = _goal_seen(ctx, seen)
    apart_m, most_m = steered.seen_goal.jump_and_limit(T_goal, sigma_m, way_m)
    if apart_m > most_m:
        return (
            f"the goal jumped by {1e3 * apart_m:.1f} mm (limit {1e3 * most_m:.1f} mm, "
            f"{1e3 * way_m:.0f} mm before it); look whether target or camera moved, then look and calibrate again"
        )
    steered.seen_goal.add(T_goal, sigma_m, way_m)
    steered.n_pairs += 1
    return ""


def note_tail(steered: SteeredPath, seen: PairSeen) -> None:
    """What the PLC answered to the last new tail."""
    if seen.tail_status == "taken" and steered.offered_trajectory is not None and steered.T_offered is not None:
        steered.current_trajectory, steered.T_aimed = steered.offered_trajectory, steered.T_offered
        steered.n_corrections += 1
    if seen.tail_status == "refused":
        steered.n_refused += 1
    if seen.tail_status in ("taken", "refused"):
        steered.offered_trajectory = steered.T_offered = None


def corrected_tail(ctx: PlanContext, steered: SteeredPath, seen: PairSeen) -> Correct | None:
    """A new tail to where the goal is seen now; None while one is on its way, near the end, or not worth it."""
    if not steered.corrections_enabled:
        return None
    T_goal = steered.seen_goal.pose
    shift_m = float(np.linalg.norm(T_goal[:3, 3] - steered.T_aimed[:3, 3]))
    if (
        seen.t_play_s <= 0.0
        or steered.offered_trajectory is not None
        or shift_m < CORRECTION_MIN_M
        or seen.q_rad is None
    ):
        return None  # not before it plays: a tail sent while the PLC still fills its ring keeps it from starting
    join = join_after(steered.current_trajectory, seen.t_play_s)
    if join is None:
        return None
    left_s = steered.current_trajectory.duration_s - join.t_s
    tail = path_onto_reference(
        ctx, join, steered.start_reading, joints_near(ctx, T_goal, seen.q_rad), max(left_s, JOIN_LEAD_TIME_S)
    )
    if isinstance(tail, Refusal):  # the path under way stays as good as it was
        return None
    steered.offered_trajectory, steered.T_offered = with_tail(steered.current_trajectory, join.first_knot, tail), T_goal
    return Correct(tail, join.first_knot)


def path_onto_reference(
    ctx: PlanContext, start: TailStart, reading: MachineReading, q_goal: Array, duration_s: float
) -> JointTrajectory | Refusal:
    """Knots to where the encoders rest at q_goal, laid onto the reference; a Refusal when it cannot be.

    The wall is asked on the joints' own way, too: they rest a stall away from the reference, and may be nearer.
    """
    turned_rad = float(np.abs(q_goal - reading.q_rad).max())
    if turned_rad > TURN_MAX_RAD:
        text = (
            f"a joint would turn by {np.rad2deg(turned_rad):.0f} deg for a few centimetres (limit "
            f"{np.rad2deg(TURN_MAX_RAD):.0f} deg): too near to a singularity; move there by an ordinary move"
        )
        return Refusal(PlanStatus.SINGULAR, text)
    way = joint_line(ctx.chain, reading.q_rad, q_goal)
    _, hit = wall_refusal(way.Ts_base_tcp, ctx.machine.T_tcp_tool, ctx.wall)
    if hit is not None:
        return hit
    q_ref = reference_goal(q_goal, reading.q_rad, reading.q_ref_rad, ctx.stall)
    speed_m_s = ctx.settings.closed_loop.speed_max_mm_s * 1e-3
    return path_to_rest(ctx.machine, ctx.chain, start, q_ref, speed_m_s, duration_s, ctx.wall)


def joints_near(ctx: PlanContext, T_goal: Array, q_near: Array) -> Array:
    """Joints (n,) [rad] at a TCP goal, on the branch of q_near. Raises: JobFailedError: out of reach."""
    found = inverse_nearest(ctx.chain, T_goal, q_near)
    if found.q_rad is None:
        raise JobFailedError(f"closed loop: {found.reason}", "plan_out_of_reach")
    return found.q_rad


def goal_of(ctx: PlanContext, taken: LookTaken, q_rad: Array, T_cam_tool: Array, T_cam_ooi: Array) -> Array:
    """T_base_tcp of the goal as a pair places it, in the space of the nominal kinematics."""
    R_tcp_cam = mount_rotation(ctx, taken)
    return reference_from_look(ctx.tcp(q_rad), R_tcp_cam, ctx.machine.T_tcp_tool, T_cam_tool, T_cam_ooi, ctx.T_ooi_goal)


def _goal_seen(ctx: PlanContext, seen: PairSeen) -> tuple[Array, float, float]:
    """Goal (4, 4) of a pair that passed the gate, its sigma and the way that was left then [m]."""
    taken = ctx.knowledge.last_look
    T_cam_tool = None if seen.tool is None else seen.tool.T_cam_object
    T_cam_ooi = None if seen.ooi is None else seen.ooi.T_cam_object
    if taken is None or T_cam_tool is None or T_cam_ooi is None or seen.q_rad is None:
        raise JobFailedError("a pair without poses came through the gate", "internal")
    T_goal = goal_of(ctx, taken, seen.q_rad, *corrected_poses(ctx, T_cam_tool, T_cam_ooi))
    way_m = float(np.linalg.norm(T_goal[:3, 3] - ctx.tcp(seen.q_rad)[:3, 3]))
    return T_goal, PairGate(ctx).sigma_m(seen), way_m


def next_pair_request(ctx: PlanContext, number: int) -> NextPair:
    """The request for the pair after a number, its exposure mapped as the calibration found the clocks."""
    known = ctx.knowledge
    state = None if known.joint_estimate is None else known.joint_estimate.state
    offset_s = (
        state.time_offset_s
        if state is not None
        else known.mount_rotation_estimate.time_offset_s
        if known.mount_rotation_estimate
        else 0.0
    )
    return NextPair(number, ctx.settings.closed_loop.silence_max_ms * 1e-3, offset_s)
