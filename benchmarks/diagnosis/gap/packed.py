"""A campaign's scores in one file, with the mark of the code that made them: what another computer goes on from."""

import gzip
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from recording.files import write_durably


class PackedError(Exception):
    """A file that holds no packed scores."""


@dataclass(frozen=True, slots=True)
class Packed:
    """Scores by case number, and the mark; None where there is no file."""

    code: str | None = None
    scores: dict[int, dict[str, Any]] = field(default_factory=dict)


def read_packed(file: Path) -> Packed:
    """What a file holds; nothing where there is none.

    Raises: PackedError: the file is cut short or holds something else.
    """
    if not file.is_file():
        return Packed()
    try:
        first, *lines = gzip.decompress(file.read_bytes()).decode("utf-8").splitlines()
        scores = [json.loads(line) for line in lines]
        return Packed(str(json.loads(first)["code"]), {int(one["number"]): one for one in scores})
    except (OSError, EOFError, ValueError, KeyError, TypeError) as error:
        told = f"{type(error).__name__}: {error}"
        raise PackedError(f"{file}: no packed scores ({told}); delete it, or fetch it again") from error


def write_packed(file: Path, code: str, scores: Sequence[dict[str, Any]]) -> None:
    """Write them whole or not at all; the same scores give the same bytes."""
    lines = [{"code": code}, *sorted(scores, key=lambda one: int(one["number"]))]
    text = "".join(json.dumps(one, separators=(",", ":"), sort_keys=True) + "\n" for one in lines)
    write_durably(file, gzip.compress(text.encode("utf-8"), mtime=0))
