"""What jobs leave behind: errors, moves, results; units in the names: they go out over REST and into recordings."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class ErrorMm:
    """Tool minus goal in OOI axes [mm], geodesic rotation [deg], each with one sigma."""

    x_mm: float
    y_mm: float
    z_mm: float
    rotation_deg: float
    sigma_x_mm: float
    sigma_y_mm: float
    sigma_z_mm: float
    sigma_rotation_deg: float
    distance_mm: float
    camera_x_mm: float  # OOI minus tool in camera axes, as the paper's tables give it; z contains the stand-off
    camera_y_mm: float
    camera_z_mm: float


@dataclass(frozen=True, slots=True)
class LookRecord:
    """One look as the operator sees it."""

    status: str
    reason: str
    error: ErrorMm | None
    n_used: int
    spread_mm: float
    t_plc_ns: int
    t_mono_ns: int


@dataclass(frozen=True, slots=True)
class ComparedMove:
    """How far a move by one look and kinematics alone would have missed [mm], by the machine file and as in use.

    Both by the same two looks. `in_use_mm` None: no version was in use.
    """

    number: int
    nominal_mm: float
    in_use_mm: float | None
    version_id: str


@dataclass(frozen=True, slots=True)
class MoveRecord:
    """One orientation step, approach or look-then-move, with the errors before and after it.

    `t_rest_plc_ns` is the PLC's time of the look after the move: a bench joins the simulator's truth there afterwards.
    """

    number: int
    kind: Literal["orientation", "approach", "move"]
    before: ErrorMm
    after: ErrorMm | None
    predicted_sigma_mm: tuple[float, float, float]
    length_mm: float
    duration_s: float
    trims: int
    t_rest_plc_ns: int


@dataclass(frozen=True, slots=True)
class CalibrationRecord:
    """The local calibration in the operator's units."""

    method: str
    status: str
    reason: str
    sigma_deg: float
    from_nominal_deg: float
    time_offset_ms: float
    residual_rms_mm: float
    n_used: int
    observability: float
    duration_s: float
    focal_off_pct: float | None = None  # true focal length against the camera file's, as path and looks show it
    focal_sigma_pct: float | None = None


@dataclass(frozen=True, slots=True)
class PositionResult:
    """The end of a positioning job."""

    reached: bool
    reason: str
    tolerance_mm: float
    tolerance_deg: float
    start: ErrorMm
    end: ErrorMm
    moves: tuple[MoveRecord, ...]
    calibration: CalibrationRecord | None
    t_start_plc_ns: int
    duration_s: float
    seconds_by_step: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class PatternResult:
    """The end of a pattern job: the visited targets and what came of each; it ends at the first one not reached."""

    reached: bool
    reason: str
    target_ids: tuple[int, ...]
    visits: tuple[PositionResult, ...]


@dataclass(frozen=True, slots=True)
class LineEquationLook:
    """One look of a line-equation run: "oriented", "move", "servo 1"; and when it was taken."""

    name: str
    error: ErrorMm
    t_plc_ns: int


@dataclass(frozen=True, slots=True)
class LineEquationResult:
    """The end of a line-equation job: its looks in order and what the fit said of itself."""

    variant: str
    note: str
    looks: tuple[LineEquationLook, ...]


@dataclass(frozen=True, slots=True)
class ServoResult:
    """The end of a closed-loop job: how many pairs steered it and how many new tails the PLC took."""

    reached: bool
    reason: str
    start: ErrorMm
    end: ErrorMm
    moves: tuple[MoveRecord, ...]
    passes: int
    pairs: int
    corrections: int
    t_start_plc_ns: int
    duration_s: float


# What planning and driving an identification leave behind: units in the names, they go out over REST.


@dataclass(frozen=True, slots=True)
class DriveSegment:
    """One part of the drive. `shows`: what it is for; `cannot`: what it leaves open here, and why; empty: nothing."""

    name: str
    duration_s: float
    shows: tuple[str, ...]
    cannot: str = ""


@dataclass(frozen=True, slots=True)
class IdentificationPlan:
    """What `identify` with this hash would drive. Nothing has moved. `cannot`: of the drive as a whole."""

    plan_hash: str
    expires_in_s: float
    duration_s: float
    parts: tuple[DriveSegment, ...]
    cannot: tuple[str, ...]
    looks: int
    tcp_speed_max_mm_s: float
    clearance_mm: float | None
    joint_travel_deg: tuple[float, ...]
    tcp_path_m: tuple[tuple[float, float, float], ...]
    caution: str


@dataclass(frozen=True, slots=True)
class IdentificationDriven:
    """What was driven. `left`: parts that are still to be driven; `followed_by`: the diagnosis of all recordings."""

    plan_hash: str
    parts: tuple[str, ...]
    left: tuple[str, ...]
    duration_s: float
    looks_good: int
    followed_by: str = ""
    not_followed: str = ""
