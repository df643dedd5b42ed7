"""Logs of other systems on the command line: list the findings, confirm guesses, convert."""

import atexit
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from recording.errors import RecordingError
from recording.foreign.assemble import AssembledRecording
from recording.foreign.convert import convert_foreign, is_foreign
from recording.foreign.found import SourceContents

Urdf = Annotated[Path | None, typer.Option("--urdf", help="the robot of a ROS bag or a table: its URDF file")]
MappingFile = Annotated[
    Path | None,
    typer.Option("--mapping", help="which topic or column is which signal: a TOML file, docs/other-logs.md"),
]
Yes = Annotated[bool, typer.Option("--yes", help="accept the guessed topics and columns without asking")]


def convert_log(
    source: Path,
    target: Path,
    urdf: Path | None,
    mapping: Path | None,
    yes: bool,
    screen: Console,
    mapping_out: Path | None = None,
) -> None:
    """Convert a log into a folder. Raises: RecordingError: unreadable, or a guess was not confirmed."""

    def confirm(found: SourceContents, assembled: AssembledRecording) -> bool:
        show(found, assembled, screen)
        if yes or not found.guessed_entries:
            return True
        return sys.stdin.isatty() and typer.confirm("Are the guesses right?", default=False, err=True)

    convert_foreign(source, target, urdf, mapping, confirm, mapping_out)


def show(found: SourceContents, assembled: AssembledRecording, screen: Console) -> None:
    """What was found, what it was taken for, and why the rest is not used."""
    table = Table("topic or column", "type", Column("messages", justify="right"), "use", "why")
    for entry in sorted(found.entries, key=lambda entry: (entry.use == "ignored", entry.name)):
        use = "[yellow]guess[/]" if entry.is_guess and entry.use == "used" else entry.use
        table.add_row(escape(entry.name), escape(entry.kind), str(entry.n_values), use, escape(entry.reason))
    screen.print(table)
    for note in (*found.notes, *assembled.notes):
        screen.print(f"note: {escape(note)}", soft_wrap=True)


def as_recordings(
    paths: Sequence[Path], urdf: Path | None, mapping: Path | None, yes: bool, screen: Console
) -> list[Path]:
    """The same paths, with a converted folder in place of each log of another system; the folders go at exit.

    Raises: typer.Exit 2: a log cannot be converted.
    """
    if not any(mapping is not None or is_foreign(path) for path in paths):
        if urdf is not None:
            raise typer.BadParameter(
                "--urdf belongs to a ROS bag or a table; a recording names its own in machine.toml"
            )
        return list(paths)
    folder = Path(tempfile.mkdtemp(prefix="longreach-log-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    out = []
    for number, path in enumerate(paths):
        if mapping is None and not is_foreign(path):
            out.append(path)
            continue
        target = folder / (path.stem if number == 0 else f"{path.stem}-{number + 1}")
        try:
            convert_log(path, target, urdf, mapping, yes, screen)
        except RecordingError as error:
            screen.print(f"[bold red]longreach:[/] {escape(str(error))}", soft_wrap=True)
            raise typer.Exit(2) from error
        out.append(target)
    return out
