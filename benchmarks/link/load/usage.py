"""What processes cost and how they are scheduled (Linux)."""

import os
from pathlib import Path

_TICKS_S = os.sysconf("SC_CLK_TCK")
_POLICIES = {os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_RR: "SCHED_RR"}


def cpu_s(pid: int) -> float:
    """CPU time of a process so far, all its threads [s]; 0 when it is gone."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    except OSError:
        return 0.0
    fields = text.rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS_S


def major_faults(pid: int) -> int:
    """Page faults of a process that had to read from disk; 0 when it is gone."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    except OSError:
        return 0
    return int(text.rpartition(")")[2].split()[9])


def policy(pid: int) -> str:
    """Scheduling policy with its priority or nice value."""
    try:
        kind = os.sched_getscheduler(pid) & ~os.SCHED_RESET_ON_FORK
        name = _POLICIES.get(kind, f"policy {kind}")
        if kind in (os.SCHED_FIFO, os.SCHED_RR):
            return f"{name} {os.sched_getparam(pid).sched_priority}"
        return f"{name} nice {os.getpriority(os.PRIO_PROCESS, pid)}"
    except OSError:
        return "gone"
