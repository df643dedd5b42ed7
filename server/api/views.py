"""What goes out over REST and WebSocket: strict models, units in every name."""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field


class View(BaseModel):
    """Base of all views: nothing beyond the declared fields."""

    model_config = ConfigDict(extra="forbid")


class Strict(BaseModel):
    """Base of all request bodies: exact types, nothing undeclared, no NaN or infinity."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class ControlView(View):
    """Who has control of the machine; without an owner no client has."""

    owner: str | None = None
    kind: Literal["operator", "fleet", "engineer"] | None = None
    fencing: int = Field(default=0, description="grows with every new holder")
    expires_in_s: float | None = None
    stale: bool = Field(default=False, description="not renewed: nothing moves, the holder may renew it")
    asked_by: list[str] = Field(default_factory=list, description="clients that request control")
    offered_to: str = Field(default="", description="who may acquire it now")


class LinkView(View):
    """The PLC link."""

    phase: str
    age_ms: float | None
    lost_pct: float
    round_trip_ms: float
    plc_state: str
    buffer_ms: float
    underruns: int
    fault_bits: int
    simulation: bool
    dry_run: bool
    last_reject: str
    recent_rejects: list[str]
    lateness_p99_ms: float
    warning: str


class CompensationView(View):
    """A diagnosed machine in use: its effects, and what each changes."""

    active: bool = False
    effects: list[str] = Field(default_factory=list)


class CameraView(View):
    """The camera and the vision process."""

    fps: float
    age_ms: float | None
    process_ms: float
    skipped: int
    warnings: list[str]


class MarkerViewOut(View):
    """One marker in the left image: corners in px of the full image."""

    marker_id: int
    corners_px: list[list[float]]
    residual_px: float
    used: bool
    reason: str


class ErrorView(View):
    """Tool minus goal in OOI axes."""

    x_mm: float
    y_mm: float
    z_mm: float
    rotation_deg: float
    sigma_x_mm: float
    sigma_y_mm: float
    sigma_z_mm: float
    sigma_rotation_deg: float
    distance_mm: float
    camera_x_mm: float
    camera_y_mm: float
    camera_z_mm: float


class LookView(View):
    """The last look."""

    status: str
    reason: str
    error: ErrorView | None
    n_used: int
    spread_mm: float
    age_s: float


class CalibrationView(View):
    """The calibration made where the machine works now: the camera mount's rotation, its status and quality."""

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
    focal_off_pct: float | None = Field(default=None, description="true focal length relative to the camera file")
    focal_sigma_pct: float | None = Field(default=None, description="its standard deviation")
    valid: bool = True
    expiry_reason: str = ""
    age_s: float | None = None
    made_unix_s: float | None = None
    sigmas_deg: list[float] = Field(default_factory=list, description="principal sigmas of the rotation")
    observability_text: str = ""
    path_length_m: float | None = None
    radius_mm: float | None = Field(default=None, description="valid within this distance of where it was made")
    distance_mm: float | None = Field(default=None, description="distance of the tool from where it was made")
    age_max_h: float | None = None
    map_looks: int = Field(default=0, description="looks used by the local map")


class PlanView(View):
    """The previewed plan: what Execute would do."""

    plan_hash: str
    expires_in_s: float
    length_mm: float
    duration_s: float
    tcp_speed_max_mm_s: float
    clearance_mm: float | None
    sigma_min: float
    joint_travel_deg: list[float]
    predicted_sigma_mm: list[float]
    caution: str = ""
    before: ErrorView
    path_base_m: list[list[float]]
    q_goal_rad: list[float]


class MoveView(View):
    """One executed orientation step, approach or move."""

    number: int
    kind: Literal["orientation", "approach", "move"]
    before: ErrorView
    after: ErrorView | None
    predicted_sigma_mm: list[float]
    length_mm: float
    duration_s: float
    trims: int
    t_rest_plc_ns: int


class JobEventView(View):
    """One line of a job's story."""

    number: int
    elapsed_s: float
    name: str
    current: float
    target: float
    unit: str
    text: str


class JobView(View):
    """A job."""

    job_id: str
    kind: str
    owner: str
    state: str
    code: str
    reason: str
    elapsed_s: float
    events: list[JobEventView]
    result: Any = None


class StateView(View):
    """Everything that one screen needs, at one instant."""

    version: str
    mode: Literal["SIM", "REAL"]
    machine: str
    joint_names: list[str]
    q_deg: list[float]
    q_ref_deg: list[float]
    q_min_deg: list[float]
    q_max_deg: list[float]
    link: LinkView
    camera: CameraView
    markers: list[MarkerViewOut]
    live_error: ErrorView | None
    look: LookView | None
    calibration: CalibrationView | None
    calibration_note: str = ""
    plan: PlanView | None
    moves: list[MoveView]
    job: JobView | None
    tolerance_mm: float
    tolerance_deg: float
    stand_off_mm: float
    control: ControlView = Field(default_factory=ControlView)
    compensation: CompensationView = Field(default_factory=CompensationView)
    steps: dict[str, str] = Field(description="why a step's button is disabled; empty text = enabled")


EVENT_STREAM: dict[str, Any] = {"description": "server-sent events; data is JSON", "content": {"text/event-stream": {}}}


class Problem(View):
    """RFC 9457 problem details."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str
    code: str
    hint: str = Field(default="", description="what to do")
    references: dict[str, str] = Field(default_factory=dict, description="facts for programs: owner, job_id, ...")
