"""`longreach bench experiments`."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from benchmarks.diagnosis.experiments.cases import PAIRS
from benchmarks.diagnosis.experiments.run import Outcome, run_case
from benchmarks.reproduce.summary import share
from benchmarks.saved_lines import open_to_add, whole_lines

console = Console(width=150)
HEADINGS = ("pair", "ambiguous", "separated", "95 %", "nothing beside it", "nothing proposed", "clear at once")
DRAWS_MAX = 3  # draws per wanted case: some first recordings are not ambiguous, and count apart


def experiments(
    n: Annotated[int, typer.Option(help="ambiguous cases of each pair")] = 50,
    seed: Annotated[int, typer.Option(help="first seed")] = 1,
    only: Annotated[str, typer.Option(help="pairs by name, comma between them; empty: all")] = "",
    folder: Annotated[Path, typer.Option(help="where every case is saved; a second run resumes")] = Path(
        "runs/bench-experiments"
    ),
) -> None:
    """Ambiguous recording, proposed experiment, executed, both diagnosed together: is the true effect sure then?"""
    wanted = [name.strip() for name in only.split(",") if name.strip()] or list(PAIRS)
    unknown = set(wanted) - set(PAIRS)
    if unknown:
        raise typer.BadParameter(f"no pair {sorted(unknown)}; there are: {', '.join(PAIRS)}")
    folder.mkdir(parents=True, exist_ok=True)
    found: dict[str, list[Outcome]] = {}
    for pair in wanted:
        found[pair] = _run_pair(pair, n, seed, folder / f"{pair}.jsonl")
    tell(found)


def _run_pair(pair: str, n: int, seed: int, file: Path) -> list[Outcome]:
    """Cases of a pair until n are ambiguous, those on file read back."""
    known = {one.seed: one for one in whole_lines(file, lambda text: Outcome(**json.loads(text)))}
    out: list[Outcome] = []
    with open_to_add(file) as lines:
        for number in range(seed, seed + DRAWS_MAX * n):
            if sum(one.ambiguous for one in out) == n:
                break
            one = known.get(number)
            if one is None:
                one = run_case(pair, number)
                lines.write(one.to_line() + "\n")
                lines.flush()
                told = f"P {one.apart_first:.3f} -> {one.apart_both:.3f}"
                console.print(f"{pair} {number}: {one.truth}, {one.what}: {told}")
            out.append(one)
    return out


def tell(found: dict[str, list[Outcome]]) -> None:
    """One row a pair."""
    title = "True effect told from its rivals with P > 0.95 by the proposed experiment (wanted: >= 90 %)"
    table = Table(title=title, title_justify="left")
    for heading in HEADINGS:
        table.add_column(heading)
    for pair, outcomes in found.items():
        told = [one for one in outcomes if one.ambiguous]
        got = share([one.separated for one in told]) if told else None
        table.add_row(
            pair,
            str(len(told)),
            f"{got.k} of {got.n}" if got else "-",
            f"{100 * got.low:.0f} to {100 * got.high:.0f} %" if got else "-",
            str(sum(one.alone for one in told)),
            str(sum(one.what is None for one in told)),
            str(len(outcomes) - len(told)),
        )
    console.print(table)
