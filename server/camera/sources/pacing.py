"""Playing stored pictures at their own rate."""

import time


class Pacing:
    """Says when the next picture is due; a late reader is not made to catch up."""

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1.0 / rate_hz
        self._due_s: float | None = None

    def wait(self, timeout_s: float) -> bool:
        """Sleep until the next picture is due, at most the timeout; whether it is due."""
        now_s = time.monotonic()
        due_s = now_s if self._due_s is None else self._due_s
        if due_s - now_s > timeout_s:
            time.sleep(timeout_s)
            return False
        time.sleep(max(0.0, due_s - now_s))
        self._due_s = max(due_s, now_s) + self._period_s
        return True
