"""A local calibration for other programs: YAML, and the static transform of ROS."""

from datetime import UTC, datetime

import numpy as np
import yaml

from machine.rotations import quat_wxyz_from_rotation
from server.calibration.calibration_life import CalibrationValidity, LocalCalibration, observability_text

PARENT, CHILD = "tcp", "cam_left"


def as_yaml(calibration: LocalCalibration, validity: CalibrationValidity) -> str:
    """Everything that a person or a program may ask of it, units in the names."""
    made, limits = calibration.made_at, calibration.expiry
    translation, quat_wxyz = _mount_translation_quaternion(calibration)
    body = {
        "format": "longreach calibration export",
        "version": 1,
        "machine_id": calibration.machine_id,
        "valid": validity.ok,
        "expiry_reason": validity.reason,
        "method": calibration.method,
        "made": {
            "utc": datetime.fromtimestamp(made.t_unix_s, UTC).isoformat(timespec="seconds"),
            "q_deg": _rounded_list(np.rad2deg(made.q), 4),
            "p_base_tcp_m": _rounded_list(made.T_base_tcp[:3, 3], 5),
            "oil_temperature_c": made.oil_temperature_c,
        },
        "T_tcp_cam_left": {"translation_m": translation, "quat_wxyz": quat_wxyz},
        "rotation_covariance_rad2": [_rounded_list(row, 12) for row in calibration.covariance],
        "rotation_sigmas_deg": _rounded_list(np.rad2deg(calibration.sigmas_rad), 4),
        "observability": round(calibration.observability, 5),
        "observability_text": observability_text(calibration),
        "residual_rms_mm": round(calibration.residual_rms_mm, 4),
        "residual_max_mm": round(calibration.residual_max_mm, 4),
        "n_used": calibration.n_used,
        "path_length_m": round(calibration.path_length_m, 4),
        "time_offset_ms": round(1e3 * calibration.time_offset_s, 3),
        "valid_within": {
            "radius_mm": round(1e3 * limits.radius_m, 1),
            "turn_deg": round(float(np.rad2deg(limits.turn_rad)), 2),
            "joint_deg": round(float(np.rad2deg(limits.joint_rad)), 2),
            "age_h": round(limits.age_max_s / 3600.0, 3),
            "temperature_k": limits.temperature_k,
        },
    }
    return yaml.safe_dump(body, sort_keys=False, allow_unicode=True)


def as_ros(calibration: LocalCalibration, validity: CalibrationValidity) -> str:
    """The mount as geometry_msgs/TransformStamped in YAML, with the command that publishes it as a comment."""
    (x, y, z), (w, i, j, k) = _mount_translation_quaternion(calibration)
    t_s = calibration.made_at.t_unix_s
    stamp = {"sec": int(t_s // 1), "nanosec": int((t_s % 1) * 1e9)}
    transform = {
        "header": {"stamp": stamp, "frame_id": PARENT},
        "child_frame_id": CHILD,
        "transform": {"translation": {"x": x, "y": y, "z": z}, "rotation": {"x": i, "y": j, "z": k, "w": w}},
    }
    state = "valid" if validity.ok else f"EXPIRED: {validity.reason}"
    command = (
        f"ros2 run tf2_ros static_transform_publisher --x {x} --y {y} --z {z} "
        f"--qx {i} --qy {j} --qz {k} --qw {w} --frame-id {PARENT} --child-frame-id {CHILD}"
    )
    return f"# {state}\n# {command}\n" + yaml.safe_dump({"transforms": [transform]}, sort_keys=False)


def _mount_translation_quaternion(calibration: LocalCalibration) -> tuple[list[float], list[float]]:
    """Translation [m] and quaternion wxyz of T_tcp_cam: the joint estimate's lever where there is one."""
    found = calibration.local_map
    R = calibration.R_tcp_cam if found is None else found.T_tcp_cam[:3, :3]
    p = calibration.p_tcp_cam_m if found is None else found.T_tcp_cam[:3, 3]
    return _rounded_list(p, 6), _rounded_list(quat_wxyz_from_rotation(R), 9)


def _rounded_list(values: np.ndarray, digits: int) -> list[float]:
    return [round(float(value), digits) for value in values]
