"""The paper's own way to the end of a move: eq. 4-5 integrate the remaining error into the reference until it is gone.

Eq. 4 feeds K_p (p_d - p) of the measured pose back, eq. 5 integrates it: a valve's dead band, which leaves a
P-controlled joint short, is crossed in time. On the way that is one loop; here at rest, in steps of K_p dt = 1.
"""

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.plans.planning import trim_settings
from server.jobs.requests import MachineReading, Move, Progress, Request, Settle, expect
from server.motion.contracts import PathPlan
from server.motion.lost_motion import off_the_wall, worth_trimming
from server.motion.point_to_point import plan_joint_move

STEPS_MAX = 12  # of about a second: the paper's operator waited half a minute between two inputs
STEP_MIN_S = 0.5


def integrate(ctx: PlanContext, plan: PathPlan, purpose: str) -> Generator[Request, object, int]:
    """Rest; what the encoders lack is added to the reference, until they lack nothing. Returns the number of steps.

    No step is longer than what is lacking, so no joint is driven past its goal, and none comes from a chosen side.
    """
    for count in range(STEPS_MAX + 1):
        reading = expect((yield Settle()), MachineReading)
        lacking = plan.q_end - reading.q_rad
        if count == STEPS_MAX or not worth_trimming(ctx.machine, reading.q_rad, lacking).any():
            return count
        settings = replace(trim_settings(ctx), duration_min_s=STEP_MIN_S)
        step = plan_joint_move(ctx.machine, reading.q_ref_rad, reading.q_ref_rad + lacking, settings)
        step = off_the_wall(ctx.machine, step, [reading.q_rad, plan.q_end], ctx.wall)
        if step.trajectory is None:
            raise JobFailedError(f"{purpose}: integration of the error: {step.reason}", "trim_refused")
        text = f"{purpose}: integrating, joints short of target by up to {np.rad2deg(np.abs(lacking).max()):.2f} deg"
        yield Progress("integrate", count + 1, STEPS_MAX, "steps", text)
        yield Move(step.trajectory, f"{purpose}: integration step {count + 1}")
    return STEPS_MAX
