"""`longreach diagnose`: where the sim-to-real gap lies, which effect causes it, how far it shrinks."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from diagnosis.answer import answer
from diagnosis.diagnose import diagnose as run_diagnosis
from diagnosis.reading import Read, read
from diagnosis.report.curves import CellCurves, curves_of
from diagnosis.report.page import page
from diagnosis.report.text import lines

BAD_INPUT = 2


def diagnose(
    recording: Annotated[Path, typer.Argument(help="an MCAP file or a folder of CSV files")],
    machine_file: Annotated[Path | None, typer.Option("--machine", help="use this machine.toml instead")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="write the whole answer here")] = None,
    html_file: Annotated[Path | None, typer.Option("--html", help="write a report here")] = None,
) -> None:
    """Diagnose the gap between a recording and its nominal machine."""
    screen = Console(stderr=True)
    whole = read(recording, machine_file)
    for finding in whole.findings:
        screen.print(f"[yellow]{finding.severity}[/] {escape(str(finding))}", soft_wrap=True)
    if not whole.usable:
        raise typer.Exit(BAD_INPUT)
    result, curves = _with_progress(whole, screen)
    for text in lines(result):
        typer.echo(text)
    _write(json_file, json.dumps(result, indent=1, allow_nan=False) + "\n", screen)
    _write(html_file, page(result, recording.name, curves), screen)


def _with_progress(whole: Read, screen: Console) -> tuple[dict[str, Any], tuple[CellCurves, ...]]:
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=screen, transient=True) as shown:
        task = shown.add_task("preparing", total=None)
        found = run_diagnosis(
            whole, lambda text, done, total: shown.update(task, description=text, completed=done, total=total)
        )
        shown.update(task, description="next experiment")
        return answer(found), curves_of(found)


def _write(path: Path | None, text: str, screen: Console) -> None:
    if path is None:
        return
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        screen.print(f"[bold red]longreach:[/] {escape(str(path))} cannot be written: {error.strerror}", soft_wrap=True)
        raise typer.Exit(BAD_INPUT) from error
