"""`longreach bench gap`: the blind benchmark, for hours in the background; every case saved, a second run resumes."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from benchmarks.diagnosis.gap import figures, reliability
from benchmarks.diagnosis.gap.calibrate import calibrated, fit, restated, shares_of_today, with_equals_known
from benchmarks.diagnosis.gap.runner import PLANTS, ROOT, Campaign, CampaignError, pack, run_campaign, scores
from benchmarks.positioning.machines.command import share_text

console = Console(width=170)
JUDGEMENT = 100  # seeds from here on judge
CALIBRATION = ROOT / "diagnosis" / "verdict" / "calibration.json"


def gap(
    n: Annotated[int, typer.Option(help="cases")] = 600,
    seed: Annotated[int, typer.Option(help="of the campaign; judgement seeds are 100 and above")] = 100,
    plant: Annotated[str, typer.Option(help="own, or foreign (needs Exudyn)")] = "own",
    first: Annotated[int, typer.Option(help="number of the first case")] = 0,
    factor: Annotated[float | None, typer.Option(help="all sizes at this many detection limits")] = None,
    workers: Annotated[int, typer.Option(help="cases at a time")] = 1,
    calibrate: Annotated[
        bool, typer.Option("--calibrate", help="fit the probabilities' numbers on what is on file (seeds below 100)")
    ] = False,
    with_seed: Annotated[
        list[int] | None, typer.Option(help="a further campaign on file that --calibrate counts; may be given again")
    ] = None,
    keep_temperature: Annotated[
        bool, typer.Option("--keep-temperature", help="--calibrate only counts the shares of what is outside or unseen")
    ] = False,
    spent: Annotated[
        bool, typer.Option("--spent", help="the judgement seeds of --calibrate are spent: later code answers to them")
    ] = False,
    only_tell: Annotated[bool, typer.Option("--tell", help="run nothing, tell what is on file")] = False,
    packed: Annotated[
        bool, typer.Option("--pack", help="write the scores on file as one, which another computer goes on from")
    ] = False,
    folder: Annotated[Path, typer.Option(help="where every case is saved")] = Path("runs/bench-gap"),
) -> None:
    """Blind cases of the gap diagnosis: names, refusals, probabilities, limits and shrink against sealed truths."""
    if plant not in PLANTS:
        raise typer.BadParameter(f"--plant {plant}; there are {', '.join(PLANTS)}")
    seeds = [seed, *(with_seed or ())]
    if calibrate and max(seeds) >= JUDGEMENT and not spent:
        raise typer.BadParameter(
            f"--calibrate with --seed {max(seeds)}: seeds of {JUDGEMENT} and above judge, and fit nothing "
            "before they are spent (--spent)"
        )
    asked, numbers = Campaign(plant, seed, folder.resolve(), factor), range(first, first + n)
    try:
        if not only_tell:
            failed = _run(asked, numbers, workers)
            console.print(f"{failed} cases could not be judged: see their log.txt") if failed else None
        cases = scores(asked, numbers)
        tell(cases, f"{plant}, seed {seed}")
        console.print(f"packed: {pack(asked, numbers)}") if packed else None
    except CampaignError as error:
        console.print(f"[bold red]longreach:[/] {escape(str(error))}")
        raise typer.Exit(2) from error
    if calibrate and cases:
        counted = [
            one for number in seeds for one in scores(Campaign(plant, number, folder.resolve(), factor), numbers)
        ]
        told_seeds = f"seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}"
        _calibrate(counted, f"{len(counted)} cases of plant {plant}, {told_seeds}", keep_temperature)


def _run(asked: Campaign, numbers: range, workers: int) -> int:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console) as shown:
        task = shown.add_task("baseline", total=len(numbers))

        def advance(text: str) -> None:
            shown.update(task, description=text, advance=text.startswith("case"))

        return run_campaign(asked, numbers, advance, workers)


def _calibrate(cases: figures.Cases, told_on: str, keep_temperature: bool) -> None:
    found = fit(cases, keep_temperature)
    curve = reliability.by_width(restated(with_equals_known(cases), found))
    CALIBRATION.write_text(calibrated(CALIBRATION.read_text(encoding="utf-8"), found, curve, told_on), encoding="utf-8")
    console.print(f"sharper {found.sharper:.3g}, {found.per_effect:+.3g} nats an effect, outside {found.outside}")
    for name, count, mean, right in curve:
        console.print(f"  {name}: {count} cases, stated {mean:.2f}, right {right:.2f}")


def tell(cases: figures.Cases, title: str) -> None:
    """Every table of a campaign."""
    console.print(f"{title}: N reached {len(cases)}")
    if not cases:
        return
    console.print(_table("names and refusals (from 2x the detection limit on)", figures.naming(cases)))
    console.print(
        _table("by size, by stage", [*figures.by_factor(cases), *figures.by_own_limit(cases), *figures.by_stage(cases)])
    )
    console.print(_table("the true name left out of the library", figures.left_out(cases)))
    console.print(_table("simpler methods, same cases", figures.rivals(cases)))
    _tell_reliability(cases, "as the answers stated it")
    _tell_reliability(restated(cases, shares_of_today()), "with the shares of this tree's calibration.json")
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


def _tell_reliability(cases: figures.Cases, how: str) -> None:
    table = Table(title=f"probability of the best answer or its equals, {how}", title_justify="left")
    for heading in ("stated", "cases", "mean stated", "share right"):
        table.add_column(heading)
    widths, fifths = reliability.by_width(cases), reliability.by_fifths(cases)
    for k, (bin_name, count, stated, right) in enumerate((*widths, *fifths)):
        table.add_row(bin_name, str(count), f"{stated:.2f}", f"{right:.2f}", end_section=k == len(widths) - 1)
    console.print(table)


def _table(title: str, lines: list[figures.Line]) -> Table:
    table = Table(title=title, title_justify="left")
    for heading in ("claim", "wanted", "reached"):
        table.add_column(heading)
    for line in lines:
        table.add_row(line.claim, line.wanted, share_text(line.share) if line.share is not None else "no case")
    return table
