"""Stored pictures played at their own pace."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from recording.clock import mono_ns, mono_s
from server.camera.contracts import StereoFrame
from server.camera.errors import CameraError
from server.vision.contracts import Image


class Pacing:
    """Says when the next picture is due; a late reader is not made to catch up."""

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1.0 / rate_hz
        self._due_s: float | None = None

    def wait(self, timeout_s: float) -> bool:
        """Sleep until the next picture is due, at most the timeout; whether it is due."""
        now_s = mono_s()
        due_s = now_s if self._due_s is None else self._due_s
        if due_s - now_s > timeout_s:
            time.sleep(timeout_s)
            return False
        time.sleep(max(0.0, due_s - now_s))
        self._due_s = max(due_s, now_s) + self._period_s
        return True


class StampPacing:
    """As `Pacing`, by the pictures' own stamps."""

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._begin: tuple[float, int] | None = None  # clock [s] and stamp [ns] that belong together

    def wait(self, t_ns: int, timeout_s: float) -> bool:
        """Sleep until the picture of this stamp is due, at most the timeout; whether it is due."""
        now_s = mono_s()
        if self._begin is None:
            self._begin = (now_s, t_ns)
        begin_s, begin_ns = self._begin
        due_s = begin_s + (t_ns - begin_ns) * 1e-9 / self._speed
        if due_s - now_s > timeout_s:
            time.sleep(timeout_s)
            return False
        if now_s > due_s:
            self._begin = (now_s, t_ns)  # late: go on from here
        else:
            time.sleep(due_s - now_s)
        return True


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
