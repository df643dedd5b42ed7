"""One stereo pair in, one report out: health, marker poses and odometry side by side, preview."""

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol

import cv2

from machine.description import StereoCamera
from server.camera.contracts import (
    FrameReport,
    OdometryMap,
    PoseSourceName,
    StereoFrame,
    TargetAnswer,
    TargetCommand,
    VisionSettings,
)
from server.camera.health.blur import sharpness
from server.camera.health.image_health import ImageHealth
from server.camera.own_structure import SpreadPairs
from server.camera.smallest_offset import SmallestOffset, aged_offset
from server.camera.target_measuring import TargetMeasurementWorker
from server.targets.tool_mask import ToolMask
from server.vision.contracts import Array, Image, ObjectPoseSource, OdometryPose

MAP_POINTS = 600  # reported at the end of a run, for the 3D view
RATE_WINDOW_PAIRS = 30  # the frame rate is averaged over this many pairs

# Most by which pairs must all be later than the map before it follows a clock that was set back
CLOCK_STEP_MIN_NS = 50_000_000
CLOCK_STEP_PAIRS = 8


class CameraClock:
    """Maps exposure stamps to the PC's monotonic clock.

    Model:   offset = min over all pairs i of (receive_i - stamp_i + drift_max * age_i).
    Bound:   for a drift within +-100 ppm the mapped exposure is never earlier than the true one plus the camera's
             smallest latency, and later by at most min over the pairs of (latency_i - smallest + 2 * 100 ppm * age_i):
             with a pair of nearly the smallest latency every second, 0.2 ms plus its excess.
    Steps:   a clock that is set forward is followed immediately. A picture that comes later than the map says is either
             of a clock that was set back, or old; taking the second for the first would make old pictures fresh. So
             the map becomes later only after stamps that fell short of the camera's usual step, by no more than they
             did, and from the 8th pair on (health forbids those pairs). What is not seen in the stamps, as a step of
             less than half a period, leaves the map early by as much, which ageing makes good at 100 ppm.
             A stamp that runs backwards once, out of order, changes nothing.
    """

    def __init__(self) -> None:
        self._smallest = SmallestOffset()
        self._connection = 0
        self._t_receive_ns = 0
        self._short_ns = 0  # by what stamps fell short, as long as it is not followed
        self._since: list[tuple[int, int]] = []  # (receive time, offset) from that pair on

    @property
    def offset_ns(self) -> int:
        """PC time minus camera time [ns] at the last pair; 0 before the first."""
        return self._smallest.offset_at(self._t_receive_ns)

    def to_pc_clock(self, t_exposure_ns: int, t_receive_mono_ns: int, connection: int = 0, short_ns: int = 0) -> int:
        """The exposure on the PC's clock [ns]; a new connection starts afresh.

        `short_ns`: by how much this stamp came too soon after the one before, for the exposures between them.
        """
        offset_ns = t_receive_mono_ns - t_exposure_ns
        if connection != self._connection:
            self._smallest, self._connection, self._short_ns = SmallestOffset(), connection, 0
        self._t_receive_ns = t_receive_mono_ns
        self._smallest.learn(t_receive_mono_ns, offset_ns)
        if short_ns > 0:
            self._short_ns += short_ns
            self._since.clear()
        if self._short_ns > 0:
            self._since.append((t_receive_mono_ns, offset_ns))
            if len(self._since) == CLOCK_STEP_PAIRS:
                self._follow()
        return t_exposure_ns + self.offset_ns

    def _follow(self) -> None:
        """The clock was set back if every pair since then is later than the map."""
        now_ns = self._t_receive_ns
        later_ns = min(aged_offset(*seen, now_ns) for seen in self._since) - self.offset_ns
        if later_ns > min(CLOCK_STEP_MIN_NS, self._short_ns // 2):
            self._smallest.begin(now_ns, self.offset_ns + min(later_ns, self._short_ns))
        self._short_ns = 0
        self._since.clear()


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

    Odometry runs in a thread alongside the markers: nearly all of both is compiled and lets go of the
    interpreter. It masks the tool where the pair before showed it, which is where it still is.
    """

    def __init__(
        self,
        settings: VisionSettings,
        tool_ids: Sequence[int] | Mapping[int, float],
        pose_sources: Mapping[PoseSourceName, ObjectPoseSource],
        make_odometry: Callable[[], Odometry],
        camera: StereoCamera | None = None,
        targets: TargetMeasurementWorker | None = None,
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
        self._receive_ns: deque[int] = deque(maxlen=RATE_WINDOW_PAIRS)
        self._preview_ns = 0
        self._odometry_thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="odometry")

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

    def obey_target(self, command: TargetCommand) -> None:
        """Measure a target or a view of an object, or serve one; without a target source nothing happens."""
        if self._targets is not None:
            self._targets.execute_command(command)

    def targets_measured(self) -> list[TargetAnswer]:
        """Measured targets, found marks and taught views finished since the last call; each is returned once only."""
        return [] if self._targets is None else self._targets.take_finished()

    def close(self) -> None:
        """End the threads."""
        self._odometry_thread.shutdown()
        if self._targets is not None:
            self._targets.close()

    def process(self, frame: StereoFrame, skipped: int) -> FrameReport:
        """Everything this pair shows. Never raises on what the images show."""
        started_s = time.perf_counter()
        findings = self._health.before_use(frame)
        forbidden = any(finding.forbids_odometry for finding in findings)
        mapped_ns = self._clock.to_pc_clock(
            frame.t_exposure_ns, frame.t_receive_mono_ns, frame.connection_number, self._health.stamp_short_ns
        )
        if self._pictures is not None and not forbidden:
            self._pictures.add(frame.left, frame.right)
        following = None if forbidden else self._start_following(frame)
        observation = self._pose_sources[self._pose_source].observe(frame.left, frame.right, frame.t_exposure_ns)
        self._mask.update(observation.marker_views)
        if following is None and not forbidden:
            odometry = self._follow(frame)
        else:
            odometry = following.result() if following is not None else None
        findings += self._health.after_markers(observation)
        preview = self._encode_preview(frame)
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
            n_skipped=skipped,
            warnings=tuple(finding.text for finding in findings if finding.forbids_look),
            sharpness=sharpness(frame.left),
            preview_jpeg=preview,
            preview_width_px=self._preview_width_px(frame.left),
        )

    def _start_following(self, frame: StereoFrame) -> Future[OdometryPose | None] | None:
        """Odometry of this pair, in its thread; not for the first pair, whose markers must first show the tool."""
        if self._odometry is None or not self._odometry_started:
            return None
        return self._odometry_thread.submit(self._follow, frame)

    def _follow(self, frame: StereoFrame) -> OdometryPose | None:
        if self._odometry is None:
            return None
        self._odometry_started = True
        return self._odometry.process(
            frame.left,
            frame.right,
            frame.t_exposure_ns,
            mask_polygons_left=(*self._settings.mask_left, *self._mask.left_polygons),
            mask_polygons_right=(*self._settings.mask_right, *self._mask.right_polygons),
        )

    def _rate_hz(self) -> float:
        span_ns = self._receive_ns[-1] - self._receive_ns[0]
        return (len(self._receive_ns) - 1) * 1e9 / span_ns if span_ns > 0 else 0.0

    def _preview_width_px(self, image: Image) -> int:
        return min(self._settings.preview_width_px, image.shape[1])

    def _encode_preview(self, frame: StereoFrame) -> bytes | None:
        settings = self._settings
        if frame.t_receive_mono_ns - self._preview_ns < 1e9 / settings.preview_rate_hz:
            return None
        self._preview_ns = frame.t_receive_mono_ns
        width_px = self._preview_width_px(frame.left)
        size = (width_px, round(frame.left.shape[0] * width_px / frame.left.shape[1]))
        small = cv2.resize(frame.left, size, interpolation=cv2.INTER_AREA)
        good, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, settings.preview_quality])
        if self._targets is not None:
            self._targets.keep_shown_pair(frame)
        return jpeg.tobytes() if good else None
