"""`longreach bench schedules`: seeded fault schedules in virtual time, with invariants watched in every cycle."""

import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from benchmarks.saved_lines import add_line, open_to_add, whole_lines

FILE = "schedules.jsonl"
_SHARES = ("|qd_ref| / qd_max", "|qdd_ref| / qdd_max", "change of qd_ref / (qdd_max dt)", "step / (qdd_max dt^2)")
_COUNTED = ("virtual_s", "sessions", "starts", "reached", "ended_early", "tails", "servos", "underruns")
Case = dict[str, Any]


def schedules(
    n: Annotated[int, typer.Option(help="how many schedules")] = 10_000,
    seed: Annotated[int, typer.Option(help="first seed")] = 1,
    folder: Annotated[Path, typer.Option(help="where every case is saved; a second run resumes")] = Path(
        "runs/bench-schedules"
    ),
    workers: Annotated[int, typer.Option(min=1, help="processes")] = os.cpu_count() or 1,
) -> None:
    """Run seeded fault schedules through the link and watch every PLC cycle."""
    console = Console(width=200)
    cases = bench(n, seed, folder, console, workers)
    for table in tables_of(cases):
        console.print(table)
    broken = [case for case in cases if case["breaches"]]
    console.print(
        f"schedules with a breach: {len(broken)}; N reached {len(cases)} of {n}, seeds {seed}..{seed + n - 1}"
    )
    if broken or len(cases) < n:
        raise typer.Exit(1)


def bench(n: int, seed: int, folder: Path, console: Console, workers: int = 1) -> list[Case]:
    """Run or resume n schedules from `seed` on; every case is saved as soon as it is there. Ctrl-C ends it early."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / FILE
    wanted = range(seed, seed + n)
    cases = {case["seed"]: case for case in whole_lines(path) if case["seed"] in wanted}
    missing = [number for number in wanted if number not in cases]
    started = time.monotonic()
    try:
        with open_to_add(path) as file, console.status("") as status:
            for case in _run_all(missing, workers):
                add_line(file, case)
                cases[case["seed"]] = case
                status.update(f"{len(cases)} of {n}, {sum(bool(c['breaches']) for c in cases.values())} with a breach")
    except KeyboardInterrupt:
        console.print("ended early; the next run goes on from here")
    console.print(f"{len(missing)} schedules run in {time.monotonic() - started:.0f} s on {workers} processes")
    return [cases[number] for number in sorted(cases)]


def _run_all(seeds: list[int], workers: int) -> Iterable[Case]:
    if workers == 1 or len(seeds) < 2:
        yield from map(run_case, seeds)
        return
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        yield from pool.imap_unordered(run_case, seeds, chunksize=8)


def run_case(seed: int) -> Case:
    """One schedule; an exception anywhere in the two ends is a breach like any other."""
    from benchmarks.link.drill.drill import (  # here: the server's process never loads the simulator
        as_json,
        run_schedule,
    )
    from benchmarks.link.drill.schedule import draw_schedule

    started = time.process_time()
    try:
        case = as_json(run_schedule(draw_schedule(seed)))
    except Exception as error:  # this is a case's outermost loop: what was raised is the finding
        text = f"{type(error).__name__}: {error}"
        case = {"seed": seed, "breaches": [{"name": "exception", "t_s": 0.0, "text": text}]}
    case["cpu_s"] = round(time.process_time() - started, 4)
    return case


def tables_of(cases: list[Case]) -> list[Table]:
    """Breaches, worst shares of the limits, what the network did, what the ends did."""
    return [_breaches(cases), _worst(cases), _network(cases), _ends(cases)]


def _breaches(cases: list[Case]) -> Table:
    seeds: dict[str, list[int]] = {}
    for case in cases:
        for name in sorted({breach["name"] for breach in case["breaches"]}):
            seeds.setdefault(name, []).append(case["seed"])
    table = _table(f"breaches in {len(cases)} schedules", "invariant", "schedules", "first seeds")
    for name, found in sorted(seeds.items()):
        table.add_row(name, str(len(found)), " ".join(map(str, found[:8])))
    return table


def _worst(cases: list[Case]) -> Table:
    worst: dict[str, list[float]] = {}
    for case in cases:
        for motion, row in case.get("worst", {}).items():
            worst[motion] = [max(a, b) for a, b in zip(worst.get(motion, [0.0] * len(row)), row, strict=True)]
    table = _table("largest shares of the limits", "reference", *_SHARES)
    for motion, row in worst.items():
        table.add_row(motion, *(f"{value:.4f}" for value in row))
    return table


def _network(cases: list[Case]) -> Table:
    totals = [Counter[str](), Counter[str]()]
    for case in cases:
        for total, way in zip(totals, ("to_plc", "to_pc"), strict=True):
            total.update(case.get(way, {}))
    table = _table("datagrams", "class", "to the PLC", "to the PC")
    for name in totals[0]:
        table.add_row(name, str(totals[0][name]), str(totals[1][name]))
    return table


def _ends(cases: list[Case]) -> Table:
    totals = Counter[str]()
    for case in cases:
        totals.update({name: case.get(name, 0) for name in _COUNTED})
        totals.update({f"seconds in {name}": value for name, value in case.get("seconds_in", {}).items()})
        totals.update({f"fault {name}": value for name, value in case.get("faults", {}).items()})
        totals["cpu_s"] += case["cpu_s"]
    table = _table("what happened", "what", "total")
    for name, value in totals.items():
        table.add_row(name, f"{value:.0f}")
    for name in ("run_in_silence_ms", "rest_in_silence_ms", "ramp_ms", "ramp_share"):
        longest = max((case["longest"][name] for case in cases if "longest" in case), default=0.0)
        table.add_row(f"longest {name}", f"{longest:.3f}")
    return table


def _table(title: str, *headings: str) -> Table:
    table = Table(title=title, title_justify="left")
    for place, heading in enumerate(headings):
        table.add_column(heading, justify="right" if place else "left")
    return table
