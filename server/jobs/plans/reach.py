"""Reach preview: whether the job could bring the tool to a candidate target, by the planner's own checks."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from machine.poses import inverse_pose
from machine.rotations import Array, geodesic_angle
from server.calibration.contracts import CalibrationStatus, CameraRotationEstimate
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.jobs.plans.approaching import approach_pose, farther_goal, goal_pose
from server.jobs.plans.calibrating import possible_path
from server.jobs.plans.living import keep_calibration, validity_at
from server.jobs.plans.looking import mount_rotation, ooi_in_base
from server.jobs.plans.orienting import ORIENTATION_ERROR_OK_DEG, orientation_goal
from server.jobs.plans.planning import plan_to
from server.jobs.plans.seeing import common_of, require_judgeable
from server.jobs.records import LookRecord
from server.jobs.requests import MachineReading
from server.motion.contracts import PathPlan, PlanStatus
from server.targets.contracts import AnchoredTarget
from server.targets.taught import TaughtObject
from server.vision.contracts import Look, LookStatus, ObjectPose
from server.vision.goal_error import pose_error_covariance


@dataclass(frozen=True, slots=True)
class ReachPreview:
    """Whether a job on the candidate would be planned from here; `reason` states what refuses it, or is unknown."""

    status: Literal["reachable", "refused", "unknown"]
    reason: str = ""


def reach_preview(
    ctx: PlanContext,
    reading: MachineReading,
    tool: ObjectPose,
    target: AnchoredTarget | TaughtObject,
    T_cam_target: Array,
) -> ReachPreview:
    """Plans the job on a candidate: orientation, approach, calibration path, move. Nothing moves or is kept.

    Model:   the legs of `position`, each from where the one before ends; tool and camera are rigidly joined, so a leg
             changes only the target's pose in the camera.
    Args:    reading: where the machine rests, as in the image that shows the target at T_cam_target (4, 4).
             tool: as seen there.
    Returns: `reachable`; `refused` with the first leg's reason; `unknown` where the tool was not seen.
    """
    if tool.T_cam_object is None or tool.covariance is None:
        return ReachPreview("unknown", f"reach is not known: the tool is not seen ({tool.reason}); clear its markers")
    ctx = _what_if(ctx, target)
    taken = _as_if_looked(reading, tool, target, T_cam_target)
    ctx.knowledge.T_base_ooi = ooi_in_base(ctx, taken)
    try:
        taken = _look_after_orienting(ctx, taken)
        taken = _look_after_approach(ctx, taken)
        _as_if_calibrated(ctx, taken)
        _to_goal(ctx, taken)
        require_judgeable(ctx, taken)
        _require_judgeable_angle(ctx, taken)
    except JobFailedError as error:
        return ReachPreview("refused", str(error))
    return ReachPreview("reachable")


def _what_if(ctx: PlanContext, target: AnchoredTarget | TaughtObject) -> PlanContext:
    """The context as it would be with this target in use: a copy, so that nothing of the preview is kept."""
    known = replace(
        ctx.knowledge,
        target=target,
        last_look=None,
        previewed_plan=None,
        joint_estimate=None,
        mount_rotation_estimate=None,
        moves=[],
        odometry_runs=[],
        look_observations=[],
    )
    return replace(ctx, knowledge=known)


def _as_if_looked(
    reading: MachineReading, tool: ObjectPose, target: AnchoredTarget | TaughtObject, T_cam_target: Array
) -> LookTaken:
    """One pair's poses as a look."""
    t_ns = reading.t_mono_ns
    covariance = target.covariance_target
    look = Look(LookStatus.OK, "", tool.T_cam_object, T_cam_target, tool.covariance, covariance, 1, 1, t_ns, t_ns, 0.0)
    record = LookRecord(look.status.value, "", None, 1, 0.0, reading.t_plc_ns, t_ns)
    return LookTaken(look=look, reading=reading, error=None, record=record, raw=look)


def _look_after_orienting(ctx: PlanContext, taken: LookTaken) -> LookTaken:
    """As it would be seen after the orientation step; the same where none is needed."""
    look = taken.look
    if look.T_cam_tool is None or look.T_cam_ooi is None:
        raise ValueError("a look without poses")
    if np.rad2deg(geodesic_angle(look.T_cam_tool[:3, :3], look.T_cam_ooi[:3, :3])) < ORIENTATION_ERROR_OK_DEG:
        return taken
    return _look_after(ctx, taken, orientation_goal(ctx, taken), "turning to the target")


def _look_after_approach(ctx: PlanContext, taken: LookTaken) -> LookTaken:
    """As it would be seen after the approach; the same where none is needed."""
    T_approach = approach_pose(ctx, taken)
    return taken if T_approach is None else _look_after(ctx, taken, T_approach, "approach to the target")


def _look_after(ctx: PlanContext, taken: LookTaken, T_base_tcp: Array, purpose: str) -> LookTaken:
    look = taken.look
    if look.T_cam_tool is None or look.T_cam_ooi is None:
        raise ValueError("a look without poses")
    T_before = ctx.tcp(taken.reading.q_rad)
    plan = _require_plan(plan_to(ctx, taken.reading, T_base_tcp), purpose)
    T_after = ctx.tcp(plan.q_end)
    T_tcp_tool = ctx.machine.T_tcp_tool
    moved = inverse_pose(T_after @ T_tcp_tool) @ T_before @ T_tcp_tool  # T_tool-after_tool-before
    T_tool_ooi = moved @ inverse_pose(look.T_cam_tool) @ look.T_cam_ooi
    reading = replace(taken.reading, q_rad=plan.q_end, q_ref_rad=_reference_end(plan))
    return replace(taken, look=replace(look, T_cam_ooi=look.T_cam_tool @ T_tool_ooi), reading=reading)


def _to_goal(ctx: PlanContext, taken: LookTaken) -> PathPlan:
    T_goal = goal_pose(ctx, taken)
    plan = _require_plan(plan_to(ctx, taken.reading, T_goal), "move to the target")
    found = validity_at(ctx, taken.reading, plan.q_end, farther_goal(ctx, taken, T_goal))
    if not found.ok:
        raise JobFailedError(
            f"too far from here: at the goal {found.reason}. Move the tool nearer first, or choose a nearer place",
            f"calibration_{found.status.value}",
        )
    return plan


def _as_if_calibrated(ctx: PlanContext, taken: LookTaken) -> None:
    """The calibration path is possible; what it would give holds around the place where it is driven."""
    plan, _ = possible_path(ctx, taken.reading)
    mount = CameraRotationEstimate(
        CalibrationStatus.OK,
        "",
        "preview",
        mount_rotation(ctx, taken),
        np.zeros((3, 3)),
        0.0,
        0.0,
        0.0,
        0,
        1.0,
        plan.length_m,
    )
    keep_calibration(ctx, mount, taken, taken.reading)


def _require_judgeable_angle(ctx: PlanContext, taken: LookTaken) -> None:
    """A look at the goal must be able to show that the tool is turned as it should be.

    Raises: JobFailedError: two sigma of the angle alone, with the target's part, exceed the tolerance.
    """
    T_cam_tool = taken.look.T_cam_tool
    if T_cam_tool is None:
        raise ValueError("a look without poses")
    T_cam_goal = T_cam_tool @ inverse_pose(ctx.T_ooi_goal)
    covariance = pose_error_covariance(T_cam_tool, T_cam_goal, common_of(ctx, T_cam_tool, T_cam_goal))
    goal = ctx.settings.position
    sigma_deg = float(np.rad2deg(np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:]).max())))
    two_sigma_deg = 2.0 * float(np.hypot(sigma_deg, goal.sigma_systematic_deg))
    if two_sigma_deg > goal.tolerance_deg:
        raise JobFailedError(
            f"a look at the goal would know the angle to +-{two_sigma_deg:.1f} deg only (2 sigma, allowed "
            f"{goal.tolerance_deg:g}); choose a flatter place with more texture, or come nearer",
            "sigma_too_large",
        )


def _require_plan(plan: PathPlan, purpose: str) -> PathPlan:
    if plan.status is not PlanStatus.OK:
        raise JobFailedError(f"{purpose}: {plan.reason}", f"plan_{plan.status.value}")
    return plan


def _reference_end(plan: PathPlan) -> Array:
    if plan.trajectory is None:
        raise ValueError("a plan without a trajectory")
    return plan.trajectory.q[-1]
