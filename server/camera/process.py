"""The vision process: reads the camera, newest pair first, and reports every pair it has worked on.

It ends on a QuitCommand, or when the server's end of the pipe is gone.
"""

import gc
import logging
import sys
from multiprocessing.connection import Connection

import cv2
import numpy as np

from machine.description import Machine
from recording.clock import SUSPENDED_REASON, SuspendWatch, mono_ns, mono_s
from server.camera.contracts import (
    FindMarksCommand,
    MeasureTargetCommand,
    OdometryCommand,
    PoseSourceCommand,
    PoseSourceName,
    QuitCommand,
    SignOfLife,
    StereoFrame,
    StereoSource,
    StreamNotice,
    TeachViewCommand,
    UseTargetCommand,
    VisionCommand,
    VisionSettings,
)
from server.camera.errors import CameraError
from server.camera.health.image_health import ImageHealth
from server.camera.pipeline import Odometry, VisionPipeline
from server.camera.sources.opening import open_ahead
from server.camera.sources.side_by_side import decode_grey
from server.camera.target_measuring import TargetMeasurementWorker
from server.targets.source import TargetPoseSource
from server.targets.tool_mask import ToolMask
from server.vision.contracts import Image, ObjectPoseSource
from server.vision.marker_search import dictionary_by_name

# How soon a thread hands the interpreter on; Python's 5 ms are a third of a pair's time
THREAD_SWITCH_INTERVAL_S = 0.0005
WARM_UP_PERIOD_NS = 66_000_000
HEARTBEAT_PERIOD_S = 1.0  # a sign of life comes as often
READ_TIMEOUT_S = 0.1  # how soon a command is heard when no pictures come

_log = logging.getLogger(__name__)


def build_pipeline(settings: VisionSettings, machine: Machine) -> VisionPipeline:
    """The pipeline with the marker detector and odometry of this machine, warmed up; its threads take short turns."""
    from server.vision.aruco_source import ArucoPoseSource, MonoArucoPoseSource
    from server.vision.odometry import StereoOdometry

    sys.setswitchinterval(THREAD_SWITCH_INTERVAL_S)

    def make_odometry() -> Odometry:
        return StereoOdometry(machine.camera)

    _warm_up(machine, ArucoPoseSource(machine), make_odometry(), ImageHealth(machine.camera))  # they remember pairs
    markers = ArucoPoseSource(machine)
    tool_ids = {marker.marker_id: 1.0 for marker in machine.markers_on("tool")}
    for board in machine.boards_on("tool"):
        if board.kind == "charuco":  # its inner corners are seen; a grid's markers are listed one by one
            fewest = min(board.squares_x, board.squares_y)
            tool_ids[board.first_id] = fewest / max(fewest - 2, 1)
    source = TargetPoseSource(markers, machine.camera, ToolMask(tool_ids, settings.mask_scale))
    sources: dict[PoseSourceName, ObjectPoseSource] = {"stereo": source, "mono": MonoArucoPoseSource(machine)}
    targets = TargetMeasurementWorker(machine.camera, source)
    return VisionPipeline(settings, tool_ids, sources, make_odometry, machine.camera, targets)


def _warm_up(machine: Machine, source: ObjectPoseSource, odometry: Odometry, health: ImageHealth) -> None:
    """Compile what is compiled on first use now, on a made-up wall with markers, and not during the first motion."""
    for number, (left, right) in enumerate(made_up_pairs(machine)):
        decode_grey(cv2.imencode(".jpg", left)[1].reshape(-1))
        t_ns = number * WARM_UP_PERIOD_NS
        health.inspect(StereoFrame(left, right, t_ns, t_ns, number), source.observe(left, right, t_ns))
        odometry.process(left, right, t_ns)


def made_up_pairs(machine: Machine) -> list[tuple[Image, Image]]:
    """Three pairs of a wall that moves by 2 px, with one marker of the tool and one of the OOI that face the camera."""
    camera, dictionary = machine.camera, dictionary_by_name(machine.dictionary)
    coarse = np.random.default_rng(0).integers(40, 220, (camera.height_px // 8 + 1, camera.width_px // 8 + 8))
    wall = cv2.resize(coarse.astype(np.uint8), None, fx=8.0, fy=8.0, interpolation=cv2.INTER_CUBIC)
    markers = (*machine.markers_on("tool")[:1], *machine.markers_on("ooi")[:1])
    side = camera.height_px // 8
    pairs = []
    for number in range(3):
        left, right = (
            np.ascontiguousarray(wall[: camera.height_px, start : start + camera.width_px], np.uint8)
            for start in (2 * number, 2 * number + 24)
        )
        for place, marker in enumerate(markers):
            drawn = cv2.aruco.generateImageMarker(dictionary, marker.marker_id, side)
            print_out = np.pad(np.asarray(drawn, np.uint8), side // 6, constant_values=255)
            x, y = camera.width_px // 2 + (2 * place - 1) * side - side // 2, (camera.height_px - len(print_out)) // 2
            disparity = round(camera.baseline_m * side / marker.side_m)
            for eye, shift in ((left, 0), (right, disparity)):
                start = max(0, x - shift)
                eye[y : y + len(print_out), start : start + len(print_out)] = print_out
        pairs.append((left, right))
    return pairs


def run_vision(pipe: Connection, settings: VisionSettings, machine: Machine) -> None:
    """Entry point of the process."""
    cv2.setNumThreads(settings.threads)
    try:
        pipeline = build_pipeline(settings, machine)
        source = open_ahead(settings.source)
    except CameraError as error:
        _report_and_wait(pipe, str(error))
        return
    gc.collect()
    gc.freeze()  # what exists now stays; later collections are short
    try:
        VisionLoop(pipe, source, pipeline).run()
    except (EOFError, BrokenPipeError, ConnectionResetError):
        _log.info("the server has ended; the vision process ends")
    finally:
        source.close()
        pipeline.close()


def _report_and_wait(pipe: Connection, text: str) -> None:
    """A source that can never work: report it and wait for a QuitCommand, so that it is not started again and again."""
    try:
        pipe.send(StreamNotice(mono_ns(), text))
        while not (pipe.poll(HEARTBEAT_PERIOD_S) and isinstance(pipe.recv(), QuitCommand)):
            pipe.send(SignOfLife())
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return


class VisionLoop:
    """Commands in, pairs through the pipeline, reports out."""

    def __init__(self, pipe: Connection, source: StereoSource, pipeline: VisionPipeline) -> None:
        self._pipe = pipe
        self._source = source
        self._pipeline = pipeline
        self._state = ""
        self._life_s = mono_s()
        self._quit = False
        self._suspend = SuspendWatch()

    def run(self) -> None:
        """Until QuitCommand; EOFError or BrokenPipeError when the server is gone."""
        while not self._quit:
            self.run_once(READ_TIMEOUT_S)

    def run_once(self, timeout_s: float) -> None:
        """One turn: all waiting commands, then at most one pair."""
        while self._pipe.poll(0.0):
            self._execute_command(self._pipe.recv())
        frame = None if self._quit else self._source.read(timeout_s)
        if self._source.ended and frame is None and not self._quit:
            self._quit = self._pipe.poll(timeout_s) and self._execute_command(self._pipe.recv())
        if self._suspend.was_suspended():  # what is buffered is old, and the camera's clock may have stood: begun again
            self._pipe.send(StreamNotice(mono_ns(), SUSPENDED_REASON))
            self._quit = True
            return
        if frame is not None:
            self._pipe.send(self._pipeline.process(frame, self._source.skipped))
        for answer in self._pipeline.targets_measured():
            self._pipe.send(answer)
        if mono_s() - self._life_s >= HEARTBEAT_PERIOD_S:
            self._life_s = mono_s()
            self._pipe.send(SignOfLife())
        self._report_state()  # after the pair: a stream may have ended behind it

    def _report_state(self) -> None:
        state = self._source.state
        if state != self._state:
            self._state = state
            self._pipe.send(StreamNotice(mono_ns(), state))

    def _execute_command(self, command: VisionCommand) -> bool:
        match command:
            case OdometryCommand():
                ended = self._pipeline.switch_odometry(
                    command.enabled, command.odometry_run, command.still_masks_wanted
                )
                if ended is not None:
                    self._pipe.send(ended)
            case PoseSourceCommand(pose_source=name):
                self._pipeline.use_pose_source(name)
            case MeasureTargetCommand() | FindMarksCommand() | UseTargetCommand() | TeachViewCommand():
                self._pipeline.obey_target(command)
            case QuitCommand():
                self._quit = True
        return self._quit
