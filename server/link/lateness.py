"""How late the link sends, over the last twenty seconds."""

import os
import threading
from collections import deque
from dataclasses import dataclass, field
from multiprocessing.connection import Connection

from server.link.contracts import HealthReport, LinkReport, PlcSample, SamplesReport

_WINDOW = 1000


# A deadline that the server keeps moving on while motion may go on; missed, motion stops whatever the server does.


@dataclass(slots=True)
class Deadline:
    """At most one at a time. Once missed, nothing may begin until it is set again. `missed_text`: why it stopped."""

    missed_text: str
    missed: bool = False
    _until_ns: int | None = None

    def set(self, until_ns: int | None) -> None:
        """Let motion go on until then [monotonic ns]; None: nothing needs to be proven any more."""
        self._until_ns, self.missed = until_ns, False

    def just_missed(self, now_ns: int) -> bool:
        """Whether it has passed since it was asked last."""
        if self._until_ns is None or now_ns <= self._until_ns:
            return False
        self._until_ns, self.missed = None, True
        return True


# Ask the system to run this process before others.

_FIFO_PRIORITY = 50
_NICE = -15


def raise_priority() -> str:
    """Real-time scheduling if allowed, else a better nice value; the text says what is missing, empty if nothing is."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_FIFO_PRIORITY))
    except (OSError, AttributeError):
        pass
    else:
        return ""
    try:
        os.setpriority(os.PRIO_PROCESS, 0, _NICE)
    except (OSError, AttributeError):
        return "link runs at normal priority (no SCHED_FIFO, no nice): under load sends may be late; grant CAP_SYS_NICE"
    return f"link runs at nice {_NICE} instead of SCHED_FIFO: under load sends may be late; grant rtprio"


@dataclass(frozen=True, slots=True)
class LatenessFigures:
    """Percentiles of the last 1000 sends and the maximum since start [us]."""

    p50_us: float = 0.0
    p99_us: float = 0.0
    max_us: float = 0.0


@dataclass(slots=True)
class Lateness:
    """Send times against their deadlines."""

    _recent_us: deque[float] = field(default_factory=lambda: deque(maxlen=_WINDOW))
    _max_us: float = 0.0

    def add(self, late_ns: int) -> None:
        """One send that was `late_ns` behind its deadline."""
        late_us = late_ns / 1000
        self._recent_us.append(late_us)
        self._max_us = max(self._max_us, late_us)

    def figures(self) -> LatenessFigures:
        """The present figures; sorts the window, so not for every send."""
        if not self._recent_us:
            return LatenessFigures()
        ordered = sorted(self._recent_us)
        n = len(ordered)
        return LatenessFigures(ordered[n // 2], ordered[min(n - 1, n * 99 // 100)], self._max_us)


# Reports on their way to the server: a thread writes the pipe, so that a busy server never holds up the link.

_SAMPLES_MAX = 3000  # half a minute of a stalled server


class Outbox:
    """What waits while the server does not read: the newest samples (others are dropped, counted), of health reports
    in a row the newest one, and every other report: each answers a request of the server, which sends none then.
    """

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._lock = threading.Condition()
        self._samples: deque[PlcSample] = deque()
        self._reports: deque[LinkReport] = deque()
        self._dropped = 0
        self.broken = False
        threading.Thread(target=self._work, name="link-outbox", daemon=True).start()

    def add_sample(self, sample: PlcSample) -> None:
        """Queue a sample; `flush` sends what has gathered."""
        with self._lock:
            if len(self._samples) >= _SAMPLES_MAX:
                self._samples.popleft()
                self._dropped += 1
            self._samples.append(sample)

    def report(self, report: LinkReport) -> None:
        """Send a report, after the samples that came before it."""
        with self._lock:
            if isinstance(report, HealthReport) and self._reports and isinstance(self._reports[-1], HealthReport):
                self._reports.pop()
            self._reports.append(report)
            self._lock.notify()

    def flush(self) -> None:
        """Send the gathered samples."""
        with self._lock:
            self._lock.notify()

    def _take(self) -> list[LinkReport]:
        with self._lock:
            while not self._samples and not self._reports:
                self._lock.wait()
            taken: list[LinkReport] = []
            if self._samples:
                taken.append(SamplesReport(tuple(self._samples), self._dropped))
            taken += self._reports
            self._samples.clear()
            self._reports.clear()
            return taken

    def _work(self) -> None:
        try:
            while True:
                for report in self._take():
                    self._pipe.send(report)
        except (OSError, ValueError):  # the server is gone, or the pipe was closed on leaving
            self.broken = True
