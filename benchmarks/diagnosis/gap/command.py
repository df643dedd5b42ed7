"""`longreach bench gap`: the blind benchmark, for hours in the background; every case saved, a second run resumes."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from benchmarks.diagnosis.gap import figures
from benchmarks.diagnosis.gap.runner import PLANTS, Campaign, CampaignError, pack, run_campaign, scores
from benchmarks.positioning.machines.command import share_text

console = Console(width=170)


def gap(
    n: Annotated[int, typer.Option(help="cases")] = 600,
    seed: Annotated[int, typer.Option(help="of the campaign; judgement seeds are 100 and above")] = 100,
    plant: Annotated[str, typer.Option(help="own, or foreign (needs Exudyn)")] = "own",
    first: Annotated[int, typer.Option(help="number of the first case")] = 0,
    factor: Annotated[float | None, typer.Option(help="all sizes at this many detection limits")] = None,
    workers: Annotated[int, typer.Option(help="cases at a time")] = 1,
    only_show: Annotated[bool, typer.Option("--show", "--tell", help="run nothing, show what is on file")] = False,
    packed: Annotated[
        bool, typer.Option("--pack", help="write the scores on file as one, which another computer goes on from")
    ] = False,
    folder: Annotated[Path, typer.Option(help="where every case is saved")] = Path("runs/bench-gap"),
) -> None:
    """Blind cases of the gap diagnosis: names, refusals, probabilities, limits and shrink against sealed truths."""
    if plant not in PLANTS:
        raise typer.BadParameter(f"--plant {plant}; there are {', '.join(PLANTS)}")
    asked, numbers = Campaign(plant, seed, folder.resolve(), factor), range(first, first + n)
    try:
        if not only_show:
            failed = _run(asked, numbers, workers)
            console.print(f"{failed} cases could not be judged: see their log.txt") if failed else None
        cases = scores(asked, numbers)
        show(cases, f"{plant}, seed {seed}")
        console.print(f"packed: {pack(asked, numbers)}") if packed else None
    except CampaignError as error:
        console.print(f"[bold red]longreach:[/] {escape(str(error))}")
        raise typer.Exit(2) from error


def _run(asked: Campaign, numbers: range, workers: int) -> int:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console) as shown:
        task = shown.add_task("baseline", total=len(numbers))

        def advance(text: str) -> None:
            shown.update(task, description=text, advance=text.startswith("case"))

        return run_campaign(asked, numbers, advance, workers)


def show(cases: figures.Cases, title: str) -> None:
    """Every table of a campaign."""
    console.print(f"{title}: N reached {len(cases)}")
    if not cases:
        return
    console.print(_table("names and refusals (from 2x the detection limit on)", figures.naming(cases)))
    console.print(
        _table("by size, by stage", [*figures.by_factor(cases), *figures.by_own_limit(cases), *figures.by_stage(cases)])
    )
    _tell_reliability(cases)
    sizes = [one["credible_size"] for one in cases]
    classes = [size for one in cases for size in one["classes"]]
    console.print(
        f"mean size of the 90 % set {sum(sizes) / len(sizes):.2f}; mean class size "
        f"{(sum(classes) / len(classes)) if classes else 1.0:.2f} over {len(classes)} names"
    )
    ratios = sorted(figures.limit_ratios(cases))
    if ratios:
        middle, high = ratios[len(ratios) // 2], ratios[int(0.9 * (len(ratios) - 1))]
        console.print(f"tool's limit over the scorer's: median {middle:.2f}, 90 % below {high:.2f}, N = {len(ratios)}")
    closed, count = figures.shrinks(cases)
    console.print(f"median closed_frac of exact answers: {'-' if closed is None else f'{closed:.3f}'} (N = {count})")
    console.print(_table("limits", [figures.closed_limits(cases), figures.inside_limits(cases)]))
    for line in figures.failures(cases):
        console.print(f"  {escape(line)}")


def _tell_reliability(cases: figures.Cases) -> None:
    table = Table(title="probability of each effect", title_justify="left")
    for heading in ("stated", "effects", "mean stated", "share there"):
        table.add_column(heading)
    for name, count, stated, right in figures.reliability(cases):
        table.add_row(name, str(count), f"{stated:.2f}", f"{right:.2f}")
    console.print(table)


def _table(title: str, lines: list[figures.Line]) -> Table:
    table = Table(title=title, title_justify="left")
    for heading in ("claim", "wanted", "reached"):
        table.add_column(heading)
    for line in lines:
        table.add_row(line.claim, line.wanted, share_text(line.share) if line.share is not None else "no case")
    return table
