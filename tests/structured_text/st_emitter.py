"""Lines of the Python source, each with the line of Structured Text it came from."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Line:
    """One line of Python source."""

    indent: int
    text: str
    label: str  # POU or method, and the part of its file
    line: int


class Emitter:
    """Collects lines; a part can be caught and placed later."""

    def __init__(self, count: bool = False) -> None:
        self._count = count
        self.marks: list[str] = []  # POU and line of every statement that leaves a mark
        self.lines: list[Line] = []
        self.indent = 0
        self.label = ""
        self._temporaries = 0

    def emit(self, text: str, line: int) -> None:
        """One line at the present depth."""
        self.lines.append(Line(self.indent, text, self.label, line))

    def mark(self, line: int) -> None:
        """The place where a statement begins."""
        if self._count:
            self.emit(f"_st_marks[{len(self.marks)}] = 1", line)
            self.marks.append(f"{self.label}line {line}")

    def temporary(self) -> str:
        """A fresh name."""
        self._temporaries += 1
        return f"_t{self._temporaries}"

    @contextmanager
    def deeper(self) -> Iterator[None]:
        """One level of indentation."""
        self.indent += 1
        try:
            yield
        finally:
            self.indent -= 1

    @contextmanager
    def caught(self) -> Iterator[list[Line]]:
        """What is emitted inside goes into the list instead."""
        outer, self.lines = self.lines, []
        inner = self.lines
        try:
            yield inner
        finally:
            self.lines = outer

    def place(self, lines: list[Line], shift: int = 0) -> None:
        """Caught lines, here."""
        self.lines += [Line(line.indent + shift, line.text, line.label, line.line) for line in lines]

    def source(self) -> str:
        """The Python source."""
        return "\n".join("    " * line.indent + line.text for line in self.lines) + "\n"
