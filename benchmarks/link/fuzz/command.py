"""`longreach bench fuzz`: random, mutated and replayed datagrams into both ends of the link, judged by oracles.

Every chunk is saved, so a second run goes on where the first one ended; a chunk comes out the same every time.
"""

import json
import os
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from benchmarks.link.fuzz.counts import FuzzCounts, counts_from_json
from benchmarks.link.fuzz.engine import ENDS, End, fuzz_chunk
from benchmarks.same_options import require_same_options, text_mark
from recording.files import write_durably
from server.settings import read_machine, read_machine_text

_CHUNK = 10_000
_LANES = 2  # per end: as many chunks of it can run at once
_KEPT = 600  # inputs that a chunk begins with


@dataclass(frozen=True, slots=True)
class Lane:
    """A row of chunks, each of which begins with what the ones before have found."""

    end: End
    number: int
    seed: int
    folder: Path

    def chunk_file(self, chunk: int) -> Path:
        """Where a chunk is saved."""
        return self.folder / f"seed{self.seed}-{self.end}-{self.number}-{chunk:04d}.json"

    def saved(self) -> Iterator[tuple[FuzzCounts, list[bytes]]]:
        """The chunks that there are, in order."""
        chunk = 0
        while self.chunk_file(chunk).is_file():
            data = json.loads(self.chunk_file(chunk).read_text(encoding="utf-8"))
            yield counts_from_json(data["counts"]), [bytes.fromhex(text) for text in data["found"]]
            chunk += 1

    def save(self, chunk: int, counts: FuzzCounts, found: list[bytes]) -> None:
        """Save a chunk whole or not at all."""
        file = self.chunk_file(chunk)
        data = {"counts": counts.as_json(), "found": [payload.hex() for payload in found]}
        write_durably(file, json.dumps(data))


def run_lane(lane: Lane, n: int, machine_name: str) -> Lane:
    """Go on with a lane until it has n datagrams."""
    machine = read_machine(machine_name)
    total, kept = FuzzCounts(lane.end), list[bytes]()
    chunk = 0
    for counts, found in lane.saved():
        total.add(counts)
        kept += found
        chunk += 1
    while total.n < n:
        started = time.perf_counter()
        signatures = frozenset(total.signatures)
        name = f"{lane.seed}/{lane.end}/{lane.number}/{chunk}"
        counts, found = fuzz_chunk(lane.end, machine, name, min(_CHUNK, n - total.n), kept[-_KEPT:], signatures)
        counts.seconds = time.perf_counter() - started
        lane.save(chunk, counts, found)
        total.add(counts)
        kept += found
        chunk += 1
    return lane


def _total(end: End, lanes: list[Lane]) -> FuzzCounts:
    total = FuzzCounts(end)
    for lane in lanes:
        if lane.end == end:
            for counts, _ in lane.saved():
                total.add(counts)
    return total


def bench_fuzz(n: int, seed: int, folder: Path, machine_name: str, console: Console) -> list[FuzzCounts]:
    """Fuzz both ends with n datagrams each on all cores; what both have seen."""
    folder.mkdir(parents=True, exist_ok=True)
    lanes = [Lane(end, number, seed, folder) for number in range(_LANES) for end in ENDS]
    with ProcessPoolExecutor(max_workers=max(os.cpu_count() or 1, 1)) as pool:
        jobs = [pool.submit(run_lane, lane, -(-n // _LANES), machine_name) for lane in lanes]
        for job in as_completed(jobs):
            lane = job.result()
            console.print(f"lane {lane.number} of the {lane.end} end is done")
    return [_total(end, lanes) for end in ENDS]


def report(totals: list[FuzzCounts]) -> Table:
    """Both ends side by side."""
    table = Table(title="Fuzzing of both ends", title_justify="left")
    table.add_column("")
    for total in totals:
        table.add_column(f"{total.end} end", justify="right")
    rows = (
        ("N reached", [f"{t.n:,}" for t in totals]),
        ("sealed again (CRC, tag)", [f"{t.sealed:,} ({t.sealed / max(t.n, 1):.0%})" for t in totals]),
        ("taken / silent / refused", [f"{t.taken:,} / {t.silent:,} / {t.refused:,}" for t in totals]),
        ("own datagrams judged", [f"{t.emitted:,}" for t in totals]),
        ("reject codes seen", [str(len(t.codes)) for t in totals]),
        ("signatures", [str(len(t.signatures)) for t in totals]),
        ("lines met in the traced sample", [str(len(t.lines)) for t in totals]),
        ("exceptions", [str(t.exceptions) for t in totals]),
        ("violations", [str(t.violations) for t in totals]),
        ("datagrams/s and core", [f"{t.n / max(t.seconds, 1e-9):,.0f}" for t in totals]),
    )
    for name, cells in rows:
        table.add_row(name, *cells)
    return table


def fuzz(
    n: Annotated[int, typer.Option(help="datagrams into each end")] = 1_000_000,
    seed: Annotated[int, typer.Option(help="seed")] = 1,
    folder: Annotated[Path, typer.Option(help="where every chunk is saved; a second run resumes")] = Path("runs/fuzz"),
    machine: Annotated[str, typer.Option(help="machine file or name")] = "hiab033",
) -> None:
    """Fuzz both ends of the PLC link; exit code 1 if a rule was broken."""
    console = Console(width=160)
    require_same_options(folder, machine=text_mark(read_machine_text(machine)))
    totals = bench_fuzz(n, seed, folder, machine, console)
    console.print(report(totals))
    for total in totals:
        for heading, counter in (("met", total.situations), ("made of", total.sources), ("refused for", total.codes)):
            console.print(f"{total.end} {heading}: {', '.join(f'{k} {v:,}' for k, v in counter.most_common())}")
        for text in total.evidence:
            console.print(f"[bold red]{text}", soft_wrap=True)
    if any(total.violations or total.exceptions for total in totals):
        raise typer.Exit(1)
