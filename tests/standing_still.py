"""Whether this computer stood still: a second process sleeps 10 ms at a time and notes when it woke far too late.

A virtual machine that its host stops for 300 ms stops everything in it: every watchdog of the link trips, as it should.
A test of real processes that fails in such a moment has shown nothing, and is run again.
"""

import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

STOOD_S = 0.1  # the link's shortest watchdog
_WATCH = """
import sys, time
last = time.monotonic()
while True:
    time.sleep(0.01)
    now = time.monotonic()
    if now - last > float(sys.argv[1]):
        print(last, now, flush=True)
    last = now
"""


def longest_s(noted: Iterable[str], since_s: float) -> float:
    """The longest standstill [s] that ended after a moment of the monotonic clock; 0 where there was none.

    Args: noted: lines of two moments each [s]; a last one that is half written does not count.
    """
    moments = [line.split() for line in noted]
    return max(
        (float(b) - float(a) for a, b in (m for m in moments if len(m) == 2) if float(b) >= since_s), default=0.0
    )


class StandstillWatch:
    """The second process and what it has noted."""

    def __init__(self) -> None:
        with tempfile.NamedTemporaryFile("w", prefix="standstills-", delete=False) as out:
            self._notes = Path(out.name)
            self._process = subprocess.Popen([sys.executable, "-S", "-c", _WATCH, str(STOOD_S)], stdout=out)

    def longest_s(self, since_s: float) -> float:
        """The longest standstill since a moment of the monotonic clock [s]."""
        return longest_s(self._notes.read_text().splitlines(), since_s)

    def pid_signal(self, number: int) -> None:
        """Stop the second process, or let it go on: a standstill of its own."""
        self._process.send_signal(number)

    def close(self) -> None:
        """End the process, delete its notes."""
        self._process.kill()
        self._process.wait()
        self._notes.unlink(missing_ok=True)
