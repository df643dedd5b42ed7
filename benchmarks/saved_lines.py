"""Long runs as JSON lines: each case is written as soon as it is there, and what is there already is not run again.

A process that is killed while it writes leaves a last line that is cut short. It is told and left out, so that its case
runs again, and taken away before the next line is written.
"""

import json
import logging
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TextIO, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

log = logging.getLogger(__name__)

Key = TypeVar("Key", int, str)
Item = TypeVar("Item")
Line = dict[str, Any]


class SavedLineError(ValueError):
    """A line in the midst of a file that is not what it should be."""


@dataclass(frozen=True, slots=True)
class Read(Generic[Item]):
    """What the lines of a file stand for, and the number of and reason for each that stands for nothing."""

    items: list[Item]
    refused: list[tuple[int, str]]


def every_line(path: Path, item_of: Callable[[str], Item] = json.loads) -> list[Item]:
    """What every line of a file stands for; a last line cut short by a kill is told and left out.

    Raises: SavedLineError: another line cannot be read.
    """
    read = _read(path, item_of)
    for number, why in read.refused:
        raise SavedLineError(f"{path}, line {number}: {why}; remove the line or the file")
    return read.items


def whole_lines(path: Path, item_of: Callable[[str], Item] = json.loads) -> list[Item]:
    """What every line of a file stands for; those cut short, or of another version, are told and left out."""
    read = _read(path, item_of)
    if read.refused:
        (number, why), rest = read.refused[0], len(read.refused) - 1
        more = f" (and {rest} more)" if rest else ""
        log.warning("%s, line %d%s: left out, to run again: %s", path, number, more, why)
    return read.items


def read_lines(path: Path) -> dict[Any, Line]:
    """Lines by their `key`; as `every_line`."""
    return dict(every_line(path, _keyed))


def _keyed(text: str) -> tuple[Any, Line]:
    line = json.loads(text)
    return line["key"], line


def _read(path: Path, item_of: Callable[[str], Item]) -> Read[Item]:
    """All lines but blank ones and one cut short at the end, which is told here."""
    rows = path.read_bytes().split(b"\n") if path.exists() else []
    found: Read[Item] = Read([], [])
    for number, row in enumerate(rows, start=1):
        if not row.strip():
            continue
        try:
            found.items.append(item_of(row.decode("utf-8")))
        except (ValueError, KeyError, TypeError) as error:
            if number == len(rows) and not _is_json(row):  # nothing behind it, not even the end of its line
                log.warning("%s, line %d: cut short by a kill; left out, to run again", path, number)
            else:
                found.refused.append((number, repr(error)))
    return found


def _is_json(row: bytes) -> bool:
    try:
        json.loads(row)
    except ValueError:
        return False
    return True


def open_to_add(path: Path) -> TextIO:
    """Open for more lines; a last line cut short is taken away, so that the next does not hang on to it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = path.read_bytes() if path.exists() else b""
    whole, last = text.rfind(b"\n") + 1, text[text.rfind(b"\n") + 1 :]
    if last and not _is_json(last):
        os.truncate(path, whole)  # in one step: a kill in the midst of it leaves no less than before
    file = path.open("a", encoding="utf-8")
    if last and _is_json(last):
        file.write("\n")
    return file


def add_line(file: TextIO, line: Line) -> None:
    """One more line, handed to the operating system before anything else is done."""
    file.write(json.dumps(line) + "\n")
    file.flush()


def run_saved(path: Path, keys: Iterable[Key], run: Callable[[Key], Line], console: Console, text: str) -> list[Line]:
    """The line of each key, run or read; a bar tells how many, how long, how much longer."""
    wanted, known = list(keys), read_lines(path)
    missing = [key for key in wanted if key not in known]
    with _bar(console) as bar, open_to_add(path) as file:
        task = bar.add_task(text, total=len(wanted), completed=len(wanted) - len(missing))
        for key in missing:
            known[key] = {"key": key, **run(key)}
            add_line(file, known[key])
            bar.advance(task)
    return [known[key] for key in wanted]


def _bar(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console,
    )
