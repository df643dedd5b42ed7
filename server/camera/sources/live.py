"""A camera read by a thread that keeps its newest picture; one that is lost is asked again, with back-off."""

import logging
import threading
from abc import ABC, abstractmethod
from typing import ClassVar, Generic, TypeVar

from recording.clock import mono_ns

Item = TypeVar("Item")

HEARTBEAT_PERIOD_S = 0.05
STALL_MIN_NS = 500_000_000  # a busy computer leaves a process without a turn for some tenths of a second
STALL_WARNING_TEXT = "this process was held up; pictures that waited meanwhile are dropped"

_log = logging.getLogger(__name__)


class NewestOnlyBox(Generic[Item]):
    """One place; putting into a full box replaces and counts what was never taken."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._item: Item | None = None
        self.skipped = 0

    def put(self, item: Item) -> None:
        """Make this the newest item."""
        with self._condition:
            if self._item is not None:
                self.skipped += 1
            self._item = item
            self._condition.notify()

    def take_newest(self, timeout_s: float) -> Item | None:
        """The newest item, taken out; None when none came in time."""
        with self._condition:
            if self._item is None:
                self._condition.wait(timeout_s)
            item, self._item = self._item, None
            return item


class Heartbeat:
    """Notices that this process did not run for a while: what came meanwhile has waited for an unknown time."""

    def __init__(self) -> None:
        self._lock, self._stop = threading.Lock(), threading.Event()
        self._last_ns, self._held_up = mono_ns(), False
        threading.Thread(target=self._run, name="camera-heartbeat", daemon=True).start()

    def was_held_up(self) -> bool:
        """Whether it was since the last call."""
        self._record_heartbeat()
        with self._lock:
            held_up, self._held_up = self._held_up, False
        return held_up

    def stop(self) -> None:
        """End its thread."""
        self._stop.set()

    def _record_heartbeat(self) -> None:
        with self._lock:
            now_ns = mono_ns()
            self._held_up |= now_ns - self._last_ns > STALL_MIN_NS
            self._last_ns = now_ns

    def _run(self) -> None:
        while not self._stop.wait(HEARTBEAT_PERIOD_S):
            self._record_heartbeat()


class LiveSource(ABC, Generic[Item]):
    """The thread and its state. What a connection is, and how an item becomes a pair, is the subclass's matter."""

    BACK_OFF_S: ClassVar[tuple[float, float]] = (0.5, 8.0)  # first and longest wait before it is asked again
    CLOSE_S: ClassVar[float] = 3.0
    ENDED: ClassVar[str]  # why there are no more pictures, where a connection ends without an error
    EXPECTED: ClassVar[tuple[type[Exception], ...]]  # errors of a connection that need no traceback

    def __init__(self, subject: str, opening: str) -> None:
        self._subject = subject
        self._newest: NewestOnlyBox[Item] = NewestOnlyBox()
        self._stop = threading.Event()
        self._state = f"{subject}: {opening}"
        self._connection = 0
        self._heartbeat = Heartbeat()
        self._thread = threading.Thread(target=self._run, name="camera-reader", daemon=True)

    @property
    def skipped(self) -> int:
        """Pictures replaced by newer ones before they were taken."""
        return self._newest.skipped

    @property
    def state(self) -> str:
        """Empty while pictures arrive."""
        return self._state

    @property
    def ended(self) -> bool:
        """Never: a camera may always come back."""
        return False

    def close(self) -> None:
        """Let go of the camera."""
        self._stop.set()
        self._heartbeat.stop()
        self._thread.join(self.CLOSE_S)

    @abstractmethod
    def _connected(self) -> bool:
        """One connection from its opening to its end, pictures put into the box; whether any came."""

    def _reason(self, error: Exception) -> str:
        """An expected error in words."""
        return f"{self._subject}: {str(error) or type(error).__name__}"

    def _run(self) -> None:
        back_off_s = self.BACK_OFF_S[0]
        while not self._stop.is_set():
            try:
                back_off_s = self.BACK_OFF_S[0] if self._connected() else back_off_s
                reason = f"{self._subject}: {self.ENDED}"
            except self.EXPECTED as error:
                reason = self._reason(error)
            except Exception as error:  # outermost loop of the thread: whatever a camera does, it is asked again
                _log.exception(self._subject)
                reason = f"{self._subject}: {error!r}"
            if self._stop.is_set():
                return
            self._state = f"{reason}; trying again"
            _log.info("%s in %.1f s", self._state, back_off_s)
            self._stop.wait(back_off_s)
            back_off_s = min(2.0 * back_off_s, self.BACK_OFF_S[1])
