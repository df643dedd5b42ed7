"""Drive: play a path, rest, and correct the reference until the encoders stand at the end of the path.

A P-controlled valve with a dead band stops short; that is visible at the encoders, so it is corrected there, before
the next look (docs/decisions/0001-trim-on-encoders.md).
"""

from collections.abc import Generator
from dataclasses import replace
from typing import Literal

import numpy as np

from machine.rotations import Array
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.jobs.plans.looking import good_look
from server.jobs.plans.planning import plan_to, trim_settings
from server.jobs.plans.tolerance import error_of
from server.jobs.records import MoveRecord
from server.jobs.requests import Arm, MachineReading, Move, Progress, Record, Request, Settle, expect_reply
from server.motion.approach import play_of
from server.motion.contracts import JointTrajectory, PathPlan, PlanStatus
from server.motion.lost_motion import last_direction, off_the_wall, plan_trim, updated_stall, worth_trimming
from server.motion.point_to_point import plan_joint_move

TRIMS_MAX = 4
BACKLASH_MAX_RAD = float(np.deg2rad(2.5))  # 0.13 m at 3 m: further back than that, something else is wrong


# The paper's own way to the end of a move: eq. 4-5 integrate the remaining error into the reference until it is gone.
#
# Eq. 4 feeds K_p (p_d - p) of the measured pose back, eq. 5 integrates it: a valve's dead band, which leaves a
# P-controlled joint short, is crossed in time. On the way that is one loop; here at rest, in steps of K_p dt = 1.

INTEGRATION_STEPS_MAX = 12  # of about a second: the paper's operator waited half a minute between two inputs
INTEGRATION_STEP_DURATION_S = 0.5


def correct_encoder_shortfall(ctx: PlanContext, plan: PathPlan, purpose: str) -> Generator[Request, object, int]:
    """Rest; add the encoders' shortfall to the reference until there is none. Returns the number of steps.

    No step is longer than the shortfall, so no joint is driven past its goal, and none comes from a chosen side.
    """
    for count in range(INTEGRATION_STEPS_MAX + 1):
        reading = expect_reply((yield Settle()), MachineReading)
        shortfall = plan.q_end - reading.q_rad
        if count == INTEGRATION_STEPS_MAX or not worth_trimming(ctx.machine, reading.q_rad, shortfall).any():
            return count
        settings = replace(trim_settings(ctx), duration_min_s=INTEGRATION_STEP_DURATION_S)
        step = plan_joint_move(ctx.machine, reading.q_ref_rad, reading.q_ref_rad + shortfall, settings)
        step = off_the_wall(ctx.machine, step, [reading.q_rad, plan.q_end], ctx.wall)
        if step.trajectory is None:
            raise JobFailedError(f"{purpose}: integration of the error: {step.reason}", "trim_refused")
        text = f"{purpose}: integrating, joints short of target by up to {np.rad2deg(np.abs(shortfall).max()):.2f} deg"
        yield Progress("integrate", count + 1, INTEGRATION_STEPS_MAX, "steps", text)
        yield Move(step.trajectory, f"{purpose}: integration step {count + 1}")
    return INTEGRATION_STEPS_MAX


def drive_and_correct(
    ctx: PlanContext, plan: PathPlan, purpose: str, trims_max: int = TRIMS_MAX
) -> Generator[Request, object, int]:
    """Execute a checked plan, rest, and trim. Returns the number of trims. The paper's method has its own end."""
    trajectory = yield from execute_plan(ctx, plan, purpose)
    if ctx.method == "paper":
        return (yield from correct_encoder_shortfall(ctx, plan, purpose))
    direction, play_rad = last_direction(trajectory), play_of(len(ctx.machine.joints))
    count = 0
    while True:
        reading = expect_reply((yield Settle()), MachineReading)
        stall, stuck = updated_stall(ctx.stall, reading.q_ref_rad, reading.q_rad, direction, play_rad)
        ctx.knowledge.stall_rad = stall
        play_rad = np.minimum(np.where(stuck, 2.0 * play_rad, play_rad), BACKLASH_MAX_RAD)
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


def execute_plan(ctx: PlanContext, plan: PathPlan, purpose: str) -> Generator[Request, object, JointTrajectory]:
    """Execute a checked plan. Returns what was played."""
    if plan.status is not PlanStatus.OK or plan.trajectory is None:
        raise JobFailedError(f"{purpose}: {plan.reason}", f"plan_{plan.status.value}")
    yield Arm()
    text = f"{purpose}: {plan.length_m * 1e3:.0f} mm in {plan.duration_s:.1f} s"
    yield Progress("move", 0.0, plan.duration_s, "s", text)
    yield Move(plan.trajectory, purpose)
    return plan.trajectory


def drive_and_look(
    ctx: PlanContext,
    before: LookTaken,
    T_base_tcp: Array,
    kind: Literal["orientation", "approach"],
    number: int,
    purpose: str,
    trims_max: int,
) -> Generator[Request, object, LookTaken]:
    """Drive to a pose (4, 4), look again, and record the step. Returns that look."""
    plan = plan_to(ctx, before.reading, T_base_tcp)
    trims = yield from drive_and_correct(ctx, plan, purpose, trims_max)
    after = yield from good_look(ctx)
    record = MoveRecord(
        number=number,
        kind=kind,
        before=error_of(before),
        after=after.error,
        predicted_sigma_mm=(0.0, 0.0, 0.0),
        length_mm=plan.length_m * 1e3,
        duration_s=plan.duration_s,
        trims=trims,
        t_rest_plc_ns=after.record.t_plc_ns,
    )
    ctx.knowledge.moves.append(record)
    yield Record(record)
    return after
