"""`longreach bench links`."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from benchmarks.diagnosis.links.cases import KINDS
from benchmarks.diagnosis.links.run import Outcome, run_case
from benchmarks.reproduce.summary import share
from benchmarks.saved_lines import Line, run_saved

console = Console(width=150)
HEADINGS = ("case", "N", "exact", "95 %", "refused", "something false", "sizes within their limits")


def links(
    n: Annotated[int, typer.Option(help="recordings; every fourth healthy, lossy, late, with a fault")] = 100,
    seed: Annotated[int, typer.Option(help="first seed")] = 1,
    folder: Annotated[Path, typer.Option(help="where every case is saved; a second run resumes")] = Path(
        "runs/bench-links"
    ),
) -> None:
    """Six joints behind links that jitter, drift, lose and delay, logged every 1 to 10 ms: is only the fault named?"""
    lines = run_saved(folder / "links.jsonl", range(seed, seed + n), _told, console, "recordings")
    tell([Outcome(**{name: value for name, value in line.items() if name != "key"}) for line in lines])


def _told(seed: int) -> Line:
    """One case, told as soon as it is there."""
    one = run_case(seed)
    result = "exact" if one.exact else f"{one.verdict}: {one.told} for {one.true}"
    console.print(f"seed {seed}, {one.kind}: {result}")
    return asdict(one)


def tell(outcomes: list[Outcome]) -> None:
    """One row a kind of case."""
    table = Table(title=f"Told behind a real link (N = {len(outcomes)})", title_justify="left")
    for heading in HEADINGS:
        table.add_column(heading)
    for kind in KINDS:
        some = [one for one in outcomes if one.kind == kind]
        if not some:
            continue
        got = share([one.exact for one in some])
        table.add_row(
            kind,
            str(len(some)),
            f"{got.k} of {got.n}",
            f"{100 * got.low:.0f} to {100 * got.high:.0f} %",
            str(sum(one.refused for one in some)),
            str(sum(one.false for one in some)),
            f"{sum(one.sizes_held for one in some)} of {sum(one.sizes_told for one in some)}",
        )
    console.print(table)
