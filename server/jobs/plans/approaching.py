"""Approach: a goal that is farther away than a calibration holds is come nearer to first."""

from collections.abc import Generator

import numpy as np

from machine.poses import pose
from machine.rotations import Array
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.jobs.plans.diagnosed import goal_from_look
from server.jobs.plans.driving import drive_and_correct
from server.jobs.plans.looking import good_look, mount_rotation
from server.jobs.plans.planning import plan_to
from server.jobs.plans.tolerance import error_of
from server.jobs.records import MoveRecord
from server.jobs.requests import Progress, Record, Request

LEFT_FRAC = 0.5  # of the calibration's radius that the approach leaves: room for what mount and look are wrong by


def approach(ctx: PlanContext, taken: LookTaken) -> Generator[Request, object, LookTaken]:
    """Drive towards the goal until a calibration made there holds at the goal. Returns the last look."""
    T_approach, before = approach_pose(ctx, taken), taken
    if T_approach is None:
        return taken
    yield Progress("approach", 0.0, 1.0, "", "coming nearer: the goal is farther away than a calibration holds")
    plan = plan_to(ctx, taken.reading, T_approach)
    trims = yield from drive_and_correct(ctx, plan, "approach", trims_max=0)  # a look from there decides
    taken = yield from good_look(ctx)
    record = MoveRecord(
        number=1,
        kind="approach",
        before=error_of(before),
        after=taken.error,
        predicted_sigma_mm=(0.0, 0.0, 0.0),
        length_mm=plan.length_m * 1e3,
        duration_s=plan.duration_s,
        trims=trims,
        t_rest_plc_ns=taken.record.t_plc_ns,
    )
    ctx.knowledge.moves.append(record)
    yield Record(record)
    return taken


def approach_pose(ctx: PlanContext, taken: LookTaken) -> Array | None:
    """T_base_tcp (4, 4) on the straight way to the goal; None where a calibration made here holds at the goal."""
    if ctx.method == "paper":
        return None
    T_goal = goal_pose(ctx, taken)
    p_now = ctx.tcp(taken.reading.q_rad)[:3, 3]
    way = T_goal[:3, 3] - p_now
    distance_m, radius_m = float(np.linalg.norm(way)), ctx.settings.calibration.expiry().radius_m
    two_sigma = 2.0 * float(np.deg2rad(ctx.settings.position.sigma_tool_mount_deg))
    if distance_m * (1.0 + two_sigma) < radius_m:
        return None
    return pose(T_goal[:3, :3], p_now + way * (1.0 - LEFT_FRAC * radius_m / distance_m))


def goal_pose(ctx: PlanContext, taken: LookTaken) -> Array:
    """T_base_tcp (4, 4) of the goal, as far as this look and what is known of the mount state."""
    look = taken.look
    if look.T_cam_tool is None or look.T_cam_ooi is None:
        raise JobFailedError("no poses in the look; look again", "look_rejected")
    return goal_from_look(ctx, taken.reading.q_rad, mount_rotation(ctx, taken), look.T_cam_tool, look.T_cam_ooi)
