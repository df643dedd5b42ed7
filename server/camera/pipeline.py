"""One stereo pair in, one report out: health, marker poses and odometry side by side, preview."""

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol

import cv2

from machine.description import StereoCamera
from server.camera.clock import CameraClock
from server.camera.contracts import (
    FrameReport,
    MeasureTargetCommand,
    OdometryMap,
    PoseSourceName,
    StereoFrame,
    TargetMeasured,
    UseTargetCommand,
    VisionSettings,
)
from server.camera.health import ImageHealth, sharpness
from server.camera.masking import ToolMask
from server.camera.own_structure import SpreadPairs
from server.camera.target_measuring import TargetMeasuring
from server.vision.contracts import Array, Image, ObjectPoseSource, OdometryPose

MAP_POINTS = 600  # told at the end of a run, for the 3D view
RATE_FRAMES = 30  # the frame rate is averaged over this many pairs


class Odometry(Protocol):
    """What the pipeline asks of a stereo odometry."""

    def process(
        self,
        left: Image,
        right: Image,
        t_exposure_ns: int,
        mask_polygons_left: Sequence[Array] = (),
        mask_polygons_right: Sequence[Array] = (),
    ) -> OdometryPose:
        """Pose of the left camera in the odometry's start frame."""
        ...

    def map_points(self, count_max: int) -> Array:
        """At most so many points of its map (n, 3) in that frame [m]."""
        ...


class VisionPipeline:
    """Holds what must be remembered from pair to pair; knows neither camera nor process.

    Odometry runs in a thread of its own beside the markers: nearly all of both is compiled and lets go of the
    interpreter. It masks the tool where the pair before showed it, which is where it still is.
    """

    def __init__(
        self,
        settings: VisionSettings,
        tool_ids: Sequence[int] | Mapping[int, float],
        pose_sources: Mapping[PoseSourceName, ObjectPoseSource],
        make_odometry: Callable[[], Odometry],
        camera: StereoCamera | None = None,
        targets: TargetMeasuring | None = None,
    ) -> None:
        self._settings = settings
        self._targets = targets
        self._pose_sources = pose_sources
        self._make_odometry = make_odometry
        self._pose_source: PoseSourceName = "stereo"
        self._odometry: Odometry | None = None
        self._odometry_started = False
        self._odometry_run = 0
        self._pictures: SpreadPairs | None = None
        self._clock = CameraClock()
        self._health = ImageHealth(camera)
        self._mask = ToolMask(tool_ids, settings.mask_scale)
        self._receive_ns: deque[int] = deque(maxlen=RATE_FRAMES)
        self._preview_ns = 0
        self._beside = ThreadPoolExecutor(max_workers=1, thread_name_prefix="odometry")

    def use_pose_source(self, name: PoseSourceName) -> None:
        """Find marker poses in this way from the next pair on."""
        self._pose_source = name

    def switch_odometry(self, on: bool, run: int = 0, masks: bool = False) -> OdometryMap | None:
        """On: a new odometry with a start frame of its own; off: none. Returns the map of the one switched off."""
        ended, started, ended_run = self._odometry, self._odometry_started, self._odometry_run
        self._odometry = self._make_odometry() if on else None
        self._odometry_started, self._odometry_run = False, run
        pictures, self._pictures = self._pictures, SpreadPairs() if on and masks else None
        if ended is None or not started or on:
            return None
        still = (None, None) if pictures is None else pictures.masks()
        return OdometryMap(ended.map_points(MAP_POINTS), ended_run, still)

    def obey_target(self, command: MeasureTargetCommand | UseTargetCommand) -> None:
        """Measure a target, or serve one; without a target source nothing happens."""
        if self._targets is not None:
            self._targets.obey(command)

    def targets_measured(self) -> list[TargetMeasured]:
        """Measured targets that are ready, each once."""
        return [] if self._targets is None else self._targets.finished()

    def close(self) -> None:
        """End the threads."""
        self._beside.shutdown()
        if self._targets is not None:
            self._targets.close()

    def process(self, frame: StereoFrame, skipped: int) -> FrameReport:
        """Everything this pair tells. Never raises on what the images show."""
        started_s = time.perf_counter()
        findings = self._health.before_use(frame)
        forbidden = any(finding.forbids_odometry for finding in findings)
        mapped_ns = self._clock.map(
            frame.t_exposure_ns, frame.t_receive_mono_ns, frame.connection, self._health.stamp_short_ns
        )
        if self._pictures is not None and not forbidden:
            self._pictures.add(frame.left, frame.right)
        following = None if forbidden else self._follow_beside(frame)
        observation = self._pose_sources[self._pose_source].observe(frame.left, frame.right, frame.t_exposure_ns)
        self._mask.update(observation.views)
        if following is None and not forbidden:
            odometry = self._follow(frame)
        else:
            odometry = following.result() if following is not None else None
        findings += self._health.after_markers(observation)
        preview = self._preview(frame)
        self._receive_ns.append(frame.t_receive_mono_ns)
        return FrameReport(
            observation=observation,
            t_receive_mono_ns=frame.t_receive_mono_ns,
            t_exposure_mapped_ns=mapped_ns,
            sequence=frame.sequence,
            pose_source=self._pose_source,
            odometry=odometry,
            odometry_run=self._odometry_run,
            fps=self._rate_hz(),
            process_ms=(time.perf_counter() - started_s) * 1e3,
            skipped=skipped,
            warnings=tuple(finding.text for finding in findings if finding.forbids_look),
            sharpness=sharpness(frame.left),
            preview_jpeg=preview,
            preview_width_px=self._preview_width_px(frame.left),
        )

    def _follow_beside(self, frame: StereoFrame) -> Future[OdometryPose | None] | None:
        """Started at once; not for the first pair, whose markers must say first where the tool is."""
        if self._odometry is None or not self._odometry_started:
            return None
        return self._beside.submit(self._follow, frame)

    def _follow(self, frame: StereoFrame) -> OdometryPose | None:
        if self._odometry is None:
            return None
        self._odometry_started = True
        return self._odometry.process(
            frame.left,
            frame.right,
            frame.t_exposure_ns,
            mask_polygons_left=(*self._settings.mask_left, *self._mask.left),
            mask_polygons_right=(*self._settings.mask_right, *self._mask.right),
        )

    def _rate_hz(self) -> float:
        span_ns = self._receive_ns[-1] - self._receive_ns[0]
        return (len(self._receive_ns) - 1) * 1e9 / span_ns if span_ns > 0 else 0.0

    def _preview_width_px(self, image: Image) -> int:
        return min(self._settings.preview_width_px, image.shape[1])

    def _preview(self, frame: StereoFrame) -> bytes | None:
        settings = self._settings
        if frame.t_receive_mono_ns - self._preview_ns < 1e9 / settings.preview_rate_hz:
            return None
        self._preview_ns = frame.t_receive_mono_ns
        width_px = self._preview_width_px(frame.left)
        size = (width_px, round(frame.left.shape[0] * width_px / frame.left.shape[1]))
        small = cv2.resize(frame.left, size, interpolation=cv2.INTER_AREA)
        good, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, settings.preview_quality])
        if self._targets is not None:
            self._targets.keep(frame)
        return jpeg.tobytes() if good else None
