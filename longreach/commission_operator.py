"""Operator interface of `longreach commission`: terminal, answers file, or unattended."""

import asyncio
import os
import sys
import threading
import tomllib
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn

from recording.files import read_text
from server.errors import SettingsError


def read_answers(path: Path | None) -> dict[str, str]:
    """Answers by key ("joint_signs.slew") from a TOML file of tables; no file, no answers.

    Raises: SettingsError: not there, not TOML, or deeper than one table.
    """
    if path is None:
        return {}
    try:
        tables = tomllib.loads(read_text(path))
    except OSError as error:
        raise SettingsError(f"answers file {path}: {error.strerror}; give a TOML file that can be read") from error
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"answers file {path} is not TOML: {error}") from error
    answers: dict[str, str] = {}
    for step, entries in tables.items():
        if not isinstance(entries, dict):
            raise SettingsError(
                f"answers file {path}: {step} = {entries!r} stands outside a table such as [joint_signs]"
            )
        for name, value in entries.items():
            if not isinstance(value, str | int | float) or isinstance(value, bool):
                raise SettingsError(f"answers file {path}: {step}.{name} = {value!r} must be a number or a text")
            answers[f"{step}.{name}"] = str(value)
    return answers


class _StdinLineReader:
    """Standard input read line by line in a thread; an unfinished read never blocks the exit."""

    def __init__(self) -> None:
        self._left = b""
        self._ended = False

    async def next_line(self) -> str | None:
        """The next line, or None at the end."""
        while b"\n" not in self._left and not self._ended:
            chunk = await self._read_chunk()
            self._ended = not chunk
            self._left += chunk
        line, newline, self._left = self._left.partition(b"\n")
        return line.decode(errors="replace").strip() if line or newline else None

    async def _read_chunk(self) -> bytes:
        loop = asyncio.get_running_loop()
        got: asyncio.Future[bytes] = loop.create_future()

        def deliver(chunk: bytes) -> None:
            if not got.done():
                got.set_result(chunk)

        def read() -> None:
            try:
                chunk = os.read(sys.stdin.fileno(), 4096)
            except (OSError, ValueError):
                chunk = b""
            if not loop.is_closed():
                loop.call_soon_threadsafe(deliver, chunk)

        threading.Thread(target=read, name="operator-line", daemon=True).start()
        return await got


class TerminalOperator:
    """Asks at the terminal what the answers file leaves open. With `assume_yes` (unattended) nothing is asked."""

    def __init__(self, console: Console, answers: dict[str, str], assume_yes: bool, move: bool) -> None:
        self._console, self._answers, self._assume_yes, self._move = console, answers, assume_yes, move
        self._lines = _StdinLineReader()
        self._asked: set[str] = set()
        self._progress: Progress | None = None
        self._task: TaskID | None = None
        self._text = ""

    @property
    def open_answers(self) -> tuple[str, ...]:
        """Answers without a question: most likely misspelt."""
        return tuple(sorted(set(self._answers) - self._asked))

    async def may_move(self, machine_name: str) -> bool:
        """--move, or the machine's name typed."""
        if self._move or self._assume_yes:
            return self._move
        text = f"the next steps move the machine. Type its name ({machine_name}) to permit this, or Enter to skip them"
        return await self._ask_for_line(text) == machine_name

    async def confirm(self, text: str) -> bool:
        """Enter goes on, anything else does not; --yes goes on."""
        if self._assume_yes:
            self.show(text)
            return True
        return await self._ask_for_line(f"{text}. Press Enter to continue, n to refuse") == ""

    async def ask(self, key: str, question: str) -> str | None:
        """The file's answer, or the engineer's."""
        self._asked.add(key)
        if key in self._answers:
            self.show(f"{question}: {self._answers[key]} (from the answers)")
            return self._answers[key]
        return None if self._assume_yes else await self._ask_for_line(question)

    def show(self, text: str) -> None:
        """One line."""
        self.close()
        self._console.print(escape(text), highlight=False, soft_wrap=True)

    def progress(self, text: str, current: float, target: float, unit: str) -> None:
        """One bar at a time; a new text begins a new one."""
        if self._progress is None or text != self._text:
            self.close()
            columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[amount]}"))
            shown = self._console.is_terminal
            self._progress = Progress(*columns, console=self._console, transient=True, disable=not shown)
            self._progress.start()
            self._task, self._text = self._progress.add_task(escape(text), total=target, amount=""), text
        if self._task is not None:
            self._progress.update(self._task, completed=current, amount=f"{current:.1f} of {target:.1f} {unit}")

    def close(self) -> None:
        """Take the bar away."""
        if self._progress is not None:
            self._progress.stop()
        self._progress = self._task = None

    async def _ask_for_line(self, text: str) -> str | None:
        self.close()
        self._console.print(f"{escape(text)}: ", end="", highlight=False)
        return await self._lines.next_line()
