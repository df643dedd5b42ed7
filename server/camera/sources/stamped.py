"""Stored pairs with stamps, played once at their own pace: what data sets and recordings have in common."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from recording.clock import mono_ns
from server.camera.contracts import StereoFrame
from server.camera.errors import CameraError
from server.camera.sources.pacing import StampPacing
from server.vision.contracts import Image


@dataclass(frozen=True, slots=True)
class StoredPair:
    """A pair that is decoded when it is due."""

    t_exposure_ns: int
    decode: Callable[[], tuple[Image, Image]]


class StampedStereoSource:
    """Plays stored pairs; every one is given out, for a replay is there to be looked at whole."""

    def __init__(self, subject: str, pairs: Iterator[StoredPair], speed: float) -> None:
        self._subject = subject
        self._pairs = pairs
        self._pacing = StampPacing(speed)
        self._next: StoredPair | None = None
        self._number = 0
        self.skipped = 0
        self.state = ""
        self._advance()
        if self._next is None:
            raise CameraError(self.state or f"{subject}: no pair of both eyes in it; give one that has some")

    @property
    def ended(self) -> bool:
        """Whether the last pair has been given out."""
        return self._next is None

    def read(self, timeout_s: float) -> StereoFrame | None:
        """The next pair, when it is due."""
        pair = self._next
        if pair is None or not self._pacing.wait(pair.t_exposure_ns, timeout_s):
            return None
        t_receive_ns = mono_ns()
        self._advance()
        try:
            left, right = pair.decode()
        except CameraError as error:
            self.skipped += 1
            self.state = f"{self._subject}: {error} ({self.skipped} pictures left out)"
            return None
        self._number += 1
        self.state = f"{self._subject}: end after {self._number} pairs" if self.ended else ""
        return StereoFrame(left, right, pair.t_exposure_ns, t_receive_ns, self._number)

    def _advance(self) -> None:
        """Find the next pair; a damaged message ends the replay."""
        try:
            self._next = next(self._pairs, None)
        except CameraError as error:
            self._next, self.state = None, f"{self._subject}: ends here: {error}"

    def close(self) -> None:
        """Let go of what is not played."""
        self._pairs, self._next = iter(()), None
