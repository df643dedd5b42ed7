"""Drive: play a path, rest, and trim the reference until the encoders stand where the path meant them to.

A P-controlled valve with a dead band stops short by up to dead band / kp; that is visible at the encoder, so it is
taken out there, before anybody looks (machine model, dead-band stall).
"""

from collections.abc import Generator

import numpy as np

from machine.kinematics import tcp_jacobian
from machine.rotations import Array
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.requests import Arm, MachineReading, Move, Progress, Request, Settle, expect
from server.motion.approach import trim_reference
from server.motion.contracts import PathPlan, PlanStatus

TRIMS_MAX = 4
TRIM_POSITION_M = 0.0004  # what the remaining encoder residual may do at the TCP
TRIM_ANGLE_RAD = np.deg2rad(0.03)


def drive(ctx: PlanContext, plan: PathPlan, purpose: str) -> Generator[Request, object, int]:
    """Execute a checked plan and trim. Returns the number of trims."""
    if plan.status is not PlanStatus.OK or plan.trajectory is None:
        raise JobFailedError(f"{purpose}: {plan.reason}", f"plan_{plan.status.value}")
    yield Arm()
    yield Progress(
        "move", 0.0, plan.duration_s, "s", f"{purpose}: {plan.length_m * 1e3:.0f} mm in {plan.duration_s:.1f} s"
    )
    yield Move(plan.trajectory, purpose)
    return (yield from trim(ctx, plan.q_end, purpose))


def trim(ctx: PlanContext, q_goal: Array, purpose: str) -> Generator[Request, object, int]:
    """Shift the reference by what the encoders still lack, until that is below a millimetre's fraction at the TCP."""
    for count in range(TRIMS_MAX + 1):
        reading = expect((yield Settle()), MachineReading)
        residual = q_goal - reading.q_rad
        effect = np.abs(tcp_jacobian(ctx.chain, reading.q_rad)) @ np.abs(residual)
        if effect[:3].max() < TRIM_POSITION_M and effect[3:].max() < TRIM_ANGLE_RAD:
            return count
        if count == TRIMS_MAX:
            break
        trajectory = trim_reference(ctx.machine, reading.q_ref_rad, residual)
        if trajectory.trajectory is None:
            raise JobFailedError(f"{purpose}: {trajectory.reason}", "trim_refused")
        yield Move(trajectory.trajectory, f"{purpose}: trim {count + 1}")
    return TRIMS_MAX
