"""Drives of several motions: each checked against ranges, wall and gate, all known by one hash, begun at one place."""

from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from machine.kinematics import tcp_poses
from protocol.gate import check_trajectory
from protocol.limits import limits_of
from protocol.messages import pad_to_eight_axes
from server.errors import JobFailedError, PlanRefusedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import fingerprint
from server.jobs.plans.planning import LIMIT_SHARE, plan_settings
from server.jobs.requests import Arm, MachineReading, ReadMachine, Record, Request, expect_reply
from server.link.samples import knots_from, knots_of, refusals_text
from server.motion.contracts import Array, JointTrajectory, PathPlan, PlanStatus, join_trajectories, sample_trajectory
from server.motion.identification_courses import SegmentMark
from server.motion.point_to_point import plan_joint_move
from server.motion.refusal import Refusal, range_refusal
from server.motion.settings import PlanSettings
from server.motion.timing import tcp_speed
from server.motion.wall_clearance import stall_reach, wall_refusal

SAME_POSTURE_MAX_RAD = 1e-6
START_SHIFT_MAX_RAD = 1e-4  # the reference may be this far from where the plan begins: arming sets it to the encoders
LOOK_PAIRS = 40


@dataclass(frozen=True, slots=True)
class Step:
    """One motion from rest to rest. `follow_up`: a look follows it, or nothing."""

    trajectory: JointTrajectory
    purpose: str
    follow_up: Literal["", "look"] = ""
    segment_marks: tuple[SegmentMark, ...] = ()  # stretches of it that are segments of their own


def way_to(ctx: PlanContext, q_from: Array, q_to: Array, purpose: str) -> tuple[Step, ...]:
    """A move of the reference; none where it is there already."""
    if float(np.abs(q_to - q_from).max()) < SAME_POSTURE_MAX_RAD:
        return ()
    plan = plan_joint_move(ctx.machine, q_from, q_to, drive_settings(ctx), ctx.wall)
    if plan.trajectory is None:
        raise JobFailedError(f"{purpose}: {plan.reason}", f"plan_{plan.status.value}")
    refuse_unsafe_reference(ctx, plan.trajectory)
    return (Step(plan.trajectory, purpose),)


def drive_settings(ctx: PlanContext) -> PlanSettings:
    """A plain reference: what leads the joints would be another motion than the one whose residuals are predicted."""
    return replace(plan_settings(ctx), shape_reference=False, limit_share=LIMIT_SHARE)


def refuse_unsafe_reference(ctx: PlanContext, trajectory: JointTrajectory) -> None:
    """Joint ranges, wall and motion gate along a course of the reference: joints may rest a stall away from it.

    Raises: JobFailedError: the first that refuses.
    """
    _, motion = sample_trajectory(trajectory, 0.02)
    beyond = range_refusal(ctx.machine, motion.q, drive_settings(ctx).joint_margin_rad)
    if beyond is not None:
        raise _refusal_error(beyond)
    nearer_m = 0.0 if ctx.wall is None else stall_reach(ctx.chain, motion.q, ctx.stall, ctx.wall)
    _, hit = wall_refusal(tcp_poses(ctx.chain, motion.q), ctx.machine.T_tcp_tool, ctx.wall, nearer_m)
    if hit is not None:
        raise _refusal_error(hit)
    _require_gate_accepts(ctx, trajectory)


def _require_gate_accepts(ctx: PlanContext, trajectory: JointTrajectory) -> None:
    knots = knots_of(trajectory, ctx.chain.n)
    refused = check_trajectory(knots_from(knots), pad_to_eight_axes(knots[0][1]), limits_of(ctx.machine.joints))
    if refused:
        raise JobFailedError(f"{refusals_text(refused)}", "plan_gate")


def _refusal_error(refusal: Refusal) -> JobFailedError:
    return JobFailedError(f"{refusal.reason}", f"plan_{refusal.status.value}")


def steps_hash(steps: tuple[Step, ...]) -> str:
    """Short fingerprint of everything that would be sent, in its order."""
    return fingerprint((step.follow_up, step.trajectory) for step in steps)


def clearance_of(ctx: PlanContext, trajectory: JointTrajectory) -> float:
    """Smallest distance of the tool to the wall [m]; infinite without a known wall."""
    _, motion = sample_trajectory(trajectory, 0.05)
    return wall_refusal(tcp_poses(ctx.chain, motion.q), ctx.machine.T_tcp_tool, ctx.wall)[0]


def begin_drive(
    ctx: PlanContext, trajectories: list[JointTrajectory], q_ref_start: Array, text: str
) -> Generator[Request, object, None]:
    """Check the motions of a plan again, record their path under `text`, and arm.

    Raises: PlanRefusedError: the machine is not where the plan begins. JobFailedError: the wall is nearer than it was.
    """
    reading = expect_reply((yield ReadMachine()), MachineReading)
    require_reference(reading, q_ref_start)
    for trajectory in trajectories:  # a look since then may have found a wall, or found it nearer
        refuse_unsafe_reference(ctx, trajectory)
    if ctx.knowledge.q_start is None:
        ctx.knowledge.q_start = reading.q_rad
    yield Record(path_of(ctx, trajectories), text)
    yield Arm()


def require_reference(reading: MachineReading, q_ref_start: Array) -> None:
    """Raises: PlanRefusedError: the reference is not where a plan begins."""
    shift = float(np.abs(reading.q_ref_rad - q_ref_start).max())
    if shift > START_SHIFT_MAX_RAD:
        raise PlanRefusedError(
            f"the machine's reference moved by {np.rad2deg(shift):.3f} deg since the drive was planned "
            f"(limit {np.rad2deg(START_SHIFT_MAX_RAD):.3f} deg); plan again"
        )


def path_of(ctx: PlanContext, trajectories: list[JointTrajectory]) -> PathPlan:
    """Motions one after the other as a planned path, for the recording."""
    whole = join_trajectories(trajectories)
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
