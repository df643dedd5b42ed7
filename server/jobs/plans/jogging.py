"""Jog: slow motion of one joint or one axis of the tool for as long as a button is held, at most to what limits it."""

from collections.abc import Generator
from dataclasses import replace
from typing import Literal

import numpy as np

from server.jobs.context import PlanContext
from server.jobs.plans.driving import execute_plan
from server.jobs.plans.planning import onto_reference, plan_settings
from server.jobs.requests import MachineReading, Progress, Request, Settle, expect_reply
from server.motion.contracts import Wall
from server.motion.jog import JogAxis, JogSpeed, plan_jog
from server.motion.wall_clearance import stall_reach


def jog(ctx: PlanContext, axis: JogAxis, direction: Literal[-1, 1]) -> Generator[Request, object, str]:
    """Drive to the end of the longest admissible path; the button that comes up stops it on the way.

    Raises: JobFailedError: a joint range, the wall or a singularity leaves no path in this direction.
    """
    slow = ctx.settings.jog
    speed = JogSpeed(slow.speed_mm_s * 1e-3, float(np.deg2rad(slow.turn_speed_deg_s)))
    reading = expect_reply((yield Settle()), MachineReading)
    wall = _wall_of_reference(ctx, reading)
    planned = plan_jog(ctx.machine, reading.q_rad, axis, direction, speed, plan_settings(ctx), wall)
    purpose = f"jog {axis} {'+' if direction > 0 else '-'}"
    if planned.ends_by:
        yield Progress("jog_limit", 0.0, 0.0, "", f"{purpose} ends at a limit: {planned.ends_by}")
    yield from execute_plan(ctx, onto_reference(ctx, planned.path, reading), purpose)
    yield Settle()
    return planned.ends_by or "the longest distance of one press"


def _wall_of_reference(ctx: PlanContext, reading: MachineReading) -> Wall | None:
    """The wall with a clearance greater by what the joints may rest off the path: a jog is often driven towards it."""
    if ctx.wall is None:
        return None
    nearer_m = float(stall_reach(ctx.chain, reading.q_rad[None], ctx.stall, ctx.wall)[0])
    return replace(ctx.wall, clearance_min_m=ctx.wall.clearance_min_m + nearer_m)
