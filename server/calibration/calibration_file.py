"""A local calibration as text with a format version: what was written is read back equal, anything else is an error.

The runs of the calibration paths go along: the joint estimate is made again from them, so that a newer estimator gains
from an older file. Looks do not: the object of interest may be another one by then.
"""

import json
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from server.calibration.calibration_life import CalibrationExpiry, LocalCalibration, LocalMap, MadeAt
from server.calibration.checks import CalibrationInputError, require_covariance, require_pose, require_rotation
from server.calibration.contracts import Array, CameraTrack
from server.calibration.joint_observations import JointTrack, OdometryRun
from server.calibration.slip_monitor import ToolSeen

FILE_FORMAT_NAME = "longreach local calibration"
FILE_FORMAT_VERSION = 1
# Joints are kept this far apart: at 0.2 m/s^2 a straight line between them is 0.04 mm off
ENCODER_SAMPLE_PERIOD_S = 0.04
SAVED_DECIMALS = 10

Numbers = list[float]
Matrix = list[Numbers]
Positive = Annotated[float, Field(gt=0.0)]


class CalibrationFileError(ValueError):
    """Not a calibration file of this format version; the text says what is wrong and what to do."""


@dataclass(frozen=True, slots=True)
class SavedCalibration:
    """What a file holds."""

    calibration: LocalCalibration
    odometry_runs: tuple[OdometryRun, ...] = ()


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class _CalibrationConditions(_Part):
    t_unix_s: float
    q_rad: Numbers
    T_base_tcp: Matrix
    oil_temperature_c: float | None


class _ToolPose(_Part):
    T_cam_tool: Matrix
    covariance: Matrix


class _MapCalibration(_Part):
    T_tcp_cam: Matrix
    T_tcp_tool: Matrix
    errors: Numbers
    scale: float
    misfit: float
    residual_rms_mm: float
    n_samples: int
    n_looks: int


class _Expiry(_Part):
    radius_m: Positive
    turn_rad: Positive
    joint_rad: Positive
    age_max_s: Positive
    temperature_k: Positive


class _RecordedRun(_Part):
    camera_t_s: Numbers
    Ts_vo_cam: list[Matrix]
    joints_t_s: Numbers
    qs_rad: Matrix
    sides: Matrix | None


class _CalibrationFile(_Part):
    format: Literal["longreach local calibration"]
    version: Literal[1]
    machine_id: str
    method: str
    R_tcp_cam: Matrix
    covariance_rad2: Matrix
    p_tcp_cam_m: Annotated[Numbers, Field(min_length=3, max_length=3)]
    from_nominal_deg: float
    time_offset_s: float
    residual_rms_mm: float
    residual_max_mm: float
    n_used: int
    path_length_m: float
    observability: float
    made: _CalibrationConditions
    tool: _ToolPose | None
    local_map: _MapCalibration | None
    expiry: _Expiry
    slip: str
    shift: str = ""  # files of before had none
    runs: list[_RecordedRun]


def calibration_text(saved: SavedCalibration) -> str:
    """The file's text (JSON)."""
    one, made, tool, found = (
        saved.calibration,
        saved.calibration.made_at,
        saved.calibration.tool_marker_pose,
        saved.calibration.local_map,
    )
    body = {
        "format": FILE_FORMAT_NAME,
        "version": FILE_FORMAT_VERSION,
        **{name: getattr(one, name) for name in _PLAIN},
        "R_tcp_cam": one.R_tcp_cam.tolist(),
        "covariance_rad2": one.covariance.tolist(),
        "p_tcp_cam_m": one.p_tcp_cam_m.tolist(),
        "made": {
            "t_unix_s": made.t_unix_s,
            "q_rad": made.q.tolist(),
            "T_base_tcp": made.T_base_tcp.tolist(),
            "oil_temperature_c": made.oil_temperature_c,
        },
        "tool": tool and {"T_cam_tool": tool.T_cam_tool.tolist(), "covariance": tool.covariance.tolist()},
        "local_map": found and {name: _array_as_list(getattr(found, name)) for name in _MapCalibration.model_fields},
        "expiry": {name: getattr(one.expiry, name) for name in _Expiry.model_fields},
        "runs": [_run_body(run) for run in saved.odometry_runs],
    }
    return json.dumps(body, allow_nan=False)


_PLAIN = (
    "machine_id",
    "method",
    "from_nominal_deg",
    "time_offset_s",
    "residual_rms_mm",
    "residual_max_mm",
    "n_used",
    "path_length_m",
    "observability",
    "slip",
    "shift",
)


def _array_as_list(value: object) -> object:
    return value.tolist() if isinstance(value, np.ndarray) else value


def _run_body(run: OdometryRun) -> dict[str, object]:
    joints = run.joint_track
    step = (
        max(1, round(ENCODER_SAMPLE_PERIOD_S / max(float(np.median(np.diff(joints.t_s))), 1e-6)))
        if len(joints.t_s) > 1
        else 1
    )
    keep = np.unique(np.append(np.arange(0, len(joints.t_s), step), len(joints.t_s) - 1))
    return {
        "camera_t_s": run.camera_track.t_s.tolist(),
        "Ts_vo_cam": np.round(run.camera_track.Ts_vo_cam, SAVED_DECIMALS).tolist(),
        "joints_t_s": joints.t_s[keep].tolist(),
        "qs_rad": np.round(joints.qs[keep], SAVED_DECIMALS).tolist(),
        "sides": None if joints.backlash_sides is None else np.round(joints.backlash_sides[keep], 6).tolist(),
    }


def parse_calibration(text: str) -> SavedCalibration:
    """The calibration that a file's text holds.

    Raises: CalibrationFileError: not ours, another format version, damaged, or values that cannot be.
    """
    try:
        body = json.loads(text)
    except ValueError as error:
        raise CalibrationFileError(f"calibration file is damaged ({error}); calibrate again") from error
    if not isinstance(body, dict) or body.get("format") != FILE_FORMAT_NAME:
        raise CalibrationFileError(f"not a '{FILE_FORMAT_NAME}' file; give one written by longreach")
    if body.get("version") != FILE_FORMAT_VERSION:
        raise CalibrationFileError(
            f"calibration file has format version {body.get('version')!r}, this program reads {FILE_FORMAT_VERSION}; "
            "calibrate again"
        )
    try:
        return _read(_CalibrationFile.model_validate(body))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise CalibrationFileError(f"calibration file: {where}: {first['msg']}; calibrate again") from error
    except (CalibrationInputError, ValueError) as error:
        raise CalibrationFileError(f"calibration file: {error}; calibrate again") from error


def _read(file: _CalibrationFile) -> SavedCalibration:
    made, tool, found = file.made, file.tool, file.local_map
    calibration = LocalCalibration(
        **{name: getattr(file, name) for name in _PLAIN},
        R_tcp_cam=require_rotation(np.array(file.R_tcp_cam), "R_tcp_cam"),
        covariance=require_covariance(np.array(file.covariance_rad2), 3, "covariance_rad2"),
        p_tcp_cam_m=np.array(file.p_tcp_cam_m),
        made_at=MadeAt(
            made.t_unix_s, np.array(made.q_rad), _checked_pose(made.T_base_tcp, "T_base_tcp"), made.oil_temperature_c
        ),
        tool_marker_pose=None if tool is None else _tool_from_record(tool),
        local_map=None if found is None else _local_map_from_record(found),
        expiry=CalibrationExpiry(**file.expiry.model_dump()),
    )
    return SavedCalibration(calibration, tuple(_run(run) for run in file.runs))


def _checked_pose(rows: Matrix, subject: str) -> Array:
    return require_pose(np.array(rows), subject)


def _tool_from_record(tool: _ToolPose) -> ToolSeen:
    return ToolSeen(
        _checked_pose(tool.T_cam_tool, "T_cam_tool"),
        require_covariance(np.array(tool.covariance), 6, "tool.covariance"),
    )


def _local_map_from_record(found: _MapCalibration) -> LocalMap:
    numbers = found.model_dump(exclude={"T_tcp_cam", "T_tcp_tool", "errors"})
    return LocalMap(
        _checked_pose(found.T_tcp_cam, "T_tcp_cam"),
        _checked_pose(found.T_tcp_tool, "T_tcp_tool"),
        np.array(found.errors),
        **numbers,
    )


def _run(run: _RecordedRun) -> OdometryRun:
    camera_t, joints_t, qs = np.array(run.camera_t_s), np.array(run.joints_t_s), np.array(run.qs_rad)
    Ts = np.array(run.Ts_vo_cam)
    sides = None if run.sides is None else np.array(run.sides)
    if Ts.shape != (len(camera_t), 4, 4) or qs.ndim != 2 or len(qs) != len(joints_t):
        raise CalibrationInputError(f"a run's tracks do not fit: camera {Ts.shape}, joints {qs.shape}")
    if sides is not None and sides.shape != qs.shape:
        raise CalibrationInputError(f"a run's sides {sides.shape} do not fit its joints {qs.shape}")
    return OdometryRun(CameraTrack(camera_t, Ts), JointTrack(joints_t, qs, sides))
