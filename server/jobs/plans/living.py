"""The life of the calibration as the plans see it: made by a path, watched by every look, asked before every motion."""

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from machine.rotations import Array, geodesic_angle
from server.calibration.calibration_life import CalibrationValidity, LocalCalibration, LocalMap, MadeAt, ValidityStatus
from server.calibration.contracts import CameraRotationEstimate
from server.calibration.joint_estimate import JointEstimate
from server.calibration.slip_monitor import ToolSeen, judge_slip
from server.calibration.trajectory_matching_paper import METHOD_NAME as PAPER_METHOD
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.jobs.requests import MachineReading, Progress, Request
from server.vision.contracts import Look

NO_CALIBRATION_VALIDITY = CalibrationValidity(ValidityStatus.VALID)
PAPER_CALIBRATION_REASON = (
    "the calibration is one by the paper's method, which takes the mount of the machine file as it is and knows no "
    "error of it; calibrate"
)


def keep_calibration(
    ctx: PlanContext, estimate: CameraRotationEstimate, taken: LookTaken, reading: MachineReading
) -> None:
    """Keep a good estimate as the calibration of this place: where the machine rests now, the tool as last seen."""
    if estimate.R_tcp_cam is None or estimate.covariance is None:
        return
    made = MadeAt(
        t_unix_s=ctx.knowledge.unix_s(reading.t_mono_ns),
        q=np.array(reading.q_rad),
        T_base_tcp=ctx.tcp(reading.q_rad),
        oil_temperature_c=reading.oil_temperature_c,
    )
    ctx.knowledge.kept_calibration = LocalCalibration(
        machine_id=ctx.machine_id,
        method=estimate.method,
        R_tcp_cam=estimate.R_tcp_cam,
        covariance=estimate.covariance,
        p_tcp_cam_m=ctx.machine.T_tcp_cam_left[:3, 3].copy(),
        from_nominal_deg=float(np.rad2deg(geodesic_angle(ctx.machine.T_tcp_cam_left[:3, :3], estimate.R_tcp_cam))),
        time_offset_s=estimate.time_offset_s,
        residual_rms_mm=estimate.residual_rms_mm,
        residual_max_mm=estimate.residual_max_mm,
        n_used=estimate.n_used,
        path_length_m=estimate.path_length_m,
        observability=estimate.observability,
        made_at=made,
        tool_marker_pose=tool_seen(taken.raw),
        expiry=ctx.settings.calibration.expiry(),
    )


def tool_seen(look: Look) -> ToolSeen | None:
    """The tool marker of a look, None where the look has no poses."""
    if look.T_cam_tool is None or look.tool_covariance is None:
        return None
    return ToolSeen(look.T_cam_tool, look.tool_covariance)


def note_map(ctx: PlanContext, estimate: JointEstimate) -> None:
    """The joint estimate of the moment goes into the calibration that is kept and shown."""
    life, state = ctx.knowledge.kept_calibration, estimate.state
    if life is None or state is None:
        return
    found = LocalMap(
        T_tcp_cam=state.T_tcp_cam,
        T_tcp_tool=state.T_tcp_tool,
        errors=state.kinematic_errors,
        scale=state.odometry_scale,
        misfit=estimate.misfit,
        residual_rms_mm=estimate.residual_rms_mm,
        n_samples=estimate.n_samples,
        n_looks=estimate.n_looks,
    )
    ctx.knowledge.kept_calibration = replace(life, local_map=found)


def watch_slip(ctx: PlanContext, taken: LookTaken) -> Generator[Request, object, None]:
    """Every good look compares the tool marker with what it was at the calibration. The paper's method does not."""
    life, now = ctx.knowledge.kept_calibration, tool_seen(taken.raw)
    if ctx.method == "paper" or life is None or life.tool_marker_pose is None or now is None or life.slip:
        return
    verdict = judge_slip(life.tool_marker_pose, now)
    if verdict.slipped:
        ctx.knowledge.kept_calibration = replace(life, slip=verdict.reason)
        yield Progress("slip", verdict.chi2, 0.0, "", verdict.reason)
    elif verdict.shifted and not life.shift:
        ctx.knowledge.kept_calibration = replace(life, shift=verdict.reason)
        yield Progress("shift", verdict.chi2, 0.0, "", verdict.reason)


def forget_expired(ctx: PlanContext, reading: MachineReading) -> None:
    """Paths of a calibration that does not hold here and now go before a new one is driven: nothing makes them young.

    After a slip or a shift only the last look is of the mount as it is now. The calibration itself stays, and with it
    what refuses every motion by it, until a new one is made.
    """
    found = calibration_validity(ctx, reading)
    if found.ok:
        return
    ctx.knowledge.odometry_runs.clear()
    if found.status in (ValidityStatus.SLIPPED, ValidityStatus.SHIFTED):
        del ctx.knowledge.look_observations[:-1]
    ctx.knowledge.joint_estimate = None


def calibration_validity(ctx: PlanContext, reading: MachineReading) -> CalibrationValidity:
    """Whether the calibration may be used with the machine as it was read; valid where there is none."""
    return validity_at(ctx, reading, reading.q_rad, ctx.tcp(reading.q_rad))


def validity_at(ctx: PlanContext, reading: MachineReading, q: Array, T_base_tcp: Array) -> CalibrationValidity:
    """The same with the machine elsewhere, such as at its goal."""
    life: LocalCalibration | None = ctx.knowledge.kept_calibration
    if life is None or ctx.method == "paper":
        return NO_CALIBRATION_VALIDITY
    if life.method == PAPER_METHOD:
        return CalibrationValidity(ValidityStatus.OTHER_METHOD, PAPER_CALIBRATION_REASON)
    return life.valid_at(ctx.knowledge.unix_s(reading.t_mono_ns), q, T_base_tcp, reading.oil_temperature_c)


def require_valid(found: CalibrationValidity, subject: str) -> None:
    """Raises: JobFailedError saying why the calibration has expired and what to do."""
    if not found.ok:
        raise JobFailedError(f"{subject}: {found.reason}", f"calibration_{found.status.value}")
