"""Drive: play a path, rest, and trim the reference until the encoders stand where the path meant them to.

A P-controlled valve with a dead band stops short; that is visible at the encoders, so it is taken out there, before
anybody looks (docs/decisions/0001-trim-on-encoders.md).
"""

from collections.abc import Generator

import numpy as np

from machine.rotations import Array
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.plans.planning import play_of, trim_settings
from server.jobs.requests import Arm, MachineReading, Move, Progress, Request, Settle, expect
from server.motion.contracts import PathPlan, PlanStatus
from server.motion.lost_motion import plan_trim, updated_stall, worth_trimming

TRIMS_MAX = 6


def drive(ctx: PlanContext, plan: PathPlan, purpose: str) -> Generator[Request, object, int]:
    """Execute a checked plan and trim. Returns the number of trims."""
    reading = yield from play(ctx, plan, purpose)
    return (yield from trim(ctx, plan.q_end, reading, purpose))


def play(ctx: PlanContext, plan: PathPlan, purpose: str) -> Generator[Request, object, MachineReading]:
    """Execute a checked plan and wait for rest. Returns the joints before it."""
    if plan.status is not PlanStatus.OK or plan.trajectory is None:
        raise JobFailedError(f"{purpose}: {plan.reason}", f"plan_{plan.status.value}")
    before = expect((yield Settle()), MachineReading)
    yield Arm()
    text = f"{purpose}: {plan.length_m * 1e3:.0f} mm in {plan.duration_s:.1f} s"
    yield Progress("move", 0.0, plan.duration_s, "s", text)
    yield Move(plan.trajectory, purpose)
    return before


def trim(ctx: PlanContext, q_goal: Array, before: MachineReading, purpose: str) -> Generator[Request, object, int]:
    """Shift the reference until the encoders lack less than shows at the TCP; learns each joint's stall on the way."""
    for count in range(TRIMS_MAX + 1):
        reading = expect((yield Settle()), MachineReading)
        residual = q_goal - reading.q_rad
        stall = updated_stall(ctx.stall, reading.q_ref_rad, before.q_rad, reading.q_rad, residual)
        ctx.knowledge.stall_rad = stall
        if count == TRIMS_MAX or not worth_trimming(ctx.machine, reading.q_rad, residual).any():
            return count
        plan = plan_trim(ctx.machine, reading.q_ref_rad, reading.q_rad, q_goal, stall, play_of(ctx), trim_settings(ctx))
        if plan.trajectory is None:
            raise JobFailedError(f"{purpose}: trim: {plan.reason}", "trim_refused")
        worst = float(np.rad2deg(np.abs(residual).max()))
        yield Progress("trim", count + 1, TRIMS_MAX, "trims", f"{purpose}: trim, encoders lack up to {worst:.2f} deg")
        yield Move(plan.trajectory, f"{purpose}: trim {count + 1}")
        before = reading
    return TRIMS_MAX
