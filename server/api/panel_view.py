"""What the page needs beyond the state view: alarms, goal, history, link and vision figures, the 3D view's health."""

from typing import Literal

from pydantic import Field

from server.api.views import ErrorView, StateView, View


class AlarmView(View):
    """One alarm as it stands in the list."""

    code: str
    level: Literal["high", "medium", "low"]
    title: str
    detail: str
    cause: str
    remedy: str
    clears: str
    since_unix_s: float
    ended_unix_s: float | None
    acknowledged_by: str


class GoalView(View):
    """Where the tool is to stand, on the target's normal, and what counts as reached."""

    stand_off_mm: float
    offset_x_mm: float
    offset_y_mm: float


class HistoryView(View):
    """One look, by itself or after a move, newest last."""

    number: int
    unix_s: float
    after: str = Field(description="the kind of job that took it")
    status: str
    reason: str
    error: ErrorView | None
    inside: bool
    accepted_by: str = ""


class SafetyView(View):
    """What the PLC reports of the hardware: it is shown, never commanded, here."""

    estop: Literal["not pressed", "PRESSED", "not reported"]
    enable: Literal["given", "LOST", "needed to arm", "not reported"]
    faults: list[str]


class LinkFigures(View):
    """How punctual the link is, over the last ten seconds."""

    lateness_edges_ms: list[float] = Field(description="upper edges of the histogram; the last bin is open")
    lateness_counts: list[int] = Field(description="PLC states by delay behind the fastest")
    loss_pct: float
    send_late_p50_ms: float
    send_late_p99_ms: float
    send_late_max_ms: float
    sent: int
    received: int
    rejected: int
    samples_dropped: int = Field(description="states that the server did not fetch in time: missing in recordings")
    buffer_ms: float
    buffer_min_ms: float


class VisionFigures(View):
    """How vision does."""

    sharpness: float | None
    exposure_age_ms: float | None = Field(description="since the newest pair was exposed, as far as the clocks allow")
    process_ms: float
    skipped: int
    restarts: int
    video_viewers: int
    tool: str
    target: str


class CalibrationFigures(View):
    """How well the camera's rotation is known: covariance [deg^2] about the TCP's axes, row by row."""

    covariance_deg2: list[list[float]]
    weakest_axis_tcp: list[float]


class SceneState(View):
    """The 3D view: it may be missing, the page may not."""

    running: bool
    problem: str
    process_id: int | None
    scrub_frac: float


class HoldState(View):
    """Whether a motion must be held, and who holds one now."""

    required: bool
    held_by: str
    limit_ms: float


class PanelView(View):
    """The page's own part of the live message."""

    unix_s: float
    mono_ms: float = Field(description="the server's own clock when this was made: for ages that count the way, too")
    alarms: list[AlarmView]
    goal: GoalView
    history: list[HistoryView]
    safety: SafetyView
    link: LinkFigures
    vision: VisionFigures
    calibration: CalibrationFigures | None
    scene: SceneState
    hold: HoldState
    look_moved_deg: float | None = Field(description="largest joint turn since the last look")
    look_moved_max_deg: float = Field(
        description="beyond this the last look no longer describes the machine's position"
    )
    look_age_max_s: float = Field(description="motions based on an older look are refused")
    recording: bool
    recorder_problem: str
    disk_free_gb: float | None


class LiveView(StateView):
    """One message of the live channel."""

    panel: PanelView
