"""Identify the machine in one drive: planning shows a hash and moves nothing; driving names it and is recorded."""

from collections.abc import Callable, Generator

import numpy as np

from machine.poses import pose
from recording.clock import mono_ns
from server.errors import JobFailedError, PlanRefusedError
from server.jobs.context import PlanContext
from server.jobs.plans.drive_steps import LOOK_PAIRS, begin_drive
from server.jobs.plans.freshness import require_fresh
from server.jobs.plans.identification_planning import (
    LOOKS_PART_NAME,
    Drive,
    PlannedIdentification,
    PlannedPart,
    plan_summary,
    planned_drive,
)
from server.jobs.plans.looking import mount_rotation, take_look
from server.jobs.records import IdentificationDriven, IdentificationPlan
from server.jobs.requests import (
    BeginSegment,
    EndSegment,
    MachineReading,
    Move,
    Progress,
    Request,
    Settle,
    TakeLook,
    expect_reply,
)
from server.motion.identification_postures import SeenObject
from server.vision.contracts import Look, LookStatus

MISSED_LOOKS_MAX = 3  # looks in a row without a good one: then the camera is gone, or the object is
NOMINAL_DRIVE_MINUTES = 6.0  # that the parts' usual lengths make
PAIRS_PER_DRIVE_LOOK = LOOK_PAIRS // 2  # of a look: every pair's corners are recorded


def plan_identification(
    ctx: PlanContext,
    minutes: float,
    wall_free: bool,
    unfinished: Drive | None,
    keep_plan: Callable[[Drive, PlannedIdentification], None],
    clock_ns: Callable[[], int] = mono_ns,
) -> Generator[Request, object, IdentificationPlan]:
    """Look once, plan every part from where the machine rests, and keep the plan for `identify`. Nothing moves.

    `unfinished`: a drive of which only the rest is planned.
    """
    taken = yield from take_look(ctx)
    if ctx.wall is None and not wall_free:
        raise JobFailedError(
            f"no wall is known ({taken.record.reason}), so the drive cannot be checked against it: begin where the "
            "camera sees the object, or plan with wall_free = true if there is no wall within reach",
            "no_wall",
        )
    reading = expect_reply((yield Settle()), MachineReading)
    q_ref = np.asarray(reading.q_ref_rad, dtype=float)
    drive = unfinished
    if drive is None:
        seen = None
        if ctx.knowledge.T_base_ooi is not None and taken.error is not None:
            T_tcp_cam = pose(mount_rotation(ctx, taken), ctx.machine.T_tcp_cam_left[:3, 3])
            seen = SeenObject(ctx.knowledge.T_base_ooi, ctx.machine.markers_on("ooi"), T_tcp_cam)
        drive = Drive(q_ref, seen, minutes / NOMINAL_DRIVE_MINUTES)
    planned = planned_drive(ctx, drive, q_ref, clock_ns())
    keep_plan(drive, planned)
    summary = plan_summary(ctx, planned, clock_ns())
    text = f"{len(summary.parts)} parts, {summary.looks} looks, {summary.duration_s:.0f} s, plan {summary.plan_hash}"
    yield Progress("plan", 1.0, 1.0, "", text)
    return summary


def drive_identification(
    ctx: PlanContext, planned: PlannedIdentification, drive: Drive
) -> Generator[Request, object, IdentificationDriven]:
    """Drive a planned identification part by part, each from rest to rest and recorded under its own name.

    A part is done when it has been driven whole; one that was cut short is planned again with the rest.
    Raises: PlanRefusedError: the machine is not where the plan begins. JobFailedError: the wall is nearer than it was.
    """
    text = f"identification, plan {planned.plan_hash}"
    yield from begin_drive(ctx, planned.trajectories, planned.q_ref_start, text)
    good = 0
    for number, part in enumerate(planned.parts, start=1):
        text = f"{part.name}: {part.drive_segment.duration_s:.0f} s, shows {', '.join(part.drive_segment.shows)}"
        yield Progress("identify", number, len(planned.parts), "parts", text)
        good += yield from _execute_part(part)
        drive.done_parts.add(part.name)
    return IdentificationDriven(
        plan_hash=planned.plan_hash,
        parts=tuple(part.name for part in planned.parts),
        left=(),
        duration_s=round(planned.duration_s, 1),
        looks_good=good,
    )


def _execute_part(part: PlannedPart) -> Generator[Request, object, int]:
    good = missed = 0
    if (
        part.name == LOOKS_PART_NAME
    ):  # one segment over all of them: the motion between two looks shows the way to each posture
        yield BeginSegment(LOOKS_PART_NAME, "static")
    for number, step in enumerate(part.steps, start=1):
        yield Move(step.trajectory, step.purpose, step.segment_marks)
        expect_reply((yield Settle()), MachineReading)
        if step.follow_up != "look":
            continue
        yield Progress("look", number, len(part.steps), "motions", step.purpose)
        look = expect_reply((yield TakeLook(n_pairs=PAIRS_PER_DRIVE_LOOK)), Look)
        good, missed = (good + 1, 0) if look.status is LookStatus.OK else (good, missed + 1)
        if missed == MISSED_LOOKS_MAX:
            raise JobFailedError(
                f"identify: {missed} looks in a row failed, the last one at {step.purpose} ({look.reason}); see to "
                "camera and light, then plan the rest with resume",
                "looks_failed",
            )
    yield EndSegment()
    return good


def check_identification(
    planned: PlannedIdentification | None, wanted_hash: str, t_now_ns: int
) -> PlannedIdentification:
    """The planned drive, if it is the one named and still fresh.

    Raises: PlanRefusedError saying which of the two it is not.
    """
    if planned is None:
        raise PlanRefusedError("no identification was planned; send plan_identify first")
    if planned.plan_hash != wanted_hash:
        raise PlanRefusedError(f"plan {wanted_hash} is not the planned one ({planned.plan_hash}); plan again")
    require_fresh(planned.plan_hash, planned.t_made_ns, planned.expires_ns, t_now_ns, "plan again")
    return planned
