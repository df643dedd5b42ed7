"""`longreach bench first-day`: the error budget on sealed machines that nobody has measured; a second run resumes."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table

from benchmarks.diagnosis.first_day import figures
from benchmarks.diagnosis.first_day.calibrate import TooFewError, calibrated
from benchmarks.diagnosis.first_day.runner import Campaign, FirstDayError, read_scored, run_campaign
from benchmarks.diagnosis.first_day.score import score_of
from benchmarks.positioning.machines.command import share_text

console = Console(width=150)
JUDGEMENT = 1000  # seeds below judge; from here on they may fit the calibration


def first_day(
    scored: Annotated[
        list[Path] | None, typer.Argument(help="files of scored cases: run nothing, report these")
    ] = None,
    n: Annotated[int, typer.Option(help="cases")] = 21,
    first: Annotated[int, typer.Option(help="number of the first case")] = 0,
    seed: Annotated[int, typer.Option(help="of the campaign; from 1000 on they train, below they judge")] = 1,
    kind: Annotated[str, typer.Option(help="a kind of the third plant, mixed, or realistic")] = "mixed",
    recording: Annotated[str | None, typer.Option(help="another recording than the kind's own")] = None,
    shorten: Annotated[float, typer.Option(help="of the motion's length: shorter cases cost less", max=1.0)] = 1.0,
    workers: Annotated[int, typer.Option(help="cases at a time")] = 1,
    calibrate: Annotated[Path | None, typer.Option(help="fit the probabilities on the scored cases into this")] = None,
    folder: Annotated[Path, typer.Option(help="where every case is saved")] = Path("runs/bench-first-day"),
) -> None:
    """Sealed machines diagnosed without a baseline: coverage, false effects, sizes, verdicts, probabilities."""
    if calibrate is not None and not scored:
        raise typer.BadParameter("--calibrate fits on scored cases: give the files that earlier runs have written")
    try:
        if not scored:
            campaign, numbers = Campaign(kind, seed, folder.resolve(), recording, shorten), range(first, first + n)
            with Progress(console=console) as shown:
                task = shown.add_task("cases", total=n)
                failed = run_campaign(campaign, numbers, lambda: shown.advance(task), workers)
            console.print(f"{failed} cases could not be diagnosed: see their log.txt") if failed else None
            scored = [campaign.scored]
        scores = [score_of(case) for case in read_scored(scored)]
        report(scores)
        if calibrate is not None:
            calibrate.write_text(json.dumps(calibrated(scores), indent=2) + "\n", encoding="utf-8")
            console.print(f"wrote {calibrate}")
    except (FirstDayError, TooFewError) as error:
        console.print(f"[bold red]longreach:[/] {escape(str(error))}")
        raise typer.Exit(2) from error


def report(scores: figures.Scores) -> None:
    """Every table."""
    seeds = ", ".join(str(seed) for seed in sorted({score.seed for score in scores}))
    console.print(f"N = {len(scores)} cases, seed {seeds}; probabilities by this tree's calibration")
    _print("first day", ("figure", "wanted", "reached"), figures.rows(scores))
    words = sorted({score.verdict for score in scores})
    counts = [
        (kind, str(n), *(str(count.get(word, 0)) for word in words)) for kind, n, count in figures.verdicts(scores)
    ]
    _print("verdicts, as stated", ("kind", "cases", *words), counts)
    effects = [effect for score in scores for effect in score.reported]
    curve = figures.reliability([effect.probability for effect in effects], [effect.right for effect in effects])
    rows = [(name, f"{mean:.2f}", share_text(share)) for name, mean, share in curve]
    _print("reported effects: probability stated against share right", ("stated", "mean", "right"), rows)
    for line in figures.failures(scores):
        console.print(f"  {escape(line)}")


def _print(title: str, headings: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    table = Table(title=title, title_justify="left")
    for heading in headings:
        table.add_column(heading)
    for row in rows:
        table.add_row(*row)
    console.print(table)
