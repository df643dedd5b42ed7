"""From the cell to the one state view: ages, units, and why a step is not possible now."""

from dataclasses import asdict, replace
from typing import Any

import numpy as np

from recording.clock import mono_ns
from server.api.calibration import calibration_view
from server.api.hold_rule import jog_refused, mode_of
from server.api.lease import control_view
from server.api.views import (
    CameraView,
    CompensationView,
    ErrorView,
    JobEventView,
    JobView,
    LinkView,
    LookView,
    MarkerViewOut,
    MoveView,
    PlanView,
    StateView,
)
from server.jobs.cell import Cell
from server.jobs.context import PlanContext
from server.jobs.engine import Job, JobEngine
from server.jobs.knowledge import LookTaken, PreviewedPlan
from server.jobs.plans.assurance import accuracy_text, is_inside_tolerance
from server.jobs.plans.looking import error_in_mm
from server.jobs.plans.returning import why_no_park
from server.jobs.plans.seeing import common_of, corrected_poses
from server.jobs.plans.unmoved import moved_since_look
from server.jobs.records import ErrorMm, MoveRecord
from server.version import __version__
from server.vision.contracts import PoseStatus
from server.vision.goal_error import pair_error

CAMERA_SILENT_MS = 1000.0


# The error in the newest pair, for display only: no motion is ever planned from it.


def live_error(cell: Cell, ctx: PlanContext) -> ErrorMm | None:
    """Error of the newest pair, None when tool or OOI is not seen well enough."""
    report = cell.vision.latest
    if report is None:
        return None
    tool, ooi = report.observation.tool, report.observation.ooi
    if tool.status is not PoseStatus.OK or ooi.status is not PoseStatus.OK:
        return None
    if tool.T_cam_object is None or ooi.T_cam_object is None:
        return None
    T_cam_tool, T_cam_ooi = corrected_poses(ctx, tool.T_cam_object, ooi.T_cam_object)
    tool, ooi = replace(tool, T_cam_object=T_cam_tool), replace(ooi, T_cam_object=T_cam_ooi)
    found = pair_error(tool, ooi, ctx.T_ooi_goal, common_of(ctx, T_cam_tool, T_cam_ooi))
    return error_in_mm(ctx, found, T_cam_tool, T_cam_ooi)


def state_view(cell: Cell, engine: JobEngine, ctx: PlanContext, store_problem: str = "") -> StateView:
    """The state as of now. `store_problem`: why nothing can be written down, and so no job may begin."""
    latest = cell.link.latest
    joints = cell.machine.joints
    n = len(joints)
    degrees = [round(float(np.rad2deg(value)), 4) for value in (latest.q_rad if latest else [0.0] * n)]
    references = [round(float(np.rad2deg(value)), 4) for value in (latest.q_ref_rad if latest else [0.0] * n)]
    knowledge, goal = cell.knowledge, ctx.settings.position
    return StateView(
        version=__version__,
        mode=mode_of(cell.settings.mode, latest),
        machine=cell.machine.name,
        joint_names=[joint.name for joint in joints],
        q_deg=degrees,
        q_ref_deg=references,
        q_min_deg=[float(np.rad2deg(joint.q_min_rad)) for joint in joints],
        q_max_deg=[float(np.rad2deg(joint.q_max_rad)) for joint in joints],
        link=_link_view(cell),
        camera=_camera_view(cell),
        markers=_marker_views(cell),
        live_error=error_view(live_error(cell, ctx)),
        look=_last_look_view(cell),
        calibration=calibration_view(cell, ctx, mono_ns()),
        calibration_note=knowledge.calibration_note,
        plan=plan_view(knowledge.previewed_plan, ctx) if knowledge.previewed_plan else None,
        moves=[move_view(move) for move in knowledge.moves],
        job=job_view(engine.current) if engine.current else None,
        tolerance_mm=goal.tolerance_mm,
        tolerance_deg=goal.tolerance_deg,
        stand_off_mm=goal.stand_off_mm,
        control=control_view(engine.leases),
        compensation=_compensation_view(ctx),
        steps=step_refusals(cell, engine, store_problem),
    )


def _compensation_view(ctx: PlanContext) -> CompensationView:
    known = ctx.compensation
    return (
        CompensationView()
        if known is None
        else CompensationView(active=True, effects=list(known.effects_by_use.lines()))
    )


def step_refusals(cell: Cell, engine: JobEngine, store_problem: str = "") -> dict[str, str]:
    """For each step the reason why it is not possible now; empty when it is."""
    common = _blocking_reason(cell, engine) or (
        f"the database cannot be written: {store_problem}" if store_problem else ""
    )
    look = cell.knowledge.last_look
    mode = mode_of(cell.settings.mode, cell.link.latest)
    no_look = "" if look is not None and look.error is not None else "look first"
    return {
        "look": common,
        "orient": common or no_look,
        "calibrate": common or no_look,
        "preview": common or no_look,
        "execute": common or _no_plan(cell),
        "position": common,
        "retract": common,
        "return": common or ("" if cell.knowledge.q_start is not None else "no run has begun yet"),
        "park": common or why_no_park(cell.machine) or ("" if cell.knowledge.has_looked_for_wall else "look first"),
        "jog": common or jog_refused(mode, cell.not_commissioned),
        "stop": "",
    }


def _no_plan(cell: Cell) -> str:
    """Why the previewed plan may not be executed, as `execute` itself would refuse it."""
    plan, latest = cell.knowledge.previewed_plan, cell.link.latest
    if plan is None:
        return "preview first"
    if mono_ns() > plan.expires_ns:
        return "the preview has expired: preview again"
    return "" if latest is None else moved_since_look(cell.machine, latest.q_rad, plan.q_look)


def _blocking_reason(cell: Cell, engine: JobEngine) -> str:
    job = engine.current
    if job is not None and not job.has_ended:
        return f"{job.kind} of {job.owner} is {job.state.value}"
    if cell.startup_note:
        return cell.startup_note
    health = cell.link.health
    phase = health.phase.value
    if health.other_pc and phase in ("offline", "disarmed"):  # states arrive, but the session is another PC's
        return health.other_pc
    if phase in ("offline", "fault", "local"):
        check = health.error or "check its program, cable and address, and that no other PC holds it"
        return {
            "offline": f"the PLC does not answer: {check}",
            "fault": "the PLC reports a fault: remove its cause, then reset",
            "local": "the machine is in local (lever) control",
        }[phase]
    return ""


def _link_view(cell: Cell) -> LinkView:
    health, latest = cell.link.health, cell.link.latest
    total = max(1, health.received + health.lost)
    age_ms = None if latest is None else (mono_ns() - latest.t_mono_ns) * 1e-6
    return LinkView(
        phase=health.phase.value,
        age_ms=None if age_ms is None else round(age_ms, 1),
        lost_pct=round(100.0 * health.lost / total, 2),
        round_trip_ms=round(health.round_trip_ms, 2),
        plc_state=latest.plc_state if latest else "unknown",
        buffer_ms=round(latest.buffer_us * 1e-3, 1) if latest else 0.0,
        underruns=latest.underruns if latest else 0,
        fault_bits=latest.fault_bits if latest else 0,
        simulation=latest.simulation if latest else False,
        dry_run=health.dry_run,
        last_reject=health.last_reject,
        recent_rejects=list(health.recent_rejects),
        lateness_p99_ms=round(health.lateness_p99_us * 1e-3, 3),
        warning=health.error or health.warning,
    )


def _camera_view(cell: Cell) -> CameraView:
    report = cell.vision.latest
    if report is None:
        return CameraView(fps=0.0, age_ms=None, process_ms=0.0, skipped=0, warnings=["no image yet"])
    age_ms = (mono_ns() - report.t_receive_mono_ns) * 1e-6
    warnings = list(report.warnings)
    if age_ms > CAMERA_SILENT_MS:
        warnings.append(f"no new image for {age_ms / 1e3:.1f} s: check the camera and its cable")
    return CameraView(
        fps=round(report.fps, 1),
        age_ms=round(age_ms, 1),
        process_ms=round(report.process_ms, 1),
        skipped=report.n_skipped,
        warnings=warnings,
    )


def _marker_views(cell: Cell) -> list[MarkerViewOut]:
    report = cell.vision.latest
    if report is None:
        return []
    return [
        MarkerViewOut(
            marker_id=view.marker_id,
            corners_px=np.round(view.corners_left_px, 2).tolist(),
            residual_px=round(float(np.nan_to_num(view.residual_rms_px)), 3),
            used=view.used,
            reason=view.reason,
        )
        for view in report.observation.marker_views
        if view.corners_left_px is not None
    ]


def _last_look_view(cell: Cell) -> LookView | None:
    taken = cell.knowledge.last_look
    if taken is None:
        return None
    record = taken.record
    return LookView(
        status=record.status,
        reason=record.reason,
        error=error_view(record.error),
        n_used=record.n_used,
        spread_mm=round(float(np.nan_to_num(record.spread_mm)), 3),
        age_s=round((mono_ns() - record.t_mono_ns) * 1e-9, 1),
    )


def error_view(error: ErrorMm | None) -> ErrorView | None:
    """An error of the tool as it is shown, to a micrometre."""
    if error is None:
        return None
    return ErrorView(**{name: round(value, 3) for name, value in asdict(error).items()})


def plan_view(previewed: PreviewedPlan, ctx: PlanContext | None = None) -> PlanView:
    """The previewed plan as the operator checks it."""
    plan = previewed.plan
    points = plan.Ts_base_tcp[:, :3, 3]
    picked = points[np.linspace(0, len(points) - 1, min(len(points), 60)).astype(int)]
    return PlanView(
        plan_hash=previewed.plan_hash,
        expires_in_s=round((previewed.expires_ns - mono_ns()) * 1e-9, 1),
        length_mm=round(plan.length_m * 1e3, 1),
        duration_s=round(plan.duration_s, 2),
        tcp_speed_max_mm_s=round(plan.tcp_speed_max_m_s * 1e3, 1),
        clearance_mm=round(plan.clearance_m * 1e3, 1) if np.isfinite(plan.clearance_m) else None,
        sigma_min=round(plan.sigma_min, 4),
        joint_travel_deg=[round(float(value), 2) for value in np.rad2deg(plan.joint_travel_rad)],
        predicted_sigma_mm=[round(value, 2) for value in previewed.predicted_sigma_mm],
        caution=_accuracy_warning(previewed, ctx),
        before=ErrorView(**asdict(previewed.before)),
        path_base_m=np.round(picked, 4).tolist(),
        q_goal_rad=[float(value) for value in previewed.q_goal],
    )


def _accuracy_warning(previewed: PreviewedPlan, ctx: PlanContext | None) -> str:
    """What the operator should know before Execute: an error that will not be known well enough."""
    if ctx is None or is_inside_tolerance(ctx, previewed.predicted_sigma_mm):
        return ""
    return f"{accuracy_text(ctx, previewed.predicted_sigma_mm)}; {previewed.largest_source}"


def move_view(move: MoveRecord) -> MoveView:
    """One executed move."""
    return MoveView.model_validate(asdict(move) | {"predicted_sigma_mm": list(move.predicted_sigma_mm)})


def job_view(job: Job, events_from: int = 0) -> JobView:
    """A job with its story from an event number on."""
    return JobView(
        job_id=job.job_id,
        kind=job.kind,
        owner=job.owner,
        state=job.state.value,
        code=job.code,
        reason=job.reason,
        elapsed_s=round(job.elapsed_s, 2),
        events=[JobEventView(**asdict(event)) for event in job.events if event.number > events_from],
        result=result_data(job.result),
    )


def result_data(result: object) -> object:
    """A job's result as JSON data."""
    if result is None or isinstance(result, str | dict):
        return result
    if isinstance(result, PreviewedPlan):
        return plan_view(result).model_dump()
    record: Any = result.record if isinstance(result, LookTaken) else result
    return asdict(record)
