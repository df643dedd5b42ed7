"""When to expose and when to hand over: the grid of exposures, the rate it can hold, true time on the PC's clock."""

from collections import deque
from dataclasses import dataclass
from statistics import median

_WINDOW = 15  # pictures over which the work per picture is judged
_LOAD_MAX = 0.85  # share of the period that one picture's work may take
_RAISE_RATIO = 1.2  # the rate rises again only when it may rise by this much


class RateGovernor:
    """Lowers the rate when pictures take too long and raises it again when they do not."""

    def __init__(self, wanted_hz: float) -> None:
        self.wanted_hz = wanted_hz
        self.rate_hz = wanted_hz
        self.busy_s = 0.0  # median work per picture of the last full window
        self._busy_s: deque[float] = deque(maxlen=_WINDOW)

    @property
    def reduced(self) -> bool:
        """Whether the rate is below the wanted one."""
        return self.rate_hz < self.wanted_hz

    def worked(self, busy_s: float) -> bool:
        """Account for one picture; returns whether the rate has changed."""
        self._busy_s.append(busy_s)
        if len(self._busy_s) < _WINDOW:
            return False
        self.busy_s = median(self._busy_s)
        possible_hz = min(self.wanted_hz, _LOAD_MAX / max(self.busy_s, 1e-6))
        if self.rate_hz <= possible_hz < min(_RAISE_RATIO * self.rate_hz, self.wanted_hz):
            return False
        changed = possible_hz != self.rate_hz
        if changed:
            self.rate_hz = possible_hz
            self._busy_s.clear()
        return changed


@dataclass(slots=True)
class ExposureGrid:
    """Mid-exposure times [ns, true time], evenly spaced; those that cannot be met any more are skipped and counted."""

    t_next_ns: int
    rate_hz: float
    skipped: int = 0

    def take(self, t_now_ns: int) -> int:
        """The next exposure: the earliest on the grid that is not more than one period old."""
        period_ns = round(1e9 / self.rate_hz)
        late = max(0, (t_now_ns - self.t_next_ns) // period_ns)
        self.skipped += late
        t_mid_ns = self.t_next_ns + late * period_ns
        self.t_next_ns = t_mid_ns + period_ns
        return t_mid_ns


class TrueClock:
    """True time on this process' monotonic clock, from the newest pose's time; the least delayed reading counts."""

    def __init__(self) -> None:
        self._offset_ns: int | None = None

    def saw(self, t_true_ns: int, t_mono_ns: int) -> None:
        """The newest pose known at `t_mono_ns` is of `t_true_ns`."""
        offset_ns = t_true_ns - t_mono_ns
        self._offset_ns = offset_ns if self._offset_ns is None else max(self._offset_ns, offset_ns)

    def mono_ns(self, t_true_ns: int) -> int:
        """The monotonic time of a true time.

        Raises: RuntimeError before the first reading.
        """
        if self._offset_ns is None:
            raise RuntimeError("true clock: no pose has been seen yet; call saw() first")
        return t_true_ns - self._offset_ns
