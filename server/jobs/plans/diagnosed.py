"""Where plans ask the diagnosed machine in place of the nominal one, if the settings name one."""

from dataclasses import replace

import numpy as np

from machine.rotations import Array
from server.calibration.contracts import EncoderTrack, MountRotation
from server.calibration.play import play_sides
from server.calibration.reference import reference_from_look
from server.compensation.compensation import CompensationError
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.jobs.plans.learning import play_width, side_at_goal, side_now
from server.jobs.records import ComparedMove

SIGMA_MOUNT_RAD = float(np.deg2rad(0.3))  # of a diagnosed camera mount


def goal_from_look(ctx: PlanContext, q_rad: Array, R_tcp_cam: Array, T_cam_tool: Array, T_cam_ooi: Array) -> Array:
    """The nominal pose to plan for, from a look taken with the encoders at q_rad (n,).

    Model:  the step from the look is taken on the diagnosed machine; the planner gets the nominal pose of the joints at
            which that machine stands at the goal, coming from below. Without a compensation both are nominal.
    Raises: JobFailedError: the diagnosed machine does not reach the goal.
    """
    known = ctx.compensation
    T_base_tcp = ctx.tcp(q_rad) if known is None else known.tcp_poses(q_rad[None], side_now(ctx))[0]
    T_goal = reference_from_look(T_base_tcp, R_tcp_cam, ctx.machine.T_tcp_tool, T_cam_tool, T_cam_ooi, ctx.T_ooi_goal)
    if known is None:
        return T_goal
    try:
        return known.nominal_goal(ctx.chain, q_rad, T_goal, side_at_goal(ctx))
    except CompensationError as error:
        raise JobFailedError(f"preview: {error}", "plan_out_of_reach") from error


def compared_move(ctx: PlanContext, number: int, before: LookTaken, after: LookTaken) -> ComparedMove | None:
    """How far a move by the first look and kinematics alone would have missed, as the second look shows it.

    Model:  both looks place the object in the base; what its two places differ by is what the kinematics between the
            two are wrong by, as the tool would have missed. By the machine file with the mount from the tool marker,
            and by what is in use.
    Returns: None where a look has no poses.
    """
    nominal = _apart_mm(replace(ctx, compensation=None), before, after)
    if nominal is None:
        return None
    used = None if ctx.compensation is None else _apart_mm(ctx, before, after)
    return ComparedMove(number, nominal, used, ctx.version_id)


def _apart_mm(ctx: PlanContext, before: LookTaken, after: LookTaken) -> float | None:
    places = [_object_place(ctx, taken) for taken in (before, after)]
    if places[0] is None or places[1] is None:
        return None
    return round(1e3 * float(np.linalg.norm(places[1] - places[0])), 2)


def _object_place(ctx: PlanContext, taken: LookTaken) -> Array | None:
    """The object's origin in the base (3,) by one look, without any calibration."""
    look, known = taken.raw, ctx.compensation
    if look.T_cam_tool is None or look.T_cam_ooi is None:
        return None
    side = np.zeros(ctx.chain.n) if taken.reading.side is None else taken.reading.side
    T_base_tcp = ctx.tcp(taken.reading.q_rad) if known is None else known.tcp_poses(taken.reading.q_rad[None], side)[0]
    R_tcp_cam = ctx.machine.T_tcp_tool[:3, :3] @ look.T_cam_tool[:3, :3].T
    if known is not None and known.knows_mount:
        R_tcp_cam = known.T_tcp_cam[:3, :3]
    p_base_tool = (T_base_tcp @ ctx.machine.T_tcp_tool)[:3, 3]
    return p_base_tool + T_base_tcp[:3, :3] @ R_tcp_cam @ (look.T_cam_ooi[:3, 3] - look.T_cam_tool[:3, 3])


def believed_track(ctx: PlanContext, encoder: EncoderTrack, before: Array) -> EncoderTrack:
    """The TCP's way by the diagnosed machine; `before`: sides in the play when it began (n,)."""
    if ctx.compensation is None or encoder.qs is None or len(encoder.qs) == 0:
        return encoder
    sides = play_sides(encoder.qs, play_width(ctx), before)
    return replace(encoder, Ts_base_tcp=ctx.compensation.tcp_poses(encoder.qs, sides))


def diagnosed_mount(ctx: PlanContext) -> MountRotation | None:
    """The camera's rotation as diagnosed; None where it was not."""
    if ctx.compensation is None or not ctx.compensation.knows_mount:
        return None
    return MountRotation(ctx.compensation.T_tcp_cam[:3, :3], SIGMA_MOUNT_RAD**2 * np.eye(3))
