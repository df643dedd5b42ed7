"""What the page needs beyond the state view: alarms, goal, history, link and vision figures, the 3D view's health."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import Field

from protocol.codes import FaultBit
from server.api.views import ErrorView, StateView, View
from server.calibration.calibration_life import LocalCalibration
from server.camera.client import VisionClient
from server.link.contracts import LinkHealth, LinkPhase, PlcSample


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


# Figures for the engineering drawer, from samples and reports.

LATENESS_BIN_EDGES_MS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)


def link_figures(samples: Sequence[PlcSample], health: LinkHealth, loss_pct: float) -> LinkFigures:
    """Histogram of how late states came behind the earliest of them: what network and computers add."""
    late_ms = np.array([(sample.t_mono_ns - sample.t_plc_ns) * 1e-6 for sample in samples])
    late_ms = late_ms - late_ms.min() if late_ms.size else late_ms
    counts = np.bincount(
        np.searchsorted(LATENESS_BIN_EDGES_MS, late_ms, side="right"), minlength=len(LATENESS_BIN_EDGES_MS) + 1
    )
    return LinkFigures(
        lateness_edges_ms=list(LATENESS_BIN_EDGES_MS),
        lateness_counts=counts.tolist(),
        loss_pct=round(loss_pct, 2),
        send_late_p50_ms=round(health.lateness_p50_us * 1e-3, 3),
        send_late_p99_ms=round(health.lateness_p99_us * 1e-3, 3),
        send_late_max_ms=round(health.lateness_max_us * 1e-3, 3),
        sent=health.sent,
        received=health.received,
        rejected=health.rejected,
        samples_dropped=health.samples_dropped,
        buffer_ms=round(samples[-1].buffer_us * 1e-3, 1) if samples else 0.0,
        buffer_min_ms=round(health.buffer_min_us * 1e-3, 1),
    )


def loss_pct(before: tuple[int, int], health: LinkHealth) -> float:
    """Share of the states lost since (received, lost) were `before`."""
    received, lost = health.received - before[0], health.lost - before[1]
    return 100.0 * lost / (received + lost) if received + lost > 0 and received >= 0 and lost >= 0 else 0.0


def safety_view(health: LinkHealth, latest: PlcSample | None, faults: list[str]) -> SafetyView:
    """E-stop and enable as the PLC's states report them."""
    if latest is None or health.phase is LinkPhase.OFFLINE:
        return SafetyView(estop="not reported", enable="not reported", faults=[])
    armed = health.phase in (LinkPhase.ARMED, LinkPhase.RUNNING, LinkPhase.STOPPING)
    lost = bool(latest.fault_bits & FaultBit.LOCAL_ENABLE_LOST)
    return SafetyView(
        estop="PRESSED" if latest.fault_bits & FaultBit.ESTOP else "not pressed",
        enable="LOST" if lost else "given" if armed else "needed to arm",
        faults=faults,
    )


def vision_figures(vision: VisionClient, viewers: int, t_mono_ns: int) -> VisionFigures:
    """The newest pair's, as of `t_mono_ns`."""
    report = vision.latest
    if report is None:
        return VisionFigures(
            sharpness=None,
            exposure_age_ms=None,
            process_ms=0.0,
            skipped=0,
            restarts=vision.restarts,
            video_viewers=viewers,
            tool="no image yet",
            target="no image yet",
        )
    tool, ooi = report.observation.tool, report.observation.ooi
    return VisionFigures(
        sharpness=round(float(report.sharpness), 2),
        exposure_age_ms=round((t_mono_ns - report.t_exposure_mapped_ns) * 1e-6, 1),
        process_ms=round(report.process_ms, 1),
        skipped=report.n_skipped,
        restarts=vision.restarts,
        video_viewers=viewers,
        tool=tool.reason or tool.status.value,
        target=ooi.reason or ooi.status.value,
    )


def calibration_figures(life: LocalCalibration | None) -> CalibrationFigures | None:
    """Covariance of the camera's rotation in degrees squared."""
    if life is None:
        return None
    return CalibrationFigures(
        covariance_deg2=np.round(np.rad2deg(np.rad2deg(life.covariance)), 6).tolist(),
        weakest_axis_tcp=np.round(life.weakest_axis_tcp, 3).tolist(),
    )
