"""Playing stored pictures at their own rate."""

import time

from recording.clock import mono_s


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
