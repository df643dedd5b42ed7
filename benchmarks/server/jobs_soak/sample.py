"""What the server's processes hold at one moment (Linux), and the growth of it over many."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import theilslopes

from benchmarks.kills.victims import children_of, holder_of_udp_port

MIB = 1024.0**2
SAMPLES_MIN = 5


@dataclass(frozen=True, slots=True)
class Sample:
    """Of one process."""

    name: str
    pid: int
    rss_bytes: int
    files: int
    threads: int


@dataclass(frozen=True, slots=True)
class Growth:
    """Median of all pairwise slopes with its 95 % interval, and where it stood first and last."""

    name: str
    n: int
    per_hour: float
    low: float
    high: float
    first: float
    last: float


def samples_of(server_pid: int, link_udp_port: int) -> list[Sample]:
    """The server's main process, its link (which holds the UDP port) and vision (the child with the most memory)."""
    link = holder_of_udp_port(link_udp_port, server_pid)
    others = [pid for pid in children_of(server_pid) if pid != link]
    vision = max(others, key=_rss_bytes, default=None)
    named = {"server": server_pid, "link": link, "vision": vision}
    return [_sample(name, pid) for name, pid in named.items() if pid is not None]


def _sample(name: str, pid: int) -> Sample:
    proc = Path("/proc") / str(pid)
    try:
        return Sample(name, pid, _rss_bytes(pid), len(os.listdir(proc / "fd")), len(os.listdir(proc / "task")))
    except OSError:  # it has just ended
        return Sample(name, pid, 0, 0, 0)


def _rss_bytes(pid: int) -> int:
    try:
        fields = (Path("/proc") / str(pid) / "statm").read_text(encoding="ascii").split()
    except OSError:
        return 0
    return int(fields[1]) * os.sysconf("SC_PAGE_SIZE")


def growth_of(name: str, t_s: Sequence[float], values: Sequence[float]) -> Growth | None:
    """Growth per hour; None with too few samples."""
    if len(values) < SAMPLES_MIN:
        return None
    hours = np.asarray(t_s, float) / 3600.0
    slope, _, low, high = (float(value) for value in np.asarray(theilslopes(np.asarray(values, float), hours, 0.95)))
    return Growth(name, len(values), slope, low, high, float(values[0]), float(values[-1]))
