"""The recorder: data of link, camera and jobs into one MCAP file per run."""

import logging
import os
import platform
import time
from collections.abc import Callable
from datetime import UTC, datetime
from functools import wraps
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeVar

from machine.chain import chain_of
from machine.description import Machine
from machine.urdf import urdf_text
from recording.clock import mono_ns
from recording.content import Attachment
from recording.errors import RecordingError
from recording.rows import NAN, Floats, Row
from recording.run import RunInfo, Segment, SegmentKind
from recording.writer import RunWriter
from server.calibration.contracts import CameraRotationEstimate
from server.camera.contracts import FrameReport
from server.link.contracts import PlcSample
from server.motion.contracts import PathPlan
from server.motion.identification_courses import SegmentMark
from server.recorder_rows import calibration_row, finding_row, frame_poses, look_row, plan_row, plc_row, report_rows
from server.version import __version__, library_versions
from server.vision.contracts import Look

TRANSFORM_PERIOD_NS = 100_000_000
PLC_CLOCK_RESTART_MIN_NS = 1_000_000_000  # a PLC stamp that falls back by more is of a PLC that was switched off and on
IMAGE_PERIOD_NS = 100_000_000
DISK_WAIT_S = 0.5  # longest that a slow disk may hold the event loop at a run's begin, and at its end
CAMERA_INTRINSICS_PERIOD_NS = 1_000_000_000  # the camera's intrinsics are repeated, so that a reader may start anywhere

_log = logging.getLogger(__name__)
P = ParamSpec("P")
T = TypeVar("T")


def _give_up_on_error(
    method: Callable[Concatenate["Recorder", P], T],
) -> Callable[Concatenate["Recorder", P], T | None]:
    """Whatever fails in it ends the recording, with a fault, and nothing else: not the job, not the link's reports."""

    @wraps(method)
    def guarded(self: "Recorder", *args: P.args, **kwargs: P.kwargs) -> T | None:
        try:
            return method(self, *args, **kwargs)
        except Exception as error:  # the outermost call of the recorder
            self.give_up(error)
            return None

    return guarded


class Recorder:
    """Takes everything all the time, writes it while a run is on. A failure never stops a job: see
    `why_not_recording`."""

    def __init__(self, folder: Path, machine: Machine, *, images: bool = True) -> None:
        self._folder = folder
        self._machine = machine
        self._chain = chain_of(machine)
        self._images = images
        self._writer: RunWriter | None = None
        self._last: RunWriter | None = None  # the last run's, while its disk has not taken all of it
        self._late: list[RunWriter] = []  # of all runs of which that is so
        self._run = RunInfo(name="")
        self._plc_offset_ns: int | None = None
        self._camera_offset_ns: int | None = None
        self._first_plc_ns: int | None = None
        self._last_plc_ns = 0
        self._segments: list[Segment] = []
        self._open_segment: tuple[str, SegmentKind, str, int] | None = None
        self._marks: tuple[tuple[SegmentMark, ...], int] = (), 0  # of the trajectory that is played, and when it began
        self._transforms_ns = 0
        self._camera_ns = self._image_ns = 0
        self._problem = ""

    @property
    def recording(self) -> bool:
        """Whether a run is on."""
        return self._writer is not None

    @property
    def why_not_recording(self) -> str:
        """Why the run that is on, or else the last one, is not recorded; empty while it is."""
        if self._last is not None and self._last.has_ended:
            self._problem, self._last = self._last.error, None
        return self._problem or (self._writer.error if self._writer is not None else "")

    def give_up(self, error: Exception) -> None:
        """End the run's file because of a defect."""
        _log.exception("recording of %s ended with an internal error", self._run.name)
        writer, self._writer, self._last = self._writer, None, None
        self._problem = (
            f"recording of {self._run.name} ended with an internal error: {error!r}; report it with the server's log"
        )
        if writer is not None:
            writer.close(wait_s=0.0)
            self._late.append(writer)

    @_give_up_on_error
    def start(self, run_id: str, settings_json: str, machine_toml: str, seed: int | None = None) -> None:
        """Begin a run's file; a run that is on is closed first."""
        self.stop()
        now = datetime.now(UTC)
        utc_minus_mono_s = (time.time_ns() - mono_ns()) * 1e-9
        self._run = RunInfo(run_id, now.isoformat(timespec="seconds"), seed, pc_to_utc_offset_s=utc_minus_mono_s)
        self._plc_offset_ns = self._camera_offset_ns = self._first_plc_ns = None
        self._segments, self._open_segment, self._marks = [], None, ((), 0)
        urdf = urdf_text(self._machine)
        attachments = [
            Attachment("machine.toml", "application/toml", machine_toml.encode()),
            Attachment("settings.json", "application/json", settings_json.encode()),
            Attachment("machine.urdf", "application/xml", urdf.encode()),
        ]
        path = self._folder / f"{now:%Y%m%dT%H%M%S}-{run_id}.mcap"
        try:
            self._writer = RunWriter(
                path, self._run, attachments, self._recording_metadata(seed), open_wait_s=DISK_WAIT_S
            )
            self._writer.robot(urdf, mono_ns())
            self._problem, self._last = "", None
        except RecordingError as error:
            self._problem = str(error)
            _log.error("%s; the run continues without a recording", error)

    def _recording_metadata(self, seed: int | None) -> list[tuple[str, str]]:
        return [
            ("longreach", __version__),
            ("python", platform.python_version()),
            *library_versions(),
            ("git_revision", os.environ.get("LONGREACH_GIT_REVISION", "unknown")),
            ("seed", "" if seed is None else str(seed)),
        ]

    @_give_up_on_error
    def sample(self, sample: PlcSample) -> None:
        """A PLC state."""
        restarted = sample.t_plc_ns < self._last_plc_ns - PLC_CLOCK_RESTART_MIN_NS
        writer = self._writer
        if restarted and writer is not None:
            self._begin_again()
        self._last_plc_ns = sample.t_plc_ns
        if writer is None:
            return
        self._first_plc_ns = sample.t_plc_ns if self._first_plc_ns is None else self._first_plc_ns
        offset_ns = sample.t_mono_ns - sample.t_plc_ns
        self._plc_offset_ns = offset_ns if self._plc_offset_ns is None else min(offset_ns, self._plc_offset_ns)
        writer.row(plc_row(sample), sample.t_mono_ns, sample.t_plc_ns + self._plc_offset_ns)
        if sample.t_mono_ns - self._transforms_ns >= TRANSFORM_PERIOD_NS:
            self._transforms_ns = sample.t_mono_ns
            names = [joint.name for joint in self._machine.joints]
            writer.joint_states(names, sample.q_rad[: len(names)], sample.t_mono_ns)
            writer.transforms(frame_poses(self._chain, self._machine.T_tcp_cam_left, sample.q_rad), sample.t_mono_ns)

    def _begin_again(self) -> None:
        """The PLC was switched off and on: what was open ends by its old clock, and its stamps are mapped again."""
        _log.warning("the PLC's clock restarted during a recording; its segments end there")
        self.log_event("warning", "the PLC's clock restarted")
        self._end_segments()
        self._first_plc_ns = self._plc_offset_ns = None

    @_give_up_on_error
    def report(self, report: FrameReport) -> None:
        """A processed stereo pair."""
        writer = self._writer
        if writer is None:
            return
        self._camera_offset_ns = report.t_exposure_mapped_ns - report.observation.t_exposure_ns
        for row in report_rows(report):
            writer.row(row, report.t_receive_mono_ns, report.t_exposure_mapped_ns)
        if self._images and report.preview_jpeg is not None:
            self._write_image_if_due(writer, report.preview_jpeg, report)

    def _write_image_if_due(self, writer: RunWriter, jpeg: bytes, report: FrameReport) -> None:
        if report.t_receive_mono_ns - self._image_ns < IMAGE_PERIOD_NS:
            return
        self._image_ns = report.t_receive_mono_ns
        writer.image(jpeg, report.t_receive_mono_ns, report.t_exposure_mapped_ns)
        if report.t_receive_mono_ns - self._camera_ns >= CAMERA_INTRINSICS_PERIOD_NS:
            self._camera_ns = report.t_receive_mono_ns
            writer.camera(self._machine.camera, report.preview_width_px, report.t_receive_mono_ns)

    @_give_up_on_error
    def log_event(self, level: str, text: str) -> None:
        """One line of the log; level is debug, info, warning or error."""
        if self._writer is not None:
            self._writer.log(level, text, mono_ns())

    def look(self, look: Look, error: Floats = (NAN, NAN, NAN, NAN)) -> None:
        """A look, with its error x, y, z [mm] and rotation [deg] when it gave one."""
        now_ns = mono_ns()
        self._write_row(look_row(look, now_ns * 1e-9, error), now_ns)

    def calibration(self, estimate: CameraRotationEstimate) -> None:
        """A local calibration."""
        now_ns = mono_ns()
        self._write_row(calibration_row(estimate, now_ns * 1e-9), now_ns)

    def plan(self, plan: PathPlan) -> None:
        """A planned path."""
        now_ns = mono_ns()
        self._write_row(plan_row(plan, now_ns * 1e-9), now_ns)

    @_give_up_on_error
    def record(self, item: object, text: str = "") -> None:
        """A finding of a job, each kind in its own channel; what has none goes to /findings as JSON."""
        match item:
            case CameraRotationEstimate():
                self.calibration(item)
            case PathPlan():
                self.plan(item)
            case Look():
                self.look(item)
            case _:
                now_ns = mono_ns()
                self._write_row(finding_row(item, now_ns * 1e-9, text), now_ns)

    def result(self, result: object) -> None:
        """How the run ended."""
        self.record(result, "result")

    @_give_up_on_error
    def begin_segment(self, name: str, kind: SegmentKind, repeat_of: str = "") -> None:
        """From the latest PLC state on, what happens belongs to this segment."""
        self.end_segment()
        self._open_segment = (name, kind, repeat_of, self._last_plc_ns)

    @_give_up_on_error
    def end_segment(self) -> None:
        """Close the segment that is open, if any."""
        if self._open_segment is not None:
            name, kind, repeat_of, start_ns = self._open_segment
            end_ns = max(start_ns, self._last_plc_ns)  # a file with a segment that ends before it begins is refused
            self._segments.append(Segment(name, kind, start_ns * 1e-9, end_ns * 1e-9, repeat_of))
            self._open_segment = None

    @_give_up_on_error
    def begin_marks(self, marks: tuple[SegmentMark, ...]) -> None:
        """A trajectory is about to be played of which these stretches are segments."""
        self._marks = marks, self._last_plc_ns

    @_give_up_on_error
    def end_marks(self) -> None:
        """The trajectory ended, or was stopped: what was driven of its stretches are segments.

        All count from one moment, so that repeats lie on each other to the PLC's cycle. A repeat that was cut is left
        out.
        """
        (marks, start_ns), self._marks = self._marks, ((), 0)
        driven_s = (self._last_plc_ns - start_ns) * 1e-9
        for mark in marks:
            whole = mark.end_s <= driven_s
            if mark.start_s < driven_s and (whole or not mark.repeat_of):
                start_s, end_s = (start_ns * 1e-9 + min(s, driven_s) for s in (mark.start_s, mark.end_s))
                self._segments.append(Segment(mark.name, mark.kind, start_s, end_s, mark.repeat_of))

    def _end_segments(self) -> None:
        self.end_marks()
        self.end_segment()
        if not self._segments and self._first_plc_ns is not None:  # without segments of its own: a job of the server
            span = self._first_plc_ns * 1e-9, self._last_plc_ns * 1e-9
            self._segments.append(Segment(self._run.name, "positioning", *span))

    @_give_up_on_error
    def stop(self) -> Path | None:
        """Close the run's file and return it; None when no run was on, or its disk is late (see
        `why_not_recording`)."""
        writer, self._writer = self._writer, None
        if writer is None:
            return None
        self._end_segments()
        final = RunInfo(
            name=self._run.name,
            started_utc=self._run.started_utc,
            seed=self._run.seed,
            plc_to_pc_offset_s=None if self._plc_offset_ns is None else self._plc_offset_ns * 1e-9,
            camera_to_pc_offset_s=None if self._camera_offset_ns is None else self._camera_offset_ns * 1e-9,
            pc_to_utc_offset_s=self._run.pc_to_utc_offset_s,
            segments=tuple(self._segments),
        )
        self._problem = writer.close(final, DISK_WAIT_S).error
        self._late = [late for late in (*self._late, writer) if not late.has_ended]
        self._last = writer if writer in self._late else None
        return writer.path if writer.has_ended and writer.is_open else None

    def finish(self) -> None:
        """Close the run's file, and wait for every disk as long as a writer waits: for the server's own end."""
        self.stop()
        for late in self._late:
            late.close()

    def _write_row(self, row: Row, t_mono_ns: int) -> None:
        if self._writer is not None:
            self._writer.row(row, t_mono_ns)
