"""The next experiment as two jobs: planning shows a hash and moves nothing; driving names it and is recorded."""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from machine.kinematics import tcp_poses
from recording.clock import mono_ns
from server.errors import JobFailedError, PlanRefusedError
from server.jobs.context import PlanContext
from server.jobs.experiment_records import ExperimentDriven, ExperimentPlan
from server.jobs.plans.experiment_planning import PlannedExperiment, Step, check_driven, planned_experiment, told_plan
from server.jobs.plans.freshness import require_fresh
from server.jobs.proposals import LooksProposal, MotionProposal, require_same_machine
from server.jobs.requests import (
    Arm,
    BeginSegment,
    EndSegment,
    MachineReading,
    Move,
    Progress,
    ReadMachine,
    Record,
    Request,
    Settle,
    TakeLook,
    expect,
)
from server.motion.contracts import Array, JointTrajectory, PathPlan, PlanStatus
from server.motion.experiment_course import Keep
from server.motion.timing import tcp_speed
from server.motion.trajectory import join
from server.motion.wall_clearance import wall_refusal
from server.vision.contracts import Look, LookStatus

STARTED_RAD = 1e-4  # the reference may be this far from where the plan begins: arming sets it to the encoders
LOOK_PAIRS = 40


@dataclass(frozen=True, slots=True)
class AskedExperiment:
    """What is to be planned. `recordings`: of the diagnosis; `wall_free`: its sender says that there is no wall."""

    diagnosis_id: str
    proposal: MotionProposal | LooksProposal
    separates: tuple[str, ...]
    recordings: tuple[Path, ...]
    machine_text: str
    wall_free: bool
    keep: Keep | None


def plan_experiment(
    ctx: PlanContext,
    asked: AskedExperiment,
    keep_plan: Callable[[PlannedExperiment], None],
    clock_ns: Callable[[], int] = mono_ns,
) -> Generator[Request, object, ExperimentPlan]:
    """Plan from where the machine rests, check every motion, and keep the plan for `experiment`."""
    require_same_machine(asked.recordings, asked.machine_text)
    if ctx.wall is None and not asked.wall_free:
        raise JobFailedError(
            "no wall is known, so the path cannot be checked against it: look first, or plan with wall_free = true "
            "if there is none within reach",
            "no_wall",
        )
    reading = expect((yield Settle()), MachineReading)
    planned = planned_experiment(ctx, asked.diagnosis_id, asked.proposal, reading, asked.keep, clock_ns())
    keep_plan(planned)
    told = told_plan(ctx, planned, asked.separates, clock_ns())
    yield Progress("plan", 1.0, 1.0, "", f"{told.what}: {told.duration_s:.0f} s, plan {told.plan_hash}")
    return told


def check_experiment(
    planned: PlannedExperiment | None, diagnosis_id: str, wanted_hash: str, t_now_ns: int
) -> PlannedExperiment:
    """The planned experiment, if it is the one named and still fresh.

    Raises: PlanRefusedError saying which of the two it is not.
    """
    if planned is None:
        raise PlanRefusedError("no experiment was planned; send plan_experiment first")
    if (planned.plan_hash, planned.diagnosis_id) != (wanted_hash, diagnosis_id):
        raise PlanRefusedError(
            f"plan {wanted_hash} of diagnosis {diagnosis_id} is not the planned one ({planned.plan_hash} of "
            f"{planned.diagnosis_id}); plan again"
        )
    require_fresh(planned.plan_hash, planned.t_made_ns, planned.expires_ns, t_now_ns, "plan again")
    return planned


def drive_experiment(ctx: PlanContext, planned: PlannedExperiment) -> Generator[Request, object, ExperimentDriven]:
    """Drive a planned experiment and record it as a segment of its own kind; it ends at rest where the plan ends."""
    said = f"{planned.what}, proposed by diagnosis {planned.diagnosis_id}, plan {planned.plan_hash}"
    yield from begin_drive(ctx, [step.trajectory for step in planned.steps], planned.q_ref_start, said)
    good = 0
    if planned.looks:  # one segment over all of them: what is between two looks tells how each was come to
        yield BeginSegment(planned.what, planned.segment)
    for number, step in enumerate(planned.steps, start=1):
        text = f"{step.purpose}: {step.trajectory.duration_s:.0f} s"
        yield Progress("experiment", number, len(planned.steps), "motions", text)
        good += yield from _driven(ctx, planned, step)
    yield EndSegment()
    return ExperimentDriven(
        diagnosis_id=planned.diagnosis_id,
        plan_hash=planned.plan_hash,
        what=planned.what,
        segment=planned.segment,
        duration_s=round(planned.duration_s, 1),
        looks_good=good,
    )


def begin_drive(
    ctx: PlanContext, trajectories: list[JointTrajectory], q_ref_start: Array, text: str
) -> Generator[Request, object, None]:
    """Check the motions of a plan again, record their path under `text`, and arm.

    Raises: PlanRefusedError: the machine is not where the plan begins. JobFailedError: the wall is nearer than it was.
    """
    reading = expect((yield ReadMachine()), MachineReading)
    require_reference(reading, q_ref_start)
    for trajectory in trajectories:  # a look since then may have found a wall, or found it nearer
        check_driven(ctx, trajectory)
    if ctx.knowledge.q_start is None:
        ctx.knowledge.q_start = reading.q_rad
    yield Record(path_of(ctx, trajectories), text)
    yield Arm()


def require_reference(reading: MachineReading, q_ref_start: Array) -> None:
    """Raises: PlanRefusedError: the reference is not where a plan begins."""
    shift = float(np.abs(reading.q_ref_rad - q_ref_start).max())
    if shift > STARTED_RAD:
        raise PlanRefusedError(
            f"the machine's reference moved by {np.rad2deg(shift):.3f} deg since the experiment was planned "
            f"(limit {np.rad2deg(STARTED_RAD):.3f} deg); plan again"
        )


def _driven(ctx: PlanContext, planned: PlannedExperiment, step: Step) -> Generator[Request, object, int]:
    """One step, at rest after it; 1 if it ended in a good look."""
    if step.then == "segment":
        yield BeginSegment(planned.what, planned.segment)
    yield Move(step.trajectory, step.purpose)
    if step.then == "segment":
        yield EndSegment()
    expect((yield Settle()), MachineReading)
    if step.then != "look":
        return 0
    look = expect((yield TakeLook(pairs=LOOK_PAIRS)), Look)
    return int(look.status is LookStatus.OK)


def path_of(ctx: PlanContext, trajectories: list[JointTrajectory]) -> PathPlan:
    """Motions one after the other as a planned path, for the recording."""
    whole = join(trajectories)
    Ts = tcp_poses(ctx.chain, whole.q)
    return PathPlan(
        status=PlanStatus.OK,
        reason="",
        trajectory=whole,
        Ts_base_tcp=Ts,
        q_end=whole.q[-1],
        length_m=float(np.linalg.norm(np.diff(Ts[:, :3, 3], axis=0), axis=1).sum()),
        duration_s=whole.duration_s,
        tcp_speed_max_m_s=tcp_speed(ctx.chain, whole),
        clearance_m=wall_refusal(Ts, ctx.machine.T_tcp_tool, ctx.wall)[0],
        sigma_min=float("nan"),
        joint_travel_rad=np.abs(np.diff(whole.q, axis=0)).sum(axis=0),
    )
