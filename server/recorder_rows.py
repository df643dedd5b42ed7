"""From what link, camera and jobs hand over to the rows of a recording."""

import json
import math
from dataclasses import fields, is_dataclass
from enum import Enum

import numpy as np

from machine.chain import Chain
from machine.kinematics import link_poses
from machine.rotations import Array, quat_wxyz_from_rotation
from recording.foxglove import LEFT_CAMERA_FRAME_ID, FramePose
from recording.rows import (
    NAN,
    CalibrationRow,
    CameraState,
    Finding,
    Floats,
    LookRow,
    MarkerCorners,
    MarkerPose,
    OdometryRow,
    PlanRow,
    PlcState,
    Row,
)
from server.calibration.contracts import CameraRotationEstimate
from server.camera.contracts import FrameReport
from server.link.contracts import PlcSample
from server.motion.contracts import PathPlan
from server.vision.contracts import Look, MarkerView, ObjectPose, OdometryPose


def _flattened_floats(array: Array | None) -> Floats:
    return () if array is None else tuple(np.asarray(array, float).ravel().tolist())


def plc_row(sample: PlcSample) -> PlcState:
    """One PLC state."""
    return PlcState(
        t_plc_s=sample.t_plc_ns * 1e-9,
        seq_received=sample.seq,
        q_ref_rad=sample.q_ref_rad,
        qd_ref_rad_s=sample.qd_ref_rad_s,
        q_rad=sample.q_rad,
        u_frac=sample.valve_frac,
        p_a_pa=sample.pressure_a_pa,
        p_b_pa=sample.pressure_b_pa,
        p_supply_pa=sample.pressure_supply_pa,
        t_oil_c=sample.oil_temperature_c,
        t_receive_pc_s=sample.t_mono_ns * 1e-9,
        qd_rad_s=sample.qd_rad_s,
        plc_state=sample.plc_state,
        traj_id=sample.traj_id,
        knot_playing=sample.knot_playing,
        fault_bits=sample.fault_bits,
    )


def report_rows(report: FrameReport) -> list[Row]:
    """Everything numeric of one stereo pair."""
    observation = report.observation
    t_camera_s = observation.t_exposure_ns * 1e-9
    rows: list[Row] = [
        CameraState(
            t_camera_s=t_camera_s,
            t_receive_pc_s=report.t_receive_mono_ns * 1e-9,
            sequence=report.sequence,
            fps_hz=report.fps,
            process_ms=report.process_ms,
            skipped=report.n_skipped,
            sharpness=report.sharpness,
            warnings="; ".join((*report.warnings, *observation.warnings)),
        ),
        _marker_pose(observation.tool, t_camera_s),
        _marker_pose(observation.ooi, t_camera_s),
    ]
    for view in observation.marker_views:
        for eye, corners in (("left", view.corners_left_px), ("right", view.corners_right_px)):
            if corners is not None:
                rows.append(_marker_corners_row(view, eye, corners, t_camera_s))
    if report.odometry is not None:
        rows.append(odometry_row(report.odometry))
    return rows


def _marker_corners_row(view: MarkerView, eye: str, corners: Array, t_camera_s: float) -> MarkerCorners:
    u0, v0, u1, v1, u2, v2, u3, v3 = _flattened_floats(corners)
    return MarkerCorners(
        t_camera_s, eye, view.marker_id, u0, v0, u1, v1, u2, v2, u3, v3, view.residual_rms_px, view.used, view.reason
    )


def _marker_pose(pose: ObjectPose, t_camera_s: float) -> MarkerPose:
    sigma = () if pose.covariance is None else _flattened_floats(np.sqrt(np.diag(pose.covariance)))
    return MarkerPose(
        t_camera_s=t_camera_s,
        on=pose.object_name,
        status=pose.status.value,
        reason=pose.reason,
        T_cam_object=_flattened_floats(pose.T_cam_object),
        sigma_rotation_rad=sigma[:3],
        sigma_translation_m=sigma[3:],
        residual_rms_px=pose.residual_rms_px,
    )


def odometry_row(pose: OdometryPose) -> OdometryRow:
    """One odometry pose."""
    x, y, z = _flattened_floats(pose.T_vo_cam[:3, 3])
    w, i, j, k = _flattened_floats(quat_wxyz_from_rotation(pose.T_vo_cam[:3, :3]))
    covariance = _flattened_floats(pose.covariance)
    return OdometryRow(pose.t_exposure_ns * 1e-9, x, y, z, w, i, j, k, pose.status.value, pose.n_points, covariance)


def look_row(look: Look, t_pc_s: float, error: Floats = (NAN, NAN, NAN, NAN)) -> LookRow:
    """One look; `error` is x, y, z [mm] and rotation [deg]."""
    return LookRow(
        t_pc_s=t_pc_s,
        status=look.status.value,
        reason=look.reason,
        T_cam_tool=_flattened_floats(look.T_cam_tool),
        T_cam_ooi=_flattened_floats(look.T_cam_ooi),
        tool_covariance=_flattened_floats(look.tool_covariance),
        ooi_covariance=_flattened_floats(look.ooi_covariance),
        n_pairs=look.n_pairs,
        n_used=look.n_used,
        spread_mm=look.spread_mm,
        error_x_mm=error[0],
        error_y_mm=error[1],
        error_z_mm=error[2],
        error_rotation_deg=error[3],
    )


def calibration_row(estimate: CameraRotationEstimate, t_pc_s: float) -> CalibrationRow:
    """One local calibration."""
    return CalibrationRow(
        t_pc_s=t_pc_s,
        status=estimate.status.value,
        reason=estimate.reason,
        method=estimate.method,
        R_tcp_cam=_flattened_floats(estimate.R_tcp_cam),
        covariance=_flattened_floats(estimate.covariance),
        time_offset_s=estimate.time_offset_s,
        residual_rms_mm=estimate.residual_rms_mm,
        residual_max_mm=estimate.residual_max_mm,
        n_used=estimate.n_used,
        observability=estimate.observability,
        path_length_m=estimate.path_length_m,
    )


def plan_row(plan: PathPlan, t_pc_s: float) -> PlanRow:
    """One planned path with the knots of its reference."""
    trajectory = plan.trajectory
    return PlanRow(
        t_pc_s=t_pc_s,
        status=plan.status.value,
        reason=plan.reason,
        length_m=plan.length_m,
        duration_s=plan.duration_s,
        tcp_speed_max_m_s=plan.tcp_speed_max_m_s,
        clearance_m=plan.clearance_m,
        sigma_min=plan.sigma_min,
        q_end_rad=_flattened_floats(plan.q_end),
        knot_t_s=() if trajectory is None else _flattened_floats(trajectory.t_s),
        knot_q_rad=() if trajectory is None else _flattened_floats(trajectory.q),
    )


def finding_row(item: object, t_pc_s: float, text: str = "") -> Finding:
    """Anything else: its type's name, and its fields as JSON. A plain text becomes the text itself."""
    if isinstance(item, str):
        return Finding(t_pc_s, "text", item, "")
    return Finding(t_pc_s, type(item).__name__, text, json.dumps(_json_value(item), allow_nan=False))


def _json_value(value: object) -> object:
    """Frozen dataclasses, arrays and enums as what JSON knows; numbers that are not finite become null."""
    if is_dataclass(value):
        return {each.name: _json_value(getattr(value, each.name)) for each in fields(value)}
    if isinstance(value, np.ndarray):
        return _json_value(value.tolist())
    if isinstance(value, Enum):
        return _json_value(value.value)
    if isinstance(value, list | tuple):
        return [_json_value(each) for each in value]
    if isinstance(value, dict):
        return {str(key): _json_value(each) for key, each in value.items()}
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, bool | int | str) or value is None:
        return value
    return str(value)


def frame_poses(chain: Chain, T_tcp_cam_left: Array, q_rad: Floats) -> list[FramePose]:
    """The transform tree base -> link_1 ... -> tcp -> cam_left at these encoder readings."""
    poses = link_poses(chain, np.array(q_rad))
    edges: list[FramePose] = []
    parent = "base"
    for number in range(1, len(poses)):
        child = f"link_{number}"
        edges.append(_frame_pose_row(parent, child, np.linalg.inv(poses[number - 1]) @ poses[number]))
        parent = child
    edges.append(_frame_pose_row(parent, "tcp", chain.T_flange_tcp))
    edges.append(_frame_pose_row("tcp", LEFT_CAMERA_FRAME_ID, T_tcp_cam_left))
    return edges


def _frame_pose_row(parent: str, child: str, T_parent_child: Array) -> FramePose:
    x, y, z = _flattened_floats(T_parent_child[:3, 3])
    w, i, j, k = _flattened_floats(quat_wxyz_from_rotation(T_parent_child[:3, :3]))
    return FramePose(parent, child, (x, y, z), (w, i, j, k))
