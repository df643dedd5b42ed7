"""One `longreach diagnose` in a process of its own: what it took, and what it told."""

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from longreach.bench_diagnosis.made import Size


@dataclass(frozen=True, slots=True)
class Timed:
    """Wall and CPU time [s], a process' largest memory [MB], and whether both faults were told and nothing else."""

    joints: int
    wall_s: float
    cpu_s: float
    peak_mb: float
    exact: bool


def timed(size: Size, recording: Path) -> Timed:
    """Diagnose this recording. Raises: RuntimeError: the command failed."""
    answer = recording / "answer.json"
    command = [sys.executable, "-m", "longreach.cli", "diagnose", str(recording), "--json", str(answer)]
    began_s = time.monotonic()
    with (recording / "said.txt").open("w+", encoding="utf-8") as said:
        child = subprocess.Popen(command, stdout=said, stderr=said)
        _, status, used = os.wait4(child.pid, 0)
        wall_s = time.monotonic() - began_s
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode:
            said.seek(0)
            raise RuntimeError(f"longreach diagnose {recording} ended with {child.returncode}: {said.read()}")
    told = json.loads(answer.read_text(encoding="utf-8"))
    named = {(one["name"], one["joint"]) for one in told["hypotheses"][0]["effects"]} if told["hypotheses"] else set()
    exact = told["verdict"] == "effects" and named == {(one.name, one.joint) for one in size.effects}
    return Timed(size.joints, wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 / 1e6, exact)
