"""How late the link sends, over the last twenty seconds."""

import os
from collections import deque
from dataclasses import dataclass, field

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
