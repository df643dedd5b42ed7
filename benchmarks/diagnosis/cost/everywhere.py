"""A fleet's recordings over one process, over two, and over a Dask cluster of this computer: the same answers?"""

import json
import logging
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.diagnosis.cost.made import write_short

ONE = "one process"
WORKERS = 2


@dataclass(frozen=True, slots=True)
class Way:
    """How long it took [s], and how many answers differ, as JSON, from those of one process."""

    name: str
    recordings: int
    wall_s: float
    differ: int


def written(folder: Path, n: int, seed: int) -> Path:
    """So many short recordings below a folder; those that are there already stay."""
    for number in range(seed, seed + n):
        one = folder / f"{number:05d}"
        if not (one / "run.toml").exists():
            write_short(one, number)
    return folder


def everywhere(recordings: Path, out: Path) -> Iterator[Way]:
    """Each way in turn, from nothing. Raises: RuntimeError: `longreach diagnose-fleet` failed."""
    own, wall_s = _run(recordings, out / "one", "--workers", "1")
    yield Way(ONE, len(own), wall_s, 0)
    told, wall_s = _run(recordings, out / "two", "--workers", str(WORKERS))
    yield Way(f"{WORKERS} processes", len(told), wall_s, _differing(own, told))
    with _cluster() as address:
        if address is None:
            return
        told, wall_s = _run(recordings, out / "dask", "--dask", address)
        yield Way(f"Dask, {WORKERS} workers", len(told), wall_s, _differing(own, told))


def _run(recordings: Path, out: Path, *how: str) -> tuple[list[str], float]:
    """What was told of each recording, as JSON, and the seconds it took."""
    answers = out / "answers"
    for one in answers.glob("*.json"):
        one.unlink()
    began_s = time.monotonic()
    command = [
        sys.executable,
        "-P",
        "-m",
        "longreach.cli",
        "diagnose-fleet",
        str(recordings),
        "--out",
        str(out),
        *how,
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"longreach diagnose-fleet {' '.join(how)} ended with {done.returncode}: {done.stderr}")
    wall_s = time.monotonic() - began_s
    told = json.loads((out / "fleet.json").read_text(encoding="utf-8"))
    return [json.dumps(one) for one in told], wall_s


def _differing(own: list[str], other: list[str]) -> int:
    return sum(a != b for a, b in zip(own, other, strict=True))


@contextmanager
def _cluster() -> Iterator[str | None]:
    """A scheduler and workers in processes of their own; None where Dask is not installed."""
    try:
        from distributed import LocalCluster
    except ImportError:
        yield None
        return
    logging.getLogger("distributed").setLevel(logging.ERROR)
    without: Any = None  # a dashboard; the parameter is annotated otherwise than documented
    made: Any = LocalCluster(n_workers=WORKERS, threads_per_worker=1, processes=True, dashboard_address=without)
    with made as cluster:
        yield cluster.scheduler_address
