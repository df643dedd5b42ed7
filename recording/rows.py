"""The numeric channels: one frozen row per message or CSV line, every unit in the name.

A row class is the one definition of its channel: the protobuf message and the CSV columns are both derived from it.
Fields are float, int, str, bool or a tuple of floats, annotated with their CSV column; `{j}` counts joints from 1.
Missing numbers are NaN here (-1 for counts, an empty tuple for joints), empty cells in CSV. Fields without a CSV column
exist in MCAP only.
"""

from dataclasses import dataclass, fields
from typing import Annotated, ClassVar, get_type_hints

Floats = tuple[float, ...]
NAN = float("nan")
MISSING_COUNT = -1


@dataclass(frozen=True, slots=True)
class Row:
    """Base of all rows. `topic` is the MCAP channel, `file` the CSV file (empty: MCAP only)."""

    topic: ClassVar[str] = ""
    file: ClassVar[str] = ""


@dataclass(frozen=True, slots=True)
class Sent(Row):
    """The reference as the PC sent it."""

    topic: ClassVar[str] = "/sent"
    file: ClassVar[str] = "sent.csv"
    t_pc_s: Annotated[float, "t_pc_s"]
    seq: Annotated[int, "seq"]
    q_sent_rad: Annotated[Floats, "q_sent_{j}_rad"]


@dataclass(frozen=True, slots=True)
class PlcState(Row):
    """One PLC log cycle."""

    topic: ClassVar[str] = "/plc"
    file: ClassVar[str] = "plc.csv"
    t_plc_s: Annotated[float, "t_plc_s"]
    seq_received: Annotated[int, "seq_received"]
    q_ref_rad: Annotated[Floats, "q_ref_{j}_rad"]
    qd_ref_rad_s: Annotated[Floats, "qd_ref_{j}_rad_s"]
    q_rad: Annotated[Floats, "q_{j}_rad"]
    u_frac: Annotated[Floats, "u_{j}_frac"]
    p_a_pa: Annotated[Floats, "p_a_{j}_pa"]
    p_b_pa: Annotated[Floats, "p_b_{j}_pa"]
    p_supply_pa: Annotated[float, "p_supply_pa"]
    t_oil_c: Annotated[float, "t_oil_c"]
    t_receive_pc_s: Annotated[float, "t_receive_pc_s"] = NAN
    qd_rad_s: Floats = ()
    plc_state: str = ""
    traj_id: int = 0
    knot_playing: int = 0
    fault_bits: int = 0


@dataclass(frozen=True, slots=True)
class MarkerCorners(Row):
    """One marker in one eye: corners in OpenCV's order and pixel centres."""

    topic: ClassVar[str] = "/markers"
    file: ClassVar[str] = "markers.csv"
    t_camera_s: Annotated[float, "t_camera_s"]
    eye: Annotated[str, "eye"]
    marker_id: Annotated[int, "marker_id"]
    u0_px: Annotated[float, "u0_px"]
    v0_px: Annotated[float, "v0_px"]
    u1_px: Annotated[float, "u1_px"]
    v1_px: Annotated[float, "v1_px"]
    u2_px: Annotated[float, "u2_px"]
    v2_px: Annotated[float, "v2_px"]
    u3_px: Annotated[float, "u3_px"]
    v3_px: Annotated[float, "v3_px"]
    residual_rms_px: float = NAN
    used: bool = True
    reason: str = ""


@dataclass(frozen=True, slots=True)
class OdometryRow(Row):
    """Left camera in the odometry's start frame."""

    topic: ClassVar[str] = "/odometry"
    file: ClassVar[str] = "odometry.csv"
    t_camera_s: Annotated[float, "t_camera_s"]
    x_m: Annotated[float, "x_m"]
    y_m: Annotated[float, "y_m"]
    z_m: Annotated[float, "z_m"]
    qw: Annotated[float, "qw"]
    qx: Annotated[float, "qx"]
    qy: Annotated[float, "qy"]
    qz: Annotated[float, "qz"]
    status: str = ""
    n_points: int = 0
    covariance: Floats = ()  # 36, row by row: rotation vector [rad], then translation [m]


@dataclass(frozen=True, slots=True)
class TrackerPoint(Row):
    """One point of an external tracker."""

    topic: ClassVar[str] = "/tracker"
    file: ClassVar[str] = "tracker.csv"
    t_plc_s: Annotated[float, "t_plc_s"]
    point: Annotated[str, "point"]
    x_m: Annotated[float, "x_m"]
    y_m: Annotated[float, "y_m"]
    z_m: Annotated[float, "z_m"]


@dataclass(frozen=True, slots=True)
class StaticPoint(Row):
    """One measured point of a pose at rest."""

    topic: ClassVar[str] = "/static"
    file: ClassVar[str] = "static.csv"
    pose_index: Annotated[int, "pose_index"]
    q_rad: Annotated[Floats, "q_{j}_rad"]
    point: Annotated[str, "point"]
    x_m: Annotated[float, "x_m"]
    y_m: Annotated[float, "y_m"]
    z_m: Annotated[float, "z_m"]


@dataclass(frozen=True, slots=True)
class MarkerPose(Row):
    """Pose of the tool or the OOI in the left camera, by one pair."""

    topic: ClassVar[str] = "/marker_poses"
    t_camera_s: float
    on: str
    status: str
    reason: str
    T_cam_object: Floats  # 16, row by row; empty when there is none
    sigma_rotation_rad: Floats  # 3
    sigma_translation_m: Floats  # 3
    residual_rms_px: float


@dataclass(frozen=True, slots=True)
class CameraState(Row):
    """How the camera and the vision process did, once a pair."""

    topic: ClassVar[str] = "/camera/state"
    t_camera_s: float
    t_receive_pc_s: float
    sequence: int
    fps_hz: float
    process_ms: float
    skipped: int
    sharpness: float
    warnings: str


@dataclass(frozen=True, slots=True)
class LookRow(Row):
    """One look, and the error it gave, tool minus goal in OOI axes (NaN when it gave none)."""

    topic: ClassVar[str] = "/look"
    t_pc_s: float
    status: str
    reason: str
    T_cam_tool: Floats
    T_cam_ooi: Floats
    tool_covariance: Floats
    ooi_covariance: Floats
    n_pairs: int
    n_used: int
    spread_mm: float
    error_x_mm: float = NAN
    error_y_mm: float = NAN
    error_z_mm: float = NAN
    error_rotation_deg: float = NAN


@dataclass(frozen=True, slots=True)
class CalibrationRow(Row):
    """One local calibration."""

    topic: ClassVar[str] = "/calibration"
    t_pc_s: float
    status: str
    reason: str
    method: str
    R_tcp_cam: Floats  # 9, row by row; empty when there is none
    covariance: Floats  # 9 [rad^2]
    time_offset_s: float
    residual_rms_mm: float
    residual_max_mm: float
    n_used: int
    observability: float
    path_length_m: float


@dataclass(frozen=True, slots=True)
class PlanRow(Row):
    """One planned path of the reference."""

    topic: ClassVar[str] = "/plan"
    t_pc_s: float
    status: str
    reason: str
    length_m: float
    duration_s: float
    tcp_speed_max_m_s: float
    clearance_m: float
    sigma_min: float
    q_end_rad: Floats
    knot_t_s: Floats
    knot_q_rad: Floats  # knots times joints, row by row


@dataclass(frozen=True, slots=True)
class Finding(Row):
    """Anything else a job leaves behind: moves, results. `json` holds its fields, units in their names."""

    topic: ClassVar[str] = "/findings"
    t_pc_s: float
    kind: str
    text: str
    json: str


#: Every numeric channel.
# fmt: off
ROW_TYPES: tuple[type[Row], ...] = (
    Sent, PlcState, MarkerCorners, OdometryRow, TrackerPoint, StaticPoint, MarkerPose, CameraState, LookRow,
    CalibrationRow, PlanRow, Finding,
)
# fmt: on

#: The channels that have a CSV form.
CSV_ROW_TYPES = tuple(row_type for row_type in ROW_TYPES if row_type.file)


def csv_fields(row_type: type[Row]) -> list[tuple[str, str]]:
    """The fields with a CSV column, and its name or pattern."""
    hints = get_type_hints(row_type, include_extras=True)
    annotated = [(column.name, hints[column.name]) for column in fields(row_type)]
    return [(name, hint.__metadata__[0]) for name, hint in annotated if hasattr(hint, "__metadata__")]
