"""Drive: play a path, rest, and trim the reference until the encoders stand where the path meant them to.

A P-controlled valve with a dead band stops short; that is visible at the encoders, so it is taken out there, before
anybody looks (docs/decisions/0001-trim-on-encoders.md).
"""

from collections.abc import Generator

import numpy as np

from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.plans.integrating import integrate
from server.jobs.plans.planning import trim_settings
from server.jobs.requests import Arm, MachineReading, Move, Progress, Request, Settle, expect
from server.motion.approach import play_of
from server.motion.contracts import JointTrajectory, PathPlan, PlanStatus
from server.motion.lost_motion import last_direction, plan_trim, updated_stall, worth_trimming

TRIMS_MAX = 4
PLAY_MAX_RAD = float(np.deg2rad(2.5))  # 0.13 m at 3 m: further back than that, something else is wrong


def drive(
    ctx: PlanContext, plan: PathPlan, purpose: str, trims_max: int = TRIMS_MAX
) -> Generator[Request, object, int]:
    """Execute a checked plan, rest, and trim. Returns the number of trims. The paper's method has its own end."""
    trajectory = yield from play(ctx, plan, purpose)
    if ctx.method == "paper":
        return (yield from integrate(ctx, plan, purpose))
    direction, play_rad = last_direction(trajectory), play_of(len(ctx.machine.joints))
    count = 0
    while True:
        reading = expect((yield Settle()), MachineReading)
        stall, stuck = updated_stall(ctx.stall, reading.q_ref_rad, reading.q_rad, direction, play_rad)
        ctx.knowledge.stall_rad = stall
        play_rad = np.minimum(np.where(stuck, 2.0 * play_rad, play_rad), PLAY_MAX_RAD)
        residual = plan.q_end - reading.q_rad
        if count == trims_max or not worth_trimming(ctx.machine, reading.q_rad, residual).any():
            return count
        count += 1
        q_ref, q, settings = reading.q_ref_rad, reading.q_rad, trim_settings(ctx)
        again = plan_trim(ctx.machine, q_ref, q, plan.q_end, stall, play_rad, settings, ctx.wall)
        if again.trajectory is None:
            raise JobFailedError(f"{purpose}: correction: {again.reason}", "trim_refused")
        worst = float(np.rad2deg(np.abs(residual).max()))
        text = f"{purpose}: re-approaching: joints up to {worst:.2f} deg"
        yield Progress("trim", count, trims_max, "trims", text)
        yield Move(again.trajectory, f"{purpose}: correction {count}")
        direction = last_direction(again.trajectory)


def play(ctx: PlanContext, plan: PathPlan, purpose: str) -> Generator[Request, object, JointTrajectory]:
    """Execute a checked plan. Returns what was played."""
    if plan.status is not PlanStatus.OK or plan.trajectory is None:
        raise JobFailedError(f"{purpose}: {plan.reason}", f"plan_{plan.status.value}")
    yield Arm()
    text = f"{purpose}: {plan.length_m * 1e3:.0f} mm in {plan.duration_s:.1f} s"
    yield Progress("move", 0.0, plan.duration_s, "s", text)
    yield Move(plan.trajectory, purpose)
    return plan.trajectory
