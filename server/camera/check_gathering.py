"""Collecting what the check looks at: every pair's times, and some pairs whole, spread over the time there is."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from server.camera.check import Gathered
from server.camera.check_stream import StreamTimes
from server.camera.contracts import StereoFrame
from server.vision.contracts import Image

RATE_PAIRS = 30


@dataclass(slots=True)
class Gathering:
    """Takes pairs as they come. Of the pairs themselves only `keep` are copied: at least `every_ns` apart."""

    keep: int
    seconds: float
    times: list[tuple[int, int, int, int]] = field(default_factory=list)
    pairs: list[tuple[Image, Image, int]] = field(default_factory=list)
    _kept_ns: int = -(1 << 62)

    @property
    def n(self) -> int:
        """Pairs so far."""
        return len(self.times)

    @property
    def rate_hz(self) -> float:
        """Of the last pairs, by their arrival."""
        recent = self.times[-RATE_PAIRS:]
        span_ns = recent[-1][1] - recent[0][1] if recent else 0
        return (len(recent) - 1) * 1e9 / span_ns if span_ns > 0 else 0.0

    @property
    def missing(self) -> int:
        """Sequence numbers that never came."""
        steps = ((one, after) for one, after in pairwise(self.times) if one[3] == after[3])
        return sum(max(0, after[2] - one[2] - 1) for one, after in steps)

    def add(self, frame: StereoFrame) -> None:
        """The next pair."""
        self.times.append((frame.t_exposure_ns, frame.t_receive_mono_ns, frame.sequence, frame.connection))
        every_ns = self.seconds * 1e9 / self.keep
        if len(self.pairs) < self.keep and frame.t_receive_mono_ns - self._kept_ns >= every_ns:
            self._kept_ns = frame.t_receive_mono_ns
            self.pairs.append((np.array(frame.left), np.array(frame.right), frame.t_exposure_ns))

    def gathered(
        self, skipped: int, own_clock: bool = False, wanted_hz: float | None = None, stored: bool = False
    ) -> Gathered:
        """For `check_camera`."""
        columns = np.array(self.times, dtype=np.int64).reshape(-1, 4).T
        times = StreamTimes(*columns, skipped=skipped, own_clock=own_clock, wanted_hz=wanted_hz, stored=stored)
        return Gathered(times, tuple(self.pairs))
