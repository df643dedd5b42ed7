"""Pairs through the real pipeline: as fast as it goes, then at the camera's pace with late pairs dropped."""

import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import islice

import cv2
import numpy as np

from benchmarks.vision.rate.pairs import RATE_HZ, PairsInMemory
from benchmarks.vision.rate.stages import StageTimes, TimedOdometry, timed_sources
from machine.description import Machine
from server.camera.contracts import FrameReport, VisionSettings
from server.camera.pipeline import Odometry, VisionPipeline
from server.camera.process import THREAD_SWITCH_INTERVAL_S
from server.camera.sources.settings import HttpSource
from server.vision.aruco_source import ArucoPoseSource
from server.vision.contracts import OdometryStatus, PoseStatus
from server.vision.odometry import StereoOdometry

WARM_UP_PAIRS = 60
LATENCY_LIMIT_MS = 33.0
OnPair = Callable[[], None]


@dataclass(frozen=True, slots=True)
class RateFigures:
    """What one run gave. Latency: from the pair's being there to its report."""

    n_pairs: int
    pairs_per_s: float
    latency_p50_ms: float
    latency_p99_ms: float
    latency_max_ms: float
    cpu_ms_per_pair: float
    dropped: int
    tool_ok_frac: float
    ooi_ok_frac: float
    odometry_ok_frac: float
    stages: dict[str, tuple[float, float, float]]

    def as_json(self) -> dict[str, object]:
        """For the file beside the table."""
        return asdict(self)


def _pipeline(machine: Machine, times: StageTimes) -> VisionPipeline:
    settings = VisionSettings(HttpSource("http://in-memory/"))
    cv2.setNumThreads(settings.threads)
    sys.setswitchinterval(THREAD_SWITCH_INTERVAL_S)
    source = ArucoPoseSource(machine)

    def make_odometry() -> Odometry:
        return TimedOdometry(StereoOdometry(machine.camera), times)

    tool_ids = [marker.marker_id for marker in machine.markers_on("tool")]
    pipeline = VisionPipeline(
        settings, tool_ids, timed_sources({"stereo": source, "mono": source}, times), make_odometry
    )
    pipeline.switch_odometry(True)
    return pipeline


def run_rate(machine: Machine, pairs: PairsInMemory, n: int, paced: bool, on_pair: OnPair) -> RateFigures:
    """`n` pairs after a warm-up. Paced: pair k is there at k/60 s, and dropped once its successor is there, too."""
    times = StageTimes()
    pipeline = _pipeline(machine, times)
    frames = pairs.frames()
    for frame in islice(frames, WARM_UP_PAIRS):
        pipeline.process(frame, 0)
    times.ms.clear()
    whole = times.of("all but odometry", pipeline.process)
    reports: list[FrameReport] = []
    latencies_ms: list[float] = []
    dropped, taken = 0, 0
    cpu_s, started_s = time.process_time(), time.perf_counter()
    while taken < n:
        frame = next(frames)
        due_s = started_s + taken / RATE_HZ if paced else time.perf_counter()
        taken += 1
        on_pair()
        now_s = time.perf_counter()
        if now_s < due_s:
            time.sleep(due_s - now_s)
        elif paced and now_s - due_s > 1.0 / RATE_HZ:
            dropped += 1
            continue
        reports.append(whole(frame, dropped))
        latencies_ms.append((time.perf_counter() - due_s) * 1e3)
    took_s, cpu_s = time.perf_counter() - started_s, time.process_time() - cpu_s
    pipeline.close()
    return _figures(reports, latencies_ms, took_s, cpu_s, dropped, times)


def _figures(
    reports: list[FrameReport], latencies_ms: list[float], took_s: float, cpu_s: float, dropped: int, times: StageTimes
) -> RateFigures:
    done = len(reports)
    p50, p99 = np.percentile(latencies_ms, [50, 99])
    return RateFigures(
        n_pairs=done,
        pairs_per_s=done / took_s,
        latency_p50_ms=float(p50),
        latency_p99_ms=float(p99),
        latency_max_ms=float(np.max(latencies_ms)),
        cpu_ms_per_pair=1e3 * cpu_s / done,
        dropped=dropped,
        tool_ok_frac=float(np.mean([one.observation.tool.status is PoseStatus.OK for one in reports])),
        ooi_ok_frac=float(np.mean([one.observation.ooi.status is PoseStatus.OK for one in reports])),
        odometry_ok_frac=float(
            np.mean([one.odometry is not None and one.odometry.status is OdometryStatus.OK for one in reports])
        ),
        stages={stage: times.figures(stage, done) for stage in times.ms},
    )
