"""From a wanted TCP pose to a checked path of the reference, seen from where encoders and reference stand now."""

from dataclasses import replace

import numpy as np

from machine.rotations import Array
from server.jobs.context import PlanContext
from server.jobs.requests import MachineReading
from server.motion.approach import plan_approach
from server.motion.contracts import PathPlan
from server.motion.point_to_point import plan_move
from server.motion.settings import DEFAULT_PLAN_SETTINGS, PAPER_PLAN_SETTINGS, PlanSettings


def plan_to(ctx: PlanContext, reading: MachineReading, T_base_tcp_goal: Array, one_sided: bool = True) -> PathPlan:
    """Path from the encoders' pose to the goal, laid onto the reference.

    The reference stands off the encoders by the static stall; keeping that difference along the path makes the
    joints end at the same side of their dead band.
    """
    if one_sided and ctx.method == "ours":
        plan = plan_approach(ctx.machine, reading.q_rad, T_base_tcp_goal, plan_settings(ctx), ctx.wall)
    else:
        plan = plan_move(ctx.machine, reading.q_rad, T_base_tcp_goal, plan_settings(ctx), ctx.wall)
    return onto_reference(plan, reading)


def plan_settings(ctx: PlanContext) -> PlanSettings:
    """Shaped references for ours, the plain quintic for the paper's method."""
    return PAPER_PLAN_SETTINGS if ctx.method == "paper" else DEFAULT_PLAN_SETTINGS


def onto_reference(plan: PathPlan, reading: MachineReading) -> PathPlan:
    """The same path, shifted so that its first knot is the present reference exactly."""
    if plan.trajectory is None:
        return plan
    q = plan.trajectory.q + (reading.q_ref_rad - plan.trajectory.q[0])
    q[0] = reading.q_ref_rad
    return replace(plan, trajectory=replace(plan.trajectory, q=np.ascontiguousarray(q)))
