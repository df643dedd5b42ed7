"""`longreach diagnose` in a process of its own, and what that took."""

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Used:
    """Wall and CPU time [s], and a process' largest memory [MB]."""

    wall_s: float
    cpu_s: float
    peak_mb: float


def diagnosed_in_a_child(recording: Path, answer: Path, niceness: int = 0) -> Used:
    """Write the answer to this recording. Raises: RuntimeError: the command failed; with what it said."""
    command = [sys.executable, "-P", "-m", "longreach.cli", "diagnose", str(recording), "--json", str(answer)]
    began_s = time.monotonic()
    with tempfile.TemporaryFile("w+", encoding="utf-8") as said:
        child = subprocess.Popen(command, stdout=said, stderr=said, preexec_fn=lambda: os.nice(niceness))
        _, status, used = os.wait4(child.pid, 0)
        wall_s = time.monotonic() - began_s
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode:
            said.seek(0)
            raise RuntimeError(f"longreach diagnose {recording} ended with {child.returncode}: {said.read()}")
    return Used(wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 / 1e6)
