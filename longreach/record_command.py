"""`longreach recording ...`: check, convert, recover, open in Rerun."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from longreach.rerun_view import rerun
from recording.check import check_recording
from recording.convert import convert as convert_recording
from recording.errors import RecordingError
from recording.recover import recover as recover_recording

app = typer.Typer(no_args_is_help=True)
app.command("rerun")(rerun)
console = Console()
Source = Annotated[Path, typer.Argument(help="an MCAP file or a folder of CSV files")]
Target = Annotated[Path, typer.Argument(help="where the result goes; the ending .mcap decides the form")]


@app.command()
def check(recording: Source) -> None:
    """Say what is there, what is missing, and what that costs."""
    try:
        console.print(check_recording(recording))
    except RecordingError as error:
        _refuse(error)


@app.command()
def convert(recording: Source, target: Target) -> None:
    """MCAP to a folder of CSV files, or back."""
    try:
        convert_recording(recording, target)
    except RecordingError as error:
        _refuse(error)
    console.print(f"written: {target}")


@app.command()
def recover(recording: Source, target: Target) -> None:
    """Save what a crash left of an MCAP file."""
    try:
        console.print(recover_recording(recording, target))
    except RecordingError as error:
        _refuse(error)


def _refuse(error: RecordingError) -> None:
    Console(stderr=True).print(f"[bold red]recording:[/] {error}")
    raise typer.Exit(2)
