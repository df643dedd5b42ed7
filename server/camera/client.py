"""The server's end of the vision process: starts it, keeps it alive, and turns its reports into looks and tracks."""

import asyncio
import contextlib
import logging
import multiprocessing
import signal
import threading
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection  # on POSIX; Windows has another class of the same face
from multiprocessing.process import BaseProcess
from typing import TypeVar, cast

from machine.description import Machine
from recording.clock import SUSPENDED_REASON, mono_ns
from recording.spawn import out_of_the_terminals_reach
from server.calibration.contracts import CameraTrack
from server.camera.contracts import (
    FindMarksCommand,
    FrameReport,
    MarksFound,
    MeasureTargetCommand,
    OdometryCommand,
    OdometryMap,
    PoseSourceCommand,
    PoseSourceName,
    QuitCommand,
    SignOfLife,
    TargetAnswer,
    TargetMeasured,
    TeachViewCommand,
    UseTargetCommand,
    ViewTaught,
    VisionCommand,
    VisionMessage,
    VisionSettings,
)
from server.camera.errors import CameraError
from server.camera.looking import LookCollector, TrackCollector
from server.camera.process import HEARTBEAT_PERIOD_S, run_vision
from server.listeners import Listeners
from server.supervised_tasks import whole_in_thread
from server.targets.contracts import AnchoredTarget, SurfacePatch
from server.targets.taught import ObjectBox, TaughtObject, TaughtView
from server.vision.contracts import Array, Look, OdometryPose

REPORT_BUFFER_SIZE = 600  # 40 s at 15 Hz
REPORT_SILENCE_MAX_S = 0.5  # a stream without a report for longer is silent
QUIT_TIMEOUT_S = 4.0
RESTART_DELAY_S = 1.0
SILENT_HEARTBEATS_MAX = 30  # seconds in which a process that had begun says nothing: it is ended and started again
ODOMETRY_START_TIMEOUT_S = 20.0
TARGET_MEASURE_TIMEOUT_S = 30.0  # until a target is measured
Answer = TypeVar("Answer", TargetMeasured, MarksFound, ViewTaught)
ODOMETRY_MAP_TIMEOUT_S = 10.0  # until the map of an odometry run is there
PROCESS_START_TIMEOUT_S = 240.0  # on a new machine everything is compiled first

STARTING_STATUS_TEXT = "camera: vision process is starting"

_log = logging.getLogger(__name__)

OnReport = Callable[[FrameReport], None]


class VisionClient:
    """Used from one asyncio loop. Reports arrive on that loop."""

    def __init__(self, settings: VisionSettings, machine: Machine) -> None:
        self._settings = settings
        self._machine = machine
        self._reports: deque[FrameReport] = deque(maxlen=REPORT_BUFFER_SIZE)
        self._listeners = Listeners[[FrameReport]]("a stereo pair")
        self._arrived = asyncio.Event()
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._restart: asyncio.Task[None] | None = None
        self._overseer: asyncio.Task[None] | None = None
        self._begun = self._heard = False
        self._pose_source: PoseSourceName = "stereo"
        self._track: TrackCollector | None = None
        self._target: AnchoredTarget | TaughtObject | None = None
        self._measured: TargetAnswer | None = None
        self._requests = 0
        self._runs = self._map_wanted = 0  # of odometry
        self.stream_text = STARTING_STATUS_TEXT
        self.latest_preview: tuple[bytes, int] | None = None
        self.last_odometry: tuple[OdometryPose, ...] = ()
        self.last_map: OdometryMap | None = None  # of last_odometry, a little later than it
        self.restarts = 0

    @property
    def masks(self) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """Polygons (k, 2) [px] of the settings over the machine itself, in the left and the right picture."""
        return self._settings.mask_left, self._settings.mask_right

    @property
    def latest(self) -> FrameReport | None:
        """The newest report, however old."""
        return self._reports[-1] if self._reports else None

    @property
    def age_s(self) -> float:
        """Time since the newest pair was received [s]; inf before the first."""
        return float("inf") if self.latest is None else (mono_ns() - self.latest.t_receive_mono_ns) * 1e-9

    @property
    def process_id(self) -> int | None:
        """Of the vision process, while it runs."""
        return self._process.pid if self._process is not None else None

    def reports_since(self, t_mono_ns: int) -> list[FrameReport]:
        """Kept reports of pairs received at or after this time, oldest first."""
        return [report for report in self._reports if report.t_receive_mono_ns >= t_mono_ns]

    def on_report(self, callback: OnReport) -> None:
        """Call this with every report, on the loop."""
        self._listeners.add(callback)

    @property
    def listener_problem(self) -> str:
        """Which of those that `on_report` calls failed lately, and how."""
        return self._listeners.recent_failure

    async def start(self) -> None:
        """Start the vision process; does not wait for the camera."""
        self._loop = asyncio.get_running_loop()
        await whole_in_thread(self._spawn)
        self._overseer = self._loop.create_task(self._oversee(), name="vision-oversight")

    async def close(self) -> None:
        """End the vision process, by force if it does not listen."""
        self._loop = None
        tasks = [task for task in (self._restart, self._overseer) if task is not None]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        process, pipe = self._process, self._pipe
        self._process = self._pipe = None
        if process is None or pipe is None:
            return
        try:
            pipe.send(QuitCommand())
        except OSError:
            _log.info("vision process had already ended")
        await asyncio.to_thread(
            process.join, QUIT_TIMEOUT_S if self._begun else 0.0
        )  # while it compiles it hears nothing
        if process.is_alive():
            process.kill()
            await asyncio.to_thread(process.join, 1.0)
        pipe.close()

    async def set_pose_source(self, name: PoseSourceName) -> None:
        """Find marker poses by both eyes, or by the left eye alone (the paper's way)."""
        if name != self._pose_source:
            self._pose_source = name
            self._send(PoseSourceCommand(name))

    async def look(self, n_pairs: int, timeout_s: float, spread_max_mm: float) -> Look:
        """Robust mean over `n_pairs` fresh pairs; tries until the tool is at rest or time is up."""
        from server.vision.look import average_look

        collector = LookCollector(
            n_pairs=n_pairs,
            t_from_ns=mono_ns() + int(self._settings.exposure_slack_s * 1e9),
            pose_source=self._pose_source,
            average_pairs=lambda pairs: average_look(pairs, spread_max_mm),
        )
        finished: asyncio.Future[Look] = asyncio.get_running_loop().create_future()

        def collect(report: FrameReport) -> None:
            look = collector.add(report) if not finished.done() else None
            if look is not None:
                finished.set_result(look)

        collected = self._listeners.add(collect)
        try:
            async with asyncio.timeout(timeout_s):
                return await finished
        except TimeoutError:
            return collector.at_timeout(timeout_s, self._silence_text())
        finally:
            collected()

    async def measure_target(
        self, sequence: int, pixel: tuple[float, float], roll_rad: float
    ) -> AnchoredTarget | SurfacePatch:
        """Measure the surface at a raw left pixel of a pair that was shown."""
        command = MeasureTargetCommand(self._requests + 1, sequence, pixel, roll_rad)
        return (await self._answered(command, TargetMeasured)).target_or_refused_patch

    async def find_marks(self, sequence: int, diameters_m: tuple[float, ...]) -> MarksFound:
        """Find boreholes and rings in a pair that was shown."""
        answer = await self._answered(FindMarksCommand(self._requests + 1, sequence, diameters_m), MarksFound)
        self._requests += len(answer.marks_with_targets)  # the marks' targets have these numbers
        return answer

    async def teach_view(self, sequence: int, box: ObjectBox) -> TaughtView | str:
        """Landmarks of an object in a pair that was shown, or why that view cannot be used."""
        return (await self._answered(TeachViewCommand(self._requests + 1, sequence, box), ViewTaught)).view_or_reason

    async def _answered(
        self, command: MeasureTargetCommand | FindMarksCommand | TeachViewCommand, kind: type[Answer]
    ) -> Answer:
        """The answer with the command's number, which is of its kind. Raises: CameraError: it does not come."""
        self._requests = command.request_id
        self._send(command)
        try:
            async with asyncio.timeout(TARGET_MEASURE_TIMEOUT_S):
                await self._until(
                    lambda: self._measured is not None and self._measured.request_id >= command.request_id
                )
        except TimeoutError:
            raise CameraError(f"target was not measured within {TARGET_MEASURE_TIMEOUT_S:.0f} s; try again") from None
        if not isinstance(self._measured, kind) or self._measured.request_id != command.request_id:
            raise CameraError("another target was measured in the meantime; choose again")
        return self._measured

    def use_target(self, target: AnchoredTarget | TaughtObject | None) -> None:
        """Serve this target as the object of interest, also after a restart of the process; None: its markers.

        Raises: CameraError: the vision process is not running.
        """
        self._send(UseTargetCommand(target))
        self._target = target

    async def start_odometry(self, masks: bool = False) -> None:
        """Start the camera's own trajectory; returns with its first pose. `masks`: for `odometry_map`.

        Raises: CameraError when no pair comes.
        """
        await self._wait_for_process()
        self._runs += 1
        self._track = track = TrackCollector(self._runs)
        self._send(OdometryCommand(enabled=True, odometry_run=track.odometry_run, still_masks_wanted=masks))
        try:
            async with asyncio.timeout(ODOMETRY_START_TIMEOUT_S):
                await self._until(lambda: bool(track.poses))
        except TimeoutError:
            raise CameraError(
                f"odometry gave no pose within {ODOMETRY_START_TIMEOUT_S:.0f} s; "
                f"{self._silence_text() or 'check the camera'}"
            ) from None

    async def stop_odometry(self) -> CameraTrack:
        """End the trajectory, after the pairs exposed until now have come. Its poses stay in `last_odometry`."""
        track, t_end_ns = self._track, mono_ns()
        if track is None:
            raise CameraError("odometry was not started; start it first")
        try:
            async with asyncio.timeout(REPORT_SILENCE_MAX_S):
                await self._until(lambda: self.latest is not None and self.latest.t_exposure_mapped_ns >= t_end_ns)
        except TimeoutError:
            _log.warning("no pair after the end of the odometry run within %.1f s", REPORT_SILENCE_MAX_S)
        self._track = None
        self._send(OdometryCommand(enabled=False, odometry_run=track.odometry_run))
        self._map_wanted = track.odometry_run
        self.last_odometry, self.last_map = tuple(track.poses), None
        return track.track()

    async def odometry_map(self) -> OdometryMap | None:
        """The map of the run that ended last; None where it does not come."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(ODOMETRY_MAP_TIMEOUT_S):
                await self._until(lambda: self.last_map is not None)
        return self.last_map

    def drop_odometry(self) -> None:
        """Switch odometry off if it is on; its track is no longer needed."""
        track, self._track = self._track, None
        if track is None:
            return
        with contextlib.suppress(CameraError):  # no process, no odometry
            self._send(OdometryCommand(enabled=False, odometry_run=track.odometry_run))

    async def _wait_for_process(self) -> None:
        """Until the vision process has sent something: a picture's report, or what is wrong with its source."""
        try:
            async with asyncio.timeout(PROCESS_START_TIMEOUT_S):
                await self._until(lambda: self.stream_text != STARTING_STATUS_TEXT)
        except TimeoutError:
            raise CameraError(
                f"vision process has not started within {PROCESS_START_TIMEOUT_S:.0f} s; see its log"
            ) from None

    async def _until(self, condition: Callable[[], bool]) -> None:
        while not condition():
            self._arrived.clear()
            await self._arrived.wait()

    def _silence_text(self) -> str:
        if self.stream_text:
            return self.stream_text
        if self.latest is None:
            return "no image yet; check the camera, its power and its cable"
        from server.camera.health.stamps import silence_text

        return "; ".join(found.text for found in silence_text(self.latest.t_receive_mono_ns, mono_ns()))

    def _send(self, command: VisionCommand) -> None:
        if self._pipe is None:
            raise CameraError("vision process is not running; it is restarting")
        try:
            self._pipe.send(command)
        except OSError as error:
            raise CameraError("vision process has ended; it is restarting") from error

    def _spawn(self) -> None:
        context = multiprocessing.get_context("spawn")
        ours, theirs = cast("tuple[Connection, Connection]", context.Pipe())
        process = context.Process(
            target=run_vision, args=(theirs, self._settings, self._machine), name="longreach-vision", daemon=True
        )
        with out_of_the_terminals_reach(signal.SIGTERM):
            process.start()
        theirs.close()
        with contextlib.suppress(OSError):  # it has ended immediately: its reader will say so
            ours.send(PoseSourceCommand(self._pose_source))  # the requested one, perhaps of the process before it
            ours.send(UseTargetCommand(self._target))
        self._process, self._pipe, self._begun = process, ours, False
        threading.Thread(target=self._read, args=(ours, process), name="vision-reports", daemon=True).start()

    def _read(self, pipe: Connection, process: BaseProcess) -> None:
        """Thread: messages from the process to the loop."""
        while True:
            try:
                message: VisionMessage | None = pipe.recv()
            except (EOFError, OSError):
                message = None
                process.join(1.0)  # so that its exit code is known
            loop = self._loop
            if loop is None or loop.is_closed():
                return
            try:
                loop.call_soon_threadsafe(self._receive, message, pipe)
            except RuntimeError:  # the loop closed between the check and the call
                return
            if message is None:
                return

    async def _oversee(self) -> None:
        """End a process that hangs: its reader then says that it is gone, and another is started.

        Counted in looks of our own: while this whole computer stands still, neither side says anything.
        """
        silent = 0
        while True:
            await asyncio.sleep(HEARTBEAT_PERIOD_S)
            silent, self._heard = 0 if self._heard or not self._begun else silent + 1, False
            if silent >= SILENT_HEARTBEATS_MAX and self._process is not None:
                _log.error("no message from the vision process for %.0f s; terminating it", silent * HEARTBEAT_PERIOD_S)
                self._process.kill()
                silent = 0

    def _receive(self, message: VisionMessage | None, pipe: Connection) -> None:
        if message is None:
            return self._lost(pipe)
        self._begun = self._heard = True
        if isinstance(message, FrameReport):
            self._take(message)
        elif isinstance(message, TargetMeasured | MarksFound | ViewTaught):
            self._measured = message
            self._arrived.set()
        elif isinstance(message, OdometryMap):
            if message.odometry_run == self._map_wanted:
                self.last_map = message
                self._arrived.set()
        elif not isinstance(message, SignOfLife):
            self.stream_text = message.text
            self._arrived.set()
            _log.info("camera: %s", message.text or "pictures arrive")

    def _take(self, report: FrameReport) -> None:
        self._reports.append(report)
        if report.preview_jpeg is not None:
            self.latest_preview = (report.preview_jpeg, report.t_receive_mono_ns)
        if self._track is not None:
            self._track.add(report)
        self.stream_text = ""
        self._arrived.set()
        self._listeners.call(report)

    def _lost(self, pipe: Connection) -> None:
        """The vision process died: say so and start another."""
        if self._loop is None or pipe is not self._pipe:
            return
        code = self._process.exitcode if self._process is not None else None
        why = (
            SUSPENDED_REASON
            if self.stream_text == SUSPENDED_REASON
            else f"vision process ended unexpectedly (exit code {code})"
        )
        self.stream_text = f"{why}; starting it again"
        _log.error(self.stream_text)
        self._pipe = None
        pipe.close()
        self.restarts += 1
        self._track = (
            None if self._track is None else TrackCollector(self._track.odometry_run)
        )  # its start frame is lost
        self._restart = self._loop.create_task(self._respawn(), name="vision-restart")

    async def _respawn(self) -> None:
        """Start another, as often as it takes; when cancelled, the one that is being started is there to be ended."""
        while True:
            await asyncio.sleep(RESTART_DELAY_S)
            try:
                return await whole_in_thread(self._spawn)
            except Exception as error:  # no processes, files or threads left, or a defect: without it nothing is seen
                self.stream_text = f"vision process ended and could not be started again ({error}); trying again"
                _log.exception(self.stream_text)
