"""CPU time of each stage of the pipeline, taken inside the thread that runs it."""

import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import ParamSpec, TypeVar

import numpy as np

from server.camera.contracts import PoseSourceName
from server.camera.pipeline import Odometry
from server.vision.contracts import Array, Image, ObjectPoseSource, OdometryPose, PairObservation

P = ParamSpec("P")
R = TypeVar("R")


@dataclass(slots=True)
class StageTimes:
    """CPU milliseconds of every call, by stage."""

    ms: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))

    @contextmanager
    def measured(self, stage: str):
        """Add this thread's CPU time within the block."""
        started = time.thread_time()
        try:
            yield
        finally:
            self.ms[stage].append((time.thread_time() - started) * 1e3)

    def of(self, stage: str, call: Callable[P, R]) -> Callable[P, R]:
        """The same call, measured."""

        def timed(*args: P.args, **kwargs: P.kwargs) -> R:
            with self.measured(stage):
                return call(*args, **kwargs)

        return timed

    def figures(self, stage: str, n_pairs: int) -> tuple[float, float, float]:
        """Per pair: mean, median and 99th percentile of the calls [ms]."""
        values = np.array(self.ms[stage])
        return float(values.sum() / n_pairs), float(np.median(values)), float(np.percentile(values, 99))


@dataclass(frozen=True, slots=True)
class TimedSource:
    """A pose source whose time is taken."""

    source: ObjectPoseSource
    times: StageTimes

    def observe(self, left: Image, right: Image, t_exposure_ns: int) -> PairObservation:
        """As the source does."""
        with self.times.measured("markers"):
            return self.source.observe(left, right, t_exposure_ns)


@dataclass(frozen=True, slots=True)
class TimedOdometry:
    """An odometry whose time is taken."""

    odometry: Odometry
    times: StageTimes

    def process(
        self,
        left: Image,
        right: Image,
        t_exposure_ns: int,
        mask_polygons_left: Sequence[Array] = (),
        mask_polygons_right: Sequence[Array] = (),
    ) -> OdometryPose:
        """As the odometry does."""
        with self.times.measured("odometry"):
            return self.odometry.process(left, right, t_exposure_ns, mask_polygons_left, mask_polygons_right)

    def map_points(self, count_max: int) -> Array:
        """As the odometry tells them."""
        return self.odometry.map_points(count_max)


def timed_sources(
    sources: Mapping[PoseSourceName, ObjectPoseSource], times: StageTimes
) -> dict[PoseSourceName, ObjectPoseSource]:
    """All of them measured."""
    return {name: TimedSource(source, times) for name, source in sources.items()}
