"""The next experiment, planned whole: every motion of it checked before anything moves, and known by its hash."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from machine.kinematics import tcp_poses
from protocol.gate import check_trajectory
from protocol.limits import limits_of
from protocol.messages import axes8
from recording.run import SegmentKind
from server.calibration.contracts import Array
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.experiment_records import ExperimentPlan
from server.jobs.knowledge import fingerprint
from server.jobs.plans.planning import LIMIT_SHARE, plan_settings
from server.jobs.proposals import LooksProposal, MotionProposal
from server.jobs.requests import MachineReading
from server.link.knots import knots_from, knots_of, refusals_text
from server.motion.approach import play_of
from server.motion.contracts import JointTrajectory
from server.motion.experiment_course import Course, Keep, fitted_course
from server.motion.identification_courses import Mark
from server.motion.joint_limits import range_refusal
from server.motion.point_to_point import plan_joint_move
from server.motion.refusal import Refusal
from server.motion.settings import PlanSettings
from server.motion.timing import tcp_speed
from server.motion.trajectory import join, sample
from server.motion.wall_clearance import stall_reach, wall_refusal

THERE_RAD = 1e-6
AROUND_RAD = 0.35  # a course that stays so near its start is made smaller where it is too fast; a longer one slower


@dataclass(frozen=True, slots=True)
class Step:
    """One motion from rest to rest. `then`: recorded as the experiment's own segment, looked after, or neither."""

    trajectory: JointTrajectory
    purpose: str
    then: Literal["", "segment", "look"] = ""
    marks: tuple[Mark, ...] = ()  # stretches of it that are segments of their own


@dataclass(frozen=True, slots=True)
class PlannedExperiment:
    """All of an experiment, ready to be driven by its hash before it expires, from the reference it begins at."""

    diagnosis_id: str
    what: str
    segment: SegmentKind
    steps: tuple[Step, ...]
    plan_hash: str
    q_ref_start: Array
    size_frac: float
    slower: float
    t_made_ns: int
    expires_ns: int

    @property
    def duration_s(self) -> float:
        """Of all motion [s]."""
        return sum(step.trajectory.duration_s for step in self.steps)

    @property
    def looks(self) -> int:
        """How many postures are looked from."""
        return sum(step.then == "look" for step in self.steps)


def planned_experiment(
    ctx: PlanContext,
    diagnosis_id: str,
    proposal: MotionProposal | LooksProposal,
    reading: MachineReading,
    keep: Keep | None,
    t_now_ns: int,
) -> PlannedExperiment:
    """Every motion of an experiment from the present reference. Nothing moves.

    Raises: JobFailedError with the reason: a joint's range, too fast, the wall, the motion gate.
    """
    steps, size_frac, slower = _steps(ctx, proposal, np.asarray(reading.q_ref_rad, dtype=float), keep)
    return PlannedExperiment(
        diagnosis_id=diagnosis_id,
        what=proposal.name,
        segment=proposal.segment_kind if isinstance(proposal, MotionProposal) else "static",
        steps=steps,
        plan_hash=steps_hash(steps),
        q_ref_start=np.asarray(reading.q_ref_rad, dtype=float),
        size_frac=size_frac,
        slower=slower,
        t_made_ns=t_now_ns,
        expires_ns=t_now_ns + int(ctx.settings.position.plan_expires_s * 1e9),
    )


def _steps(
    ctx: PlanContext, proposal: MotionProposal | LooksProposal, q_ref: Array, keep: Keep | None
) -> tuple[tuple[Step, ...], float, float]:
    if isinstance(proposal, LooksProposal):
        return _look_steps(ctx, np.array(proposal.q_rad, dtype=float), q_ref), 1.0, 1.0
    course = Course(proposal.course(), proposal.t_knot_s)
    wanted = keep or ("tempo" if float(np.abs(course.q - course.q[0]).max()) <= AROUND_RAD else "size")
    fitted = fitted_course(ctx.machine, ctx.chain, course, experiment_settings(ctx), wanted)
    if isinstance(fitted, Refusal):
        raise _refused(fitted)
    check_driven(ctx, fitted.trajectory)
    way = way_to(ctx, q_ref, course.q[0], "to the start of the experiment")
    steps = (*way, Step(fitted.trajectory, f"experiment: {proposal.name}", "segment"))
    return steps, fitted.size_frac, fitted.slower


def _look_steps(ctx: PlanContext, postures: Array, q_ref: Array) -> tuple[Step, ...]:
    """To each posture (k, n) from below in every joint, so that the play lies the same way each time."""
    below = postures - play_of(ctx.chain.n)
    here, steps = q_ref, []
    for number, (under, posture) in enumerate(zip(below, postures, strict=True), start=1):
        purpose = f"posture {number} of {len(postures)}"
        legs = [step.trajectory for a, b in pairwise((here, under, posture)) for step in way_to(ctx, a, b, purpose)]
        if legs:
            steps.append(Step(join(legs), purpose, "look"))
        here = posture
    return tuple(steps)


def way_to(ctx: PlanContext, q_from: Array, q_to: Array, purpose: str) -> tuple[Step, ...]:
    """A move of the reference; none where it is there already."""
    if float(np.abs(q_to - q_from).max()) < THERE_RAD:
        return ()
    plan = plan_joint_move(ctx.machine, q_from, q_to, experiment_settings(ctx), ctx.wall)
    if plan.trajectory is None:
        raise JobFailedError(f"experiment: {purpose}: {plan.reason}", f"plan_{plan.status.value}")
    check_driven(ctx, plan.trajectory)
    return (Step(plan.trajectory, purpose),)


def experiment_settings(ctx: PlanContext) -> PlanSettings:
    """A plain reference: what leads the joints would be another experiment than the one that was foretold."""
    return replace(plan_settings(ctx), shape_reference=False, limit_share=LIMIT_SHARE)


def check_driven(ctx: PlanContext, trajectory: JointTrajectory) -> None:
    """Joint ranges, wall and motion gate along a course of the reference: joints may rest a stall away from it.

    Raises: JobFailedError: the first that refuses.
    """
    _, motion = sample(trajectory, 0.02)
    beyond = range_refusal(ctx.machine, motion.q, experiment_settings(ctx).joint_margin_rad)
    if beyond is not None:
        raise _refused(beyond)
    nearer_m = 0.0 if ctx.wall is None else stall_reach(ctx.chain, motion.q, ctx.stall, ctx.wall)
    _, hit = wall_refusal(tcp_poses(ctx.chain, motion.q), ctx.machine.T_tcp_tool, ctx.wall, nearer_m)
    if hit is not None:
        raise _refused(hit)
    _gate(ctx, trajectory)


def _gate(ctx: PlanContext, trajectory: JointTrajectory) -> None:
    knots = knots_of(trajectory, ctx.chain.n)
    refused = check_trajectory(knots_from(knots), axes8(knots[0][1]), limits_of(ctx.machine.joints))
    if refused:
        raise JobFailedError(f"experiment: {refusals_text(refused)}", "plan_gate")


def _refused(refusal: Refusal) -> JobFailedError:
    return JobFailedError(f"experiment: {refusal.reason}", f"plan_{refusal.status.value}")


def steps_hash(steps: tuple[Step, ...]) -> str:
    """Short fingerprint of everything that would be sent, in its order."""
    return fingerprint((step.then, step.trajectory) for step in steps)


def told_plan(
    ctx: PlanContext, planned: PlannedExperiment, separates: tuple[str, ...], t_now_ns: int
) -> ExperimentPlan:
    """A planned experiment as the operator checks it."""
    trajectories = [step.trajectory for step in planned.steps]
    clearance = min((clearance_of(ctx, one) for one in trajectories), default=float("inf"))
    travel = sum((np.abs(np.diff(one.q, axis=0)).sum(axis=0) for one in trajectories), np.zeros(ctx.chain.n))
    return ExperimentPlan(
        diagnosis_id=planned.diagnosis_id,
        plan_hash=planned.plan_hash,
        expires_in_s=round((planned.expires_ns - t_now_ns) * 1e-9, 1),
        what=planned.what,
        separates=separates,
        duration_s=round(planned.duration_s, 1),
        size_frac=round(planned.size_frac, 3),
        slower=round(planned.slower, 2),
        tcp_speed_max_mm_s=round(max((tcp_speed(ctx.chain, one) for one in trajectories), default=0.0) * 1e3, 1),
        clearance_mm=round(clearance * 1e3, 1) if np.isfinite(clearance) else None,
        joint_travel_deg=tuple(round(float(value), 1) for value in np.rad2deg(travel)),
        looks=planned.looks,
        caution=_caution(ctx, planned),
    )


def clearance_of(ctx: PlanContext, trajectory: JointTrajectory) -> float:
    """Smallest distance of the tool to the wall [m]; infinite without a known wall."""
    _, motion = sample(trajectory, 0.05)
    return wall_refusal(tcp_poses(ctx.chain, motion.q), ctx.machine.T_tcp_tool, ctx.wall)[0]


def _caution(ctx: PlanContext, planned: PlannedExperiment) -> str:
    """What the operator should know before driving it."""
    said = []
    if ctx.wall is None:
        said.append("no wall is known: clearance was not checked, watch the whole path")
    if planned.size_frac < 1.0:
        said.append(f"{100 * planned.size_frac:.0f} % of the proposed size, for the speed limits: it separates less")
    if planned.slower > 1.0:
        said.append(f"{planned.slower:.1f} times as long as proposed, for the speed limits: it separates less")
    return "; ".join(said)
