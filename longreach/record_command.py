"""`longreach recording ...`: check, convert, recover, open in Rerun."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from longreach.foreign_log import MappingFile, Urdf, Yes, convert_log
from longreach.rerun_view import rerun
from recording.check import CheckReport, check_recording
from recording.content import Recording
from recording.convert import convert as convert_recording
from recording.errors import RecordingError
from recording.foreign.convert import is_foreign
from recording.recover import recover as recover_recording

app = typer.Typer(no_args_is_help=True)
app.command("rerun")(rerun)
console = Console()
Source = Annotated[Path, typer.Argument(help="an MCAP file or a folder of CSV files")]
Target = Annotated[
    Path, typer.Argument(help="output; a name ending in .mcap is written as MCAP, else as a folder of CSV files")
]


@app.command()
def check(recording: Source) -> None:
    """List the signals present, those missing, and what each missing one costs."""
    try:
        shown(check_recording(recording), console)
    except RecordingError as error:
        _exit_with_error(error)


@app.command()
def convert(
    recording: Annotated[Path, typer.Argument(help="an MCAP file, a folder of CSV files, a ROS bag or a table")],
    target: Target,
    urdf: Urdf = None,
    mapping: MappingFile = None,
    yes: Yes = False,
    mapping_out: Annotated[
        Path | None, typer.Option("--mapping-out", help="write the guesses here, as a mapping file to correct")
    ] = None,
) -> None:
    """Convert MCAP to a folder of CSV files or back, or a ROS bag or a table to a folder."""
    try:
        if mapping is not None or is_foreign(recording):
            convert_log(recording, target, urdf, mapping, yes, console, mapping_out)
            console.print(f"written: {escape(str(target))}", soft_wrap=True)
            return
        found = convert_recording(recording, target)
    except RecordingError as error:
        _exit_with_error(error)
    else:
        console.print(f"written: {escape(str(target))}", soft_wrap=True)
        for text in left_behind(found):
            console.print(f"[yellow]left out[/] {escape(text)}", soft_wrap=True)


@app.command()
def recover(recording: Source, target: Target) -> None:
    """Recover the readable part of a damaged MCAP file."""
    try:
        saved = recover_recording(recording, target)
    except RecordingError as error:
        _exit_with_error(error)
    else:
        lost = f"{saved.lost_chunks} damaged chunks are lost; " if saved.lost_chunks else ""
        how = "nothing was damaged" if saved.was_complete else f"{lost}stopped reading at: {escape(saved.reason)}"
        text = (
            f"saved {saved.n_messages} messages and {saved.n_attachments} attachments to {escape(str(target))}; {how}"
        )
        console.print(text, soft_wrap=True)


def left_behind(found: Recording) -> list[str]:
    """What the other form does not hold, in words."""
    out = [] if found.complete else ["data behind the damage: the file is cut; rows up to there are written"]
    out += [f"channel {channel}" for channel in found.foreign_channels]
    return out + ([f"{found.n_images} images: CSV folders hold no images"] if found.n_images else [])


def shown(report: CheckReport, screen: Console) -> None:
    """A report as people read it: what is there, then what is missing, what that costs, and the remedy."""
    whole = "whole" if report.complete else "[yellow]cut off[/]: `longreach recording recover` saves the readable part"
    use = "usable for a diagnosis" if report.usable else "[red]not usable for a diagnosis[/]"
    screen.print(f"{escape(str(report.path))}: {whole}; {use}; {report.n_images} images", soft_wrap=True)
    table = Table("signal", *(Column(name, justify="right") for name in ("rows", "rate [Hz]", "lasts [s]", "gaps")))
    for signal in report.signals:
        table.add_row(
            signal.name, str(signal.n_rows), f"{signal.rate_hz:.4g}", f"{signal.duration_s:.1f}", str(signal.n_gaps)
        )
    screen.print(table)
    for text in report.problems:
        screen.print(f"[yellow]problem[/] {escape(text)}", soft_wrap=True)
    for missing in report.missing_signals:
        screen.print(
            f"without {escape(missing.signal)}: {escape(missing.cost)}; {escape(missing.remedy)}", soft_wrap=True
        )


def _exit_with_error(error: RecordingError) -> None:
    Console(stderr=True).print(f"[bold red]recording:[/] {escape(str(error))}", soft_wrap=True)
    raise typer.Exit(2)
