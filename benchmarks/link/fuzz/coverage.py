"""Which lines of the link one call runs through: coverage for the corpus, from the interpreter's own tracing."""

import sys
from collections.abc import Callable
from pathlib import PurePath
from types import FrameType
from typing import Any

_FOLDERS = ("protocol", "plc")


def _name(filename: str) -> str:
    """folder/file of a module under test; empty for any other."""
    parts = PurePath(filename).parts[-2:]
    return "/".join(parts) if len(parts) == 2 and parts[0] in _FOLDERS else ""


class LineTrace:
    """Collects `folder/file:line` while `run` runs a call; about ten times slower than without."""

    def __init__(self) -> None:
        self.lines: set[str] = set()
        self._names: dict[str, str] = {}

    def run(self, call: Callable[[], Any]) -> Any:
        """The call's result; whatever tracer was there before is put back."""
        before = sys.gettrace()
        sys.settrace(self._on_call)
        try:
            return call()
        finally:
            sys.settrace(before)

    def _on_call(self, frame: FrameType, event: str, argument: object) -> Any:
        filename = frame.f_code.co_filename
        if filename not in self._names:
            self._names[filename] = _name(filename)
        return self._on_line if self._names[filename] else None

    def _on_line(self, frame: FrameType, event: str, argument: object) -> Any:
        self.lines.add(f"{self._names[frame.f_code.co_filename]}:{frame.f_lineno}")
        return self._on_line
