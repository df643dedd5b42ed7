"""Calibrate locally (section 3.2.2): drive a short path, match the camera's own trajectory to the encoders' TCP."""

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from machine.rotations import geodesic_angle
from server.calibration.contracts import CalibrationStatus, CameraRotationEstimate, CameraTrack, EncoderTrack
from server.calibration.trajectory_matching import (
    DEFAULT_MATCHING_SETTINGS,
    estimate_camera_rotation,
    prior_from_tool_marker,
)
from server.calibration.trajectory_matching_paper import estimate_camera_rotation_paper
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.jobs.plans.diagnosed import believed_track, diagnosed_mount
from server.jobs.plans.learning import joint_estimate, remember_run, remember_side, side_now
from server.jobs.plans.living import forget_expired, keep_calibration
from server.jobs.plans.planning import onto_reference, plan_settings
from server.jobs.plans.seeing import focal_found, refuted_inputs
from server.jobs.records import CalibrationRecord
from server.jobs.requests import (
    Arm,
    MachineReading,
    Move,
    PairTiming,
    Progress,
    Record,
    Request,
    Settle,
    StartOdometry,
    StopOdometry,
    TimePairs,
    expect_reply,
)
from server.motion.calibration_paths import plan_calibration_path
from server.motion.camera_pace import CameraNeeds, camera_paced
from server.motion.contracts import JointTrajectory, PathPlan, PlanStatus
from server.vision.odometry_align import ALIGNMENT_SHIFT_MAX_PX


def calibrate(ctx: PlanContext, taken: LookTaken) -> Generator[Request, object, CalibrationRecord]:
    """Drive the path with odometry on, match, and keep the result as the mount's rotation here."""
    reading = expect_reply((yield Settle()), MachineReading)
    remember_side(ctx, reading)
    before = side_now(ctx)
    nominal, _ = possible_path(ctx, reading)
    forget_expired(ctx, reading)
    yield Progress("calibrate", 0.0, nominal.duration_s, "s", "the camera begins to measure its own motion")
    yield Arm()
    yield StartOdometry()
    timing = expect_reply((yield TimePairs()), PairTiming)
    plan = camera_paced(ctx.machine, nominal, timing.interval_s, camera_needs(ctx, taken), plan_settings(ctx))
    plan, trajectory = driven_path(ctx, reading, plan)
    text = f"driving a {plan.length_m:.2f} m path in {plan.duration_s:.0f} s"
    if plan.duration_s > nominal.duration_s:
        text = (
            f"{text}, slowed from {nominal.duration_s:.0f} s: the camera gives a pair every {timing.interval_s:.2f} s"
        )
    yield Progress("calibrate", 0.0, plan.duration_s, "s", text)
    yield Move(trajectory, "calibration path")
    rested = expect_reply((yield Settle()), MachineReading)
    tracks = expect_reply((yield StopOdometry()), tuple)
    camera, encoder = tracks
    estimate = match_trajectories(ctx, taken, camera, believed_track(ctx, encoder, before))
    record = describe_calibration(ctx, estimate, plan.duration_s)
    yield Record(estimate)
    if estimate.status is not CalibrationStatus.OK:
        raise JobFailedError(f"calibration failed ({estimate.status.value}): {estimate.reason}", "calibration_failed")
    ctx.knowledge.mount_rotation_estimate = estimate
    keep_calibration(ctx, estimate, taken, rested)
    remember_run(ctx, camera, encoder, before)
    ctx.knowledge.calibration_record = record = _with_focal(ctx, record)
    text = f"camera rotation known to {record.sigma_deg:.2f} deg, {record.time_offset_ms:.0f} ms to add to camera time"
    yield Progress("calibrate", plan.duration_s, plan.duration_s, "s", "; ".join(filter(None, (text, record.reason))))
    return record


def _with_focal(ctx: PlanContext, record: CalibrationRecord) -> CalibrationRecord:
    """The record with the camera's focal length as this path, the encoders and the looks show it."""
    if ctx.method == "paper" or ctx.settings.position.local_map != "learnt":
        return record
    joint_estimate(ctx)
    focal = focal_found(ctx)
    if focal is None:
        return record
    off_pct, sigma_pct = (100.0 * value for value in focal)
    return replace(record, focal_off_pct=off_pct, focal_sigma_pct=sigma_pct, reason=refuted_inputs(ctx))


def possible_path(ctx: PlanContext, reading: MachineReading) -> tuple[PathPlan, JointTrajectory]:
    """The calibration path from where the machine stands, at full speed, and its motion.

    Raises: JobFailedError: none is possible here.
    """
    plan = plan_path(ctx, reading)
    return plan, driven_path(ctx, reading, plan)[1]


def driven_path(ctx: PlanContext, reading: MachineReading, nominal: PathPlan) -> tuple[PathPlan, JointTrajectory]:
    """The same path as a path of the reference, and its motion. Raises: JobFailedError: the plan is a refusal."""
    plan = onto_reference(ctx, nominal, reading)
    if plan.status is not PlanStatus.OK or plan.trajectory is None:
        raise JobFailedError(f"calibration path: {plan.reason}", f"plan_{plan.status.value}")
    return plan, plan.trajectory


def plan_path(ctx: PlanContext, reading: MachineReading) -> PathPlan:
    """The calibration path of the method for the encoders, from where the machine stands, back to it."""
    kind = "paper" if ctx.method == "paper" else "folded"
    return plan_calibration_path(
        ctx.machine, reading.q_rad, kind, plan_settings(ctx), ctx.wall, ctx.knowledge.T_base_ooi
    )


def camera_needs(ctx: PlanContext, taken: LookTaken) -> CameraNeeds:
    """What odometry and matching need of the pairs here: what is looked at is as far away as the OOI."""
    T_cam_ooi = taken.look.T_cam_ooi
    return CameraNeeds(
        shift_max_px=ALIGNMENT_SHIFT_MAX_PX,
        focal_px=ctx.machine.camera.fx_px,
        depth_m=ctx.settings.position.stand_off_mm * 1e-3 if T_cam_ooi is None else float(T_cam_ooi[2, 3]),
        chord_m=DEFAULT_MATCHING_SETTINGS.chord_m,
        chords_min=DEFAULT_MATCHING_SETTINGS.chords_min,
    )


def match_trajectories(
    ctx: PlanContext, taken: LookTaken, camera: CameraTrack, encoder: EncoderTrack
) -> CameraRotationEstimate:
    """Trajectory matching, ours or the paper's."""
    T_tcp_cam = ctx.machine.T_tcp_cam_left
    if ctx.method == "paper":
        return estimate_camera_rotation_paper(camera, encoder, T_tcp_cam[:3, :3])
    prior = diagnosed_mount(ctx)
    if prior is None and taken.look.T_cam_tool is not None:
        sigma_rad = float(np.deg2rad(ctx.settings.position.sigma_tool_mount_deg))
        prior = prior_from_tool_marker(ctx.machine.T_tcp_tool[:3, :3], taken.look.T_cam_tool[:3, :3], sigma_rad)
    return estimate_camera_rotation(camera, encoder, T_tcp_cam, prior)


def describe_calibration(ctx: PlanContext, estimate: CameraRotationEstimate, duration_s: float) -> CalibrationRecord:
    """The estimate in the operator's units; NaN-free so that it can go out as JSON."""
    sigma_deg = from_nominal_deg = 0.0
    if estimate.R_tcp_cam is not None and estimate.covariance is not None:
        sigma_deg = float(np.rad2deg(np.sqrt(np.linalg.eigvalsh(estimate.covariance).max())))
        from_nominal_deg = float(np.rad2deg(geodesic_angle(ctx.machine.T_tcp_cam_left[:3, :3], estimate.R_tcp_cam)))
    return CalibrationRecord(
        method=estimate.method,
        status=estimate.status.value,
        reason=estimate.reason,
        sigma_deg=sigma_deg,
        from_nominal_deg=from_nominal_deg,
        time_offset_ms=estimate.time_offset_s * 1e3,
        residual_rms_mm=estimate.residual_rms_mm,
        n_used=estimate.n_used,
        observability=estimate.observability,
        duration_s=duration_s,
    )
