"""Long runs as JSON lines: each case is written as soon as it is there, and what is there already is not run again."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

Key = TypeVar("Key", int, str)
Item = TypeVar("Item")
Line = dict[str, Any]


class SavedLineError(ValueError):
    """A line in the midst of a file that is no JSON object with a key."""


def read_lines(path: Path) -> dict[Any, Line]:
    """Lines by their `key`; a last line cut short by a kill is left out.

    Raises: SavedLineError: another line cannot be read.
    """
    if not path.exists():
        return {}
    rows = path.read_text(encoding="utf-8").splitlines()
    found: dict[Any, Line] = {}
    for number, row in enumerate(rows, start=1):
        try:
            line = json.loads(row)
            found[line["key"]] = line
        except (json.JSONDecodeError, KeyError, TypeError) as error:
            if number < len(rows):
                raise SavedLineError(f"{path}, line {number}: {error!r}; remove the line or the file") from error
    return found


def whole_lines(path: Path, item_of: Callable[[str], Item]) -> list[Item]:
    """What every line of a file stands for; one cut off by a stop, or of another version, is passed over."""
    found = []
    for text in filter(None, path.read_text(encoding="utf-8").splitlines() if path.exists() else []):
        try:
            found.append(item_of(text))
        except (ValueError, KeyError, TypeError):
            continue
    return found


def run_saved(path: Path, keys: Iterable[Key], run: Callable[[Key], Line], console: Console, text: str) -> list[Line]:
    """The line of each key, run or read; a bar tells how many, how long, how much longer."""
    path.parent.mkdir(parents=True, exist_ok=True)
    wanted, known = list(keys), read_lines(path)
    missing = [key for key in wanted if key not in known]
    _mend(path, known)
    with _bar(console) as bar, path.open("a", encoding="utf-8") as file:
        task = bar.add_task(text, total=len(wanted), completed=len(wanted) - len(missing))
        for key in missing:
            known[key] = {"key": key, **run(key)}
            file.write(json.dumps(known[key]) + "\n")
            file.flush()
            bar.advance(task)
    return [known[key] for key in wanted]


def _mend(path: Path, known: dict[Any, Line]) -> None:
    """Take a last line away that was cut short, so that the next one does not hang on to it."""
    if path.exists() and not path.read_text(encoding="utf-8").endswith("\n"):
        path.write_text("".join(json.dumps(line) + "\n" for line in known.values()), encoding="utf-8")


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
