"""Approach: a goal that is farther away than a calibration holds is come nearer to first."""

from collections.abc import Generator

import numpy as np

from machine.poses import pose
from machine.rotations import Array
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.jobs.plans.diagnosed import goal_from_look
from server.jobs.plans.driving import drive_and_look
from server.jobs.plans.looking import mount_rotation
from server.jobs.requests import Progress, Request

# Of the calibration's radius that the approach leaves: room for what mount and look are wrong by
APPROACH_LEFT_RADIUS_FRAC = 0.5


def approach(ctx: PlanContext, taken: LookTaken) -> Generator[Request, object, LookTaken]:
    """Drive towards the goal until a calibration made there holds at the goal. Returns the last look."""
    T_approach = approach_pose(ctx, taken)
    if T_approach is None:
        return taken
    yield Progress("approach", 0.0, 1.0, "", "coming nearer: the goal is farther away than a calibration holds")
    return (
        yield from drive_and_look(ctx, taken, T_approach, "approach", 1, "approach", 0)
    )  # a look from there decides


def approach_pose(ctx: PlanContext, taken: LookTaken) -> Array | None:
    """T_base_tcp (4, 4) on the straight way to the goal; None where a calibration made here holds at the goal."""
    if ctx.method == "paper":
        return None
    T_goal = goal_pose(ctx, taken)
    p_now = ctx.tcp(taken.reading.q_rad)[:3, 3]
    radius_m = ctx.settings.calibration.expiry().radius_m
    if np.linalg.norm(farther_goal(ctx, taken, T_goal)[:3, 3] - p_now) < radius_m:
        return None
    way = T_goal[:3, 3] - p_now
    return pose(T_goal[:3, :3], p_now + way * (1.0 - APPROACH_LEFT_RADIUS_FRAC * radius_m / float(np.linalg.norm(way))))


def farther_goal(ctx: PlanContext, taken: LookTaken, T_goal: Array) -> Array:
    """The goal a little farther away: the calibration will correct the mount, which moves the end of a long way."""
    T_now = ctx.tcp(taken.reading.q_rad)
    away = T_goal[:3, 3] - T_now[:3, 3]
    share = 2.0 * float(np.deg2rad(ctx.settings.position.sigma_tool_mount_deg))  # two sigma of the mount, over the way
    return pose(T_goal[:3, :3], T_goal[:3, 3] + share * away)


def goal_pose(ctx: PlanContext, taken: LookTaken) -> Array:
    """T_base_tcp (4, 4) of the goal, as far as this look and what is known of the mount state."""
    look = taken.look
    if look.T_cam_tool is None or look.T_cam_ooi is None:
        raise JobFailedError("no poses in the look; look again", "look_rejected")
    return goal_from_look(ctx, taken.reading.q_rad, mount_rotation(ctx, taken), look.T_cam_tool, look.T_cam_ooi)
