"""`longreach bench hold`."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from benchmarks.saved_lines import add_line, open_to_add, whole_lines
from benchmarks.server.headless import headless
from benchmarks.server.hold.drill import JOG_WAYS, LIMIT_MS, WAYS, HoldCase, HoldDrill, JogDrill

console = Console(width=160)
RETRIES = 3


def hold(
    n: Annotated[int, typer.Option(help="presses ended in each of the five ways, jogs in four")] = 100,
    seed: Annotated[int, typer.Option(help="draws the moments")] = 1,
    folder: Annotated[Path, typer.Option(help="where every case is saved; a second run resumes")] = Path(
        "runs/bench-hold"
    ),
    chromium: Annotated[str, typer.Option(help="the browser")] = "/usr/bin/chromium",
    jog: Annotated[bool, typer.Option("--jog", help="hold the jog buttons, not the steps")] = False,
) -> None:
    """Hold-to-run in a real browser: time from letting go to the ramp in the PLC's states."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"cases-{'jog-' if jog else ''}{seed}.jsonl"
    cases = saved(file)
    wanted = [(way, number) for number in range(n) for way in (JOG_WAYS if jog else WAYS) if (way, number) not in cases]
    if wanted:
        with headless(chromium) as browser, (JogDrill if jog else HoldDrill)(folder / "stack", browser) as drill:
            for way, number in wanted:
                cases[way, number] = _tried(drill, way, number, seed)
                _save(file, cases[way, number])
    console.print(summary([case for case in cases.values() if case.number < n]))


def _tried(drill: HoldDrill, way: str, number: int, seed: int) -> HoldCase:
    """A computer that is too busy may end the move before the button is let go: tried again, and told."""
    for attempt in range(RETRIES):
        try:
            case = drill.case(way, number, seed)
        except Exception as error:  # playwright's errors are of a package that need not be installed
            console.print(f"{way} {number}, attempt {attempt + 1}: {str(error).splitlines()[0]} {drill.told()}")
            drill.forget_page()
            continue
        console.print(f"{way} {number}: {case.delay_ms:.1f} ms ({case.reason})", highlight=False)
        return case
    raise typer.Exit(1)


def saved(file: Path) -> dict[tuple[str, int], HoldCase]:
    """The cases of earlier runs."""
    found = whole_lines(file, lambda text: HoldCase(**json.loads(text)))
    return {(case.way, case.number): case for case in found}


def _save(path: Path, case: HoldCase) -> None:
    with open_to_add(path) as file:
        add_line(file, asdict(case))


def summary(cases: list[HoldCase]) -> Table:
    """One row a way."""
    table = Table(title="from letting go to the first PLC state that shows the ramp, ms", title_justify="left")
    for heading in ("way", "N", "p50", "p99", "max", "limit", "over it", "moved again", "clock +-"):
        table.add_column(heading)
    for way in WAYS:
        mine = [case for case in cases if case.way == way]
        if not mine:
            continue
        delays = np.array([case.delay_ms for case in mine])
        table.add_row(
            way,
            str(len(mine)),
            f"{np.median(delays):.0f}",
            f"{np.percentile(delays, 99):.0f}",
            f"{delays.max():.0f}",
            f"{LIMIT_MS[way]:.0f}",
            str(int((delays > LIMIT_MS[way]).sum())),
            str(sum(case.moved_again for case in mine)),
            f"{max(case.clock_error_ms for case in mine):.1f}",
        )
    return table
