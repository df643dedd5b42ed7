"""The PC's clock: every `t_mono_ns`, in every process, and every age that decides about motion is read here.

It counts the time in which this computer was suspended. Linux's CLOCK_MONOTONIC, which `time.monotonic` and the timers
of asyncio read, stands still meanwhile: after a night's sleep a look of the evening would be seconds old.
"""

import sys
import time

_COUNTS_SUSPEND = {"linux": "CLOCK_BOOTTIME", "darwin": "CLOCK_MONOTONIC"}  # others: time.monotonic, the best there is
_CLOCK: int | None = getattr(time, _COUNTS_SUSPEND.get(sys.platform, ""), None)
_ROUNDED_NS = 1_000  # both clocks are computed from one counter, each rounded; a suspend lasts milliseconds at least
_READINGS = 3


def mono_ns() -> int:
    """Now [ns]."""
    return time.monotonic_ns() if _CLOCK is None else time.clock_gettime_ns(_CLOCK)


def mono_s() -> float:
    """Now [s]."""
    return mono_ns() * 1e-9


def suspended_ns() -> int:
    """How long this computer has been suspended since it started [ns]: what to add to a CLOCK_MONOTONIC stamp."""
    least_ns, most_ns = min(
        (_suspended_time_bounds_ns() for _ in range(_READINGS)), key=lambda bounds: bounds[1] - bounds[0]
    )
    return (least_ns + most_ns) // 2


SUSPENDED_REASON = "this computer was suspended; acquire control, look and plan again"


class SuspendWatch:
    """Reports each resume of this computer once. Only Linux can be asked; elsewhere it reports nothing."""

    def __init__(self) -> None:
        self._most_ns = _suspended_time_bounds_ns()[1]

    def was_suspended(self) -> bool:
        """Whether this computer was suspended since the last call."""
        least_ns, most_ns = _suspended_time_bounds_ns()
        if least_ns > self._most_ns + _ROUNDED_NS:
            self._most_ns = most_ns
            return True
        self._most_ns = min(self._most_ns, most_ns)
        return False


def _suspended_time_bounds_ns() -> tuple[int, int]:
    """Bounds of the suspended time [ns]: however long this process is held up between readings, it lies within."""
    if sys.platform != "linux":
        return 0, 0
    before_ns = time.monotonic_ns()
    now_ns = mono_ns()
    return now_ns - time.monotonic_ns(), now_ns - before_ns
