"""`longreach bench diagnosis`."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from benchmarks.diagnosis.cost.everywhere import everywhere, written
from benchmarks.diagnosis.cost.made import LONG, LONG_S, Size
from benchmarks.diagnosis.cost.timed import Timed, timed
from benchmarks.saved_lines import Line, run_saved

console = Console(width=120)
SIZES = (6, 1)


def diagnosis(
    n: Annotated[int, typer.Option(min=0, help="recordings of each number of joints")] = 1,
    fleet: Annotated[int, typer.Option(min=0, help="short recordings, diagnosed over processes and Dask, too")] = 0,
    seed: Annotated[int, typer.Option(help="first seed")] = 1,
    folder: Annotated[Path, typer.Option(help="where every case is saved; a second run resumes")] = Path(
        "runs/bench-diagnosis"
    ),
) -> None:
    """Time and memory of a diagnosis of eight minutes, six joints and one; a fleet's answers, however made."""
    keys = [f"{joints}-{one}" for joints in SIZES for one in range(seed, seed + n)]
    lines = run_saved(folder / "timed.jsonl", keys, lambda key: _timed(folder, key), console, "diagnoses")
    if lines:
        console.print(timed_table([Timed(**{k: v for k, v in one.items() if k != "key"}) for one in lines]))
    if fleet:
        _fleet(folder, fleet, seed)


def _timed(folder: Path, key: str) -> Line:
    joints, seed = map(int, key.split("-"))
    recording, size = folder / f"joints-{key}", Size(joints)
    size.write(recording, seed)
    return asdict(timed(size, recording))


def timed_table(lines: list[Timed]) -> Table:
    """One row a number of joints: the slowest and the largest of its diagnoses."""
    title = f"Diagnosis of {len(LONG)} segments of {LONG_S:.0f} s with two faults, the whole catalogue, all pairs"
    table = _table(title, "joints", "N", "wall, slowest", "processor", "memory", "both named, nothing else")
    for joints in SIZES:
        some = [one for one in lines if one.joints == joints]
        worst = max(some, key=lambda one: one.wall_s)
        table.add_row(
            str(joints),
            str(len(some)),
            f"{worst.wall_s:.1f} s",
            f"{worst.cpu_s:.1f} s",
            f"{max(one.peak_mb for one in some):.0f} MB",
            f"{sum(one.exact for one in some)} of {len(some)}",
        )
    return table


def _fleet(folder: Path, n: int, seed: int) -> None:
    recordings = written(folder / f"fleet-{seed}-{n}", n, seed)
    table = _table("The same recordings, whoever computes", "over", "N", "wall", "answers that differ")
    with console.status("diagnosing a fleet, each way in turn"):
        for way in everywhere(recordings, folder / "fleet-answers"):
            table.add_row(way.name, str(way.recordings), f"{way.wall_s:.0f} s", str(way.differ))
    console.print(table)


def _table(title: str, *headings: str) -> Table:
    table = Table(title=title, title_justify="left")
    for heading in headings:
        table.add_column(heading)
    return table
