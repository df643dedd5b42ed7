"""Look: rest, robust mean over pairs, error to the goal, and where that puts the OOI."""

from collections.abc import Generator

import numpy as np

from machine.rotations import Array
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.jobs.plans.learning import remember_look, remember_side
from server.jobs.plans.living import watch_slip
from server.jobs.plans.seeing import common_of, corrected_look
from server.jobs.records import ErrorMm, LookRecord
from server.jobs.requests import MachineReading, Progress, Request, Settle, TakeLook, expect_reply
from server.vision.contracts import Look, LookStatus
from server.vision.goal_error import PoseError, error_to_goal


def take_look(ctx: PlanContext, pairs_share: int = 1) -> Generator[Request, object, LookTaken]:
    """Rest, then look, over `pairs_share` times the usual pairs. A failed look is in the record, not an error.

    A previewed plan ends here: what was measured since may speak against it.
    """
    reading = expect_reply((yield Settle()), MachineReading)
    remember_side(ctx, reading)
    yield Progress("look", 0.0, 1.0, "", "looking: tool and object of interest in both eyes")
    paper = ctx.method == "paper"
    pairs = 1 if paper else ctx.settings.look.pairs * pairs_share
    look = expect_reply((yield TakeLook(n_pairs=pairs, source="mono" if paper else "stereo")), Look)
    taken = _evaluated_look(ctx, look, reading)
    ctx.knowledge.last_look = taken
    ctx.knowledge.previewed_plan = None  # it was made from an older look
    if taken.error is not None:
        ctx.knowledge.T_base_ooi = ooi_in_base(ctx, taken)
        yield from watch_slip(ctx, taken)
        remember_look(ctx, taken)
    yield Progress("look", 1.0, 1.0, "", describe_look(taken))
    return taken


def good_look(ctx: PlanContext, pairs_share: int = 1) -> Generator[Request, object, LookTaken]:
    """A look that may be acted upon. Raises: JobFailedError with the look's own reason otherwise."""
    taken = yield from take_look(ctx, pairs_share)
    if taken.error is None:
        raise JobFailedError(
            f"look failed ({taken.record.status}): {taken.record.reason}", f"look_{taken.record.status}"
        )
    return taken


def mount_rotation(ctx: PlanContext, taken: LookTaken) -> Array:
    """R_tcp_cam: calibrated if we are, else as identified, else by the tool marker in the image, else nominal."""
    mount = ctx.knowledge.mount_rotation_estimate
    if mount is not None and mount.R_tcp_cam is not None:
        return mount.R_tcp_cam
    if ctx.method != "paper" and ctx.compensation is not None and ctx.compensation.knows_mount:
        return ctx.compensation.T_tcp_cam[:3, :3]
    if ctx.method == "paper" or taken.look.T_cam_tool is None:
        return ctx.machine.T_tcp_cam_left[:3, :3]
    return ctx.machine.T_tcp_tool[:3, :3] @ taken.look.T_cam_tool[:3, :3].T


def ooi_in_base(ctx: PlanContext, taken: LookTaken) -> Array:
    """T_base_ooi as this look and the nominal kinematics place it: the tool marker is the common point.

    Nominal with a version in use as well: paths are nominal, and the wall must be where they are.
    """
    look = taken.look
    if look.T_cam_tool is None or look.T_cam_ooi is None:
        raise JobFailedError("no poses in the look; look again", "look_rejected")
    T_base_tcp = ctx.tcp(taken.reading.q_rad)
    R_base_cam = T_base_tcp[:3, :3] @ mount_rotation(ctx, taken)
    p_base_tool = (T_base_tcp @ ctx.machine.T_tcp_tool)[:3, 3]
    T_base_ooi = np.eye(4)
    T_base_ooi[:3, :3] = R_base_cam @ look.T_cam_ooi[:3, :3]
    T_base_ooi[:3, 3] = p_base_tool + R_base_cam @ (look.T_cam_ooi[:3, 3] - look.T_cam_tool[:3, 3])
    return T_base_ooi


def against_goal(ctx: PlanContext, taken: LookTaken) -> LookTaken:
    """The same look, its error judged against the context's goal: after the operator has set another one."""
    return _evaluated_look(ctx, taken.raw, taken.reading)


def _evaluated_look(ctx: PlanContext, raw: Look, reading: MachineReading) -> LookTaken:
    look = corrected_look(ctx, raw)
    error = _goal_error_mm(ctx, look)
    record = LookRecord(
        status=look.status.value,
        reason=look.reason,
        error=error,
        n_used=look.n_used,
        spread_mm=look.spread_mm,
        t_plc_ns=reading.t_plc_ns,
        t_mono_ns=reading.t_mono_ns,
    )
    return LookTaken(look=look, reading=reading, error=error, record=record, raw=raw)


def _goal_error_mm(ctx: PlanContext, look: Look) -> ErrorMm | None:
    if look.status is not LookStatus.OK:
        return None
    if look.T_cam_tool is None or look.T_cam_ooi is None:
        return None
    error = error_to_goal(look, ctx.T_ooi_goal, common_of(ctx, look.T_cam_tool, look.T_cam_ooi))
    return error_in_mm(ctx, error, look.T_cam_tool, look.T_cam_ooi)


def error_in_mm(ctx: PlanContext, found: PoseError, T_cam_tool: Array, T_cam_ooi: Array) -> ErrorMm:
    """The error in the operator's units; what no other term holds (corners of one printing, rest) is added."""
    sigma_mm = np.hypot(found.sigma_position_m * 1e3, ctx.settings.position.sigma_systematic_mm)
    sigma_deg = np.hypot(np.rad2deg(found.sigma_angle_rad), ctx.settings.position.sigma_systematic_deg)
    x_mm, y_mm, z_mm = found.position_m * 1e3
    camera_mm = (T_cam_ooi[:3, 3] - T_cam_tool[:3, 3]) * 1e3
    return ErrorMm(
        x_mm=float(x_mm),
        y_mm=float(y_mm),
        z_mm=float(z_mm),
        rotation_deg=float(np.rad2deg(found.angle_rad)),
        sigma_x_mm=float(sigma_mm[0]),
        sigma_y_mm=float(sigma_mm[1]),
        sigma_z_mm=float(sigma_mm[2]),
        sigma_rotation_deg=float(sigma_deg),
        distance_mm=float(np.linalg.norm(found.position_m) * 1e3),
        camera_x_mm=float(camera_mm[0]),
        camera_y_mm=float(camera_mm[1]),
        camera_z_mm=float(camera_mm[2]),
    )


def describe_look(taken: LookTaken) -> str:
    """One line for the operator."""
    error = taken.error
    if error is None:
        return f"look {taken.record.status}: {taken.record.reason}"
    return (
        f"x {error.x_mm:+.1f}, y {error.y_mm:+.1f}, z {error.z_mm:+.1f} mm, rotation {error.rotation_deg:.2f} deg "
        f"({taken.record.n_used} pairs)"
    )
