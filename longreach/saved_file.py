"""Long runs as one file a case: whole or not at all, so that a run that was killed while writing can be resumed."""

from pathlib import Path


def save_whole(path: Path, text: str) -> None:
    """Write a file in one step; a cut leaves the file of before, or none."""
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)
