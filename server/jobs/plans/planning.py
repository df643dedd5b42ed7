"""From a wanted TCP pose to a checked path of the reference, seen from where encoders and reference stand now."""

from dataclasses import replace

import numpy as np

from machine.rotations import Array
from server.jobs.context import PlanContext
from server.jobs.requests import MachineReading
from server.motion.approach import DEFAULT_APPROACH, plan_approach
from server.motion.contracts import PathPlan
from server.motion.lost_motion import first_stall
from server.motion.lost_motion import onto_reference as shifted
from server.motion.point_to_point import plan_move
from server.motion.settings import DEFAULT_PLAN_SETTINGS, PAPER_PLAN_SETTINGS, PlanSettings

LIMIT_SHARE = 0.8  # of the machine's limits: the rest is for taking the reference across the dead bands on the way


def plan_to(
    ctx: PlanContext,
    reading: MachineReading,
    T_base_tcp_goal: Array,
    one_sided: bool = True,
    q_goal: Array | None = None,
) -> PathPlan:
    """Path from the encoders' pose to the goal, laid onto the reference; `q_goal`: its joints, where they are known."""
    if one_sided and ctx.method == "ours":
        plan = plan_approach(ctx.machine, reading.q_rad, T_base_tcp_goal, plan_settings(ctx), ctx.wall, q_goal=q_goal)
    else:
        plan = plan_move(ctx.machine, reading.q_rad, T_base_tcp_goal, plan_settings(ctx), ctx.wall)
    if ctx.method == "paper":  # eq. 4-5 know no stall: their reference ends at the goal, and the error is integrated
        return _with_stall(plan, reading, np.zeros(ctx.chain.n))
    return onto_reference(ctx, plan, reading)


def plan_settings(ctx: PlanContext) -> PlanSettings:
    """Shaped references for ours, the plain quintic for the paper's method."""
    return replace(PAPER_PLAN_SETTINGS if ctx.method == "paper" else DEFAULT_PLAN_SETTINGS, limit_share=LIMIT_SHARE)


def trim_settings(ctx: PlanContext) -> PlanSettings:
    """A trim moves the reference itself: plain, and at the pace of a path's last leg."""
    return replace(plan_settings(ctx), shape_reference=False, duration_min_s=DEFAULT_APPROACH.last_leg_s)


def onto_reference(ctx: PlanContext, plan: PathPlan, reading: MachineReading) -> PathPlan:
    """The same path as a path of the reference: its first knot is the present reference exactly.

    The paper's watched paths get the first guess of the stall only, in place of the feedback of eq. 4 on the way.
    """
    return _with_stall(plan, reading, first_stall(ctx.machine) if ctx.method == "paper" else ctx.stall)


def _with_stall(plan: PathPlan, reading: MachineReading, stall_rad: Array) -> PathPlan:
    if plan.trajectory is None:
        return plan
    return replace(plan, trajectory=shifted(plan.trajectory, reading.q_ref_rad, stall_rad))
