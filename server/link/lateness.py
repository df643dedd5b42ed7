"""How late the link sends, over the last twenty seconds."""

from collections import deque
from dataclasses import dataclass, field

_WINDOW = 1000


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
