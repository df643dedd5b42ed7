"""What the page remembers between two messages: alarms, history of looks, recent loss, who holds, what was accepted."""

import time
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from recording.clock import mono_ns, mono_s
from server.api.hold_rule import mode_of
from server.api.panel_alarm_catalogue import CATALOGUE
from server.api.panel_alarms import PLC_FAULT_ALARM_CODES, Alarm, AlarmBook, Surroundings, active_alarms, unknown_alarms
from server.api.panel_view import (
    AlarmView,
    GoalView,
    HistoryView,
    HoldState,
    LinkFigures,
    LiveView,
    PanelView,
    SceneState,
    calibration_figures,
    link_figures,
    loss_pct,
    safety_view,
    vision_figures,
)
from server.api.state_view import error_view, state_view
from server.api.views import StateView
from server.jobs.engine import Job, JobEvent, JobState
from server.jobs.hold import HOLD_SILENCE_MAX_NS
from server.jobs.knowledge import LookTaken
from server.jobs.plans.tolerance import is_look_inside_tolerance
from server.jobs.plans.unmoved import LOOK_STALE_JOINT_MOTION_RAD
from server.jobs.service import JobService

LOOK_HISTORY_KEPT_MAX = 100
LOOK_HISTORY_SHOWN_MAX = 30
LINK_FIGURES_PERIOD_S = 1.0
LOSS_WINDOW_S = 10  # seconds, one entry each


@dataclass(slots=True)
class PanelMemory:
    """Mutable on purpose; one for all viewers. `scene_state` is filled by the process that runs the 3D view."""

    job_service: JobService
    alarm_book: AlarmBook = field(default_factory=AlarmBook)
    look_history: deque[HistoryView] = field(default_factory=lambda: deque(maxlen=LOOK_HISTORY_KEPT_MAX))
    scene_state: SceneState = field(
        default_factory=lambda: SceneState(running=False, problem="", process_id=None, scrub_frac=1.0)
    )
    n_viewers: int = 0
    held_by: str = ""
    _shown_look: LookTaken | None = None
    _looks: int = 0
    _job_kind: str = "look"
    _counts: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=LOSS_WINDOW_S))
    _figures: LinkFigures | None = None
    _figures_s: float = -1e9
    _fit_s: float = 0.0
    _started_s: float = field(default_factory=mono_s)
    _loss_pct: float = 0.0

    def __post_init__(self) -> None:
        self.job_service.engine.on_event(self._on_event)
        self.job_service.alarm_codes = lambda: self.alarm_book.active
        self._shown_look = self.job_service.cell.knowledge.last_look

    def live_message(self) -> LiveView:
        """One message, as of now."""
        service, now_s = self.job_service, mono_s()
        state = state_view(service.cell, service.engine, service.context, service.store_problem)
        self._note_look()
        self._refresh_slow_figures(now_s)
        self.alarm_book.update(
            active_alarms(state, self._alarm_inputs(state, now_s)), time.time(), unknown_alarms(state)
        )
        return LiveView(**state.__dict__, panel=self._panel_view())

    # --- parts ------------------------------------------------------------------------------------------------------

    def _panel_view(self) -> PanelView:
        service = self.job_service
        cell, goal = service.cell, service.context.settings.position
        alarms = [_alarm_view(alarm) for alarm in self.alarm_book.alarms]
        faults = [alarm.title for alarm in alarms if alarm.code in PLC_FAULT_ALARM_CODES and alarm.ended_unix_s is None]
        return PanelView(
            unix_s=round(time.time(), 3),
            mono_ms=round(mono_ns() * 1e-6, 1),
            alarms=alarms,
            goal=GoalView(stand_off_mm=goal.stand_off_mm, offset_x_mm=goal.offset_x_mm, offset_y_mm=goal.offset_y_mm),
            history=list(self.look_history)[-LOOK_HISTORY_SHOWN_MAX:],
            safety=safety_view(cell.link.health, cell.link.latest, faults),
            link=self._figures or link_figures([], cell.link.health, 0.0),
            vision=vision_figures(cell.vision, self.n_viewers, mono_ns()),
            calibration=calibration_figures(cell.knowledge.kept_calibration),
            scene=self.scene_state,
            hold=self._hold_state(),
            look_moved_deg=self._look_moved_deg(),
            look_moved_max_deg=round(float(np.rad2deg(LOOK_STALE_JOINT_MOTION_RAD)), 3),
            look_age_max_s=cell.settings.look.age_max_s,
            recording=cell.recorder.recording,
            recorder_problem=self.job_service.recording_problem,
            disk_free_gb=None if (free := self.job_service.disk.free_bytes) is None else round(free / 1e9, 2),
        )

    def _hold_state(self) -> HoldState:
        cell = self.job_service.cell
        required = mode_of(cell.settings.mode, cell.link.latest) == "REAL"
        return HoldState(required=required, held_by=self.held_by, limit_ms=HOLD_SILENCE_MAX_NS * 1e-6)

    def _alarm_inputs(self, state: StateView, now_s: float) -> Surroundings:
        if not state.camera.warnings:
            self._fit_s = now_s
        text = self.job_service.cell.vision.stream_text
        return Surroundings(
            disk_free_bytes=self.job_service.disk.free_bytes,
            recorder_problem=self.job_service.recording_problem,
            scene_problem="" if self.scene_state.running else self.scene_state.problem,
            vision_problem=text if text.startswith("vision process ended") else "",
            loss_pct=self._loss_pct,
            unfit_for_s=now_s - self._fit_s,
            up_s=now_s - self._started_s,
            set_mode=self.job_service.cell.settings.mode,
            store_problem=self.job_service.store_problem,
            other_pc=self.job_service.cell.link.health.other_pc,
            inner_faults=self.job_service.inner_faults.active,
        )

    def _refresh_slow_figures(self, now_s: float) -> None:
        """What costs something, once a second."""
        cell = self.job_service.cell
        if now_s - self._figures_s >= LINK_FIGURES_PERIOD_S:
            self._figures_s = now_s
            health = cell.link.health
            self._loss_pct = loss_pct(self._counts[0], health) if self._counts else 0.0
            self._counts.append((health.received, health.lost))
            since_ns = mono_ns() - LOSS_WINDOW_S * 10**9
            self._figures = link_figures(cell.link.samples_since(since_ns), health, self._loss_pct)

    # --- history ----------------------------------------------------------------------------------------------------

    def _note_look(self) -> None:
        taken = self.job_service.cell.knowledge.last_look
        if taken is None or taken is self._shown_look:
            return
        again = self._shown_look is not None and self._shown_look.raw is taken.raw
        self._shown_look = taken
        self._looks += not again
        entry = HistoryView(
            number=self._looks,
            unix_s=round(self.job_service.cell.knowledge.unix_s(taken.record.t_mono_ns), 1),
            after=self._job_kind,
            status=taken.record.status,
            reason=taken.record.reason,
            error=error_view(taken.error),
            inside=taken.error is not None and is_look_inside_tolerance(self.job_service.context, taken),
        )
        if again and self.look_history:  # the same look against another goal
            self.look_history[-1] = entry.model_copy(update={"after": self.look_history[-1].after})
        else:
            self.look_history.append(entry)

    def _look_moved_deg(self) -> float | None:
        taken, latest = self.job_service.cell.knowledge.last_look, self.job_service.cell.link.latest
        if taken is None or latest is None:
            return None
        return round(float(np.rad2deg(np.abs(np.array(latest.q_rad) - taken.reading.q_rad).max())), 3)

    def accept(self, who: str) -> str:
        """Mark the newest look as accepted; the reason when it cannot be."""
        if not self.look_history or self.look_history[-1].error is None:
            return "there is no valid look to accept; look first"
        if not self.look_history[-1].inside:
            return "the last look is not within tolerance including 2 sigma; preview and move, or look again"
        self.look_history[-1] = self.look_history[-1].model_copy(update={"accepted_by": who})
        return ""

    def _on_event(self, job: Job, event: JobEvent) -> None:
        if event.name == "started":
            self._job_kind = job.kind
        if event.name == "ended" and job.state is JobState.FAILED:
            self.alarm_book.raise_event("job_failed", f"{job.kind}: {job.reason}", time.time())

    def scrub(self, frac: float) -> None:
        """Where on the previewed path the ghost stands, 0..1; shown to everybody, moves nothing."""
        self.scene_state = self.scene_state.model_copy(update={"scrub_frac": min(1.0, max(0.0, frac))})


def _alarm_view(alarm: Alarm) -> AlarmView:
    kind = CATALOGUE[alarm.code]
    return AlarmView(
        code=alarm.code,
        level=kind.level,
        title=kind.title,
        detail=alarm.detail,
        cause=kind.cause,
        remedy=kind.remedy,
        clears=kind.clears,
        since_unix_s=round(alarm.since_unix_s, 1),
        ended_unix_s=None if alarm.ended_unix_s is None else round(alarm.ended_unix_s, 1),
        acknowledged_by=alarm.acknowledged_by,
    )
