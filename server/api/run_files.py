"""Recordings on disk, found by id; an id never leaves the folder."""

import re
from pathlib import Path

RUN_ID = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,127}$"
_RUN_ID = re.compile(RUN_ID)


def run_path(folder: Path, run_id: str) -> Path | None:
    """The recording of that id (its file name without .mcap); None when there is none in the folder itself."""
    if not _RUN_ID.fullmatch(run_id) or ".." in run_id:
        return None
    path = folder / f"{run_id}.mcap"
    return path if path.is_file() and not path.is_symlink() else None


def inside(folder: Path, relative: str) -> Path | None:
    """What lies at a relative path inside the folder, links resolved; None when it is not there or outside."""
    if "\x00" in relative:
        return None
    try:
        path = (folder / relative).resolve()
        root = folder.resolve()
        return path if path.is_relative_to(root) and path != root and path.exists() else None
    except OSError:
        return None


def run_ids(folder: Path) -> list[str]:
    """All of them, newest first."""
    try:
        files = [path for path in folder.glob("*.mcap") if _RUN_ID.fullmatch(path.stem) and path.is_file()]
    except OSError:
        return []
    return [path.stem for path in sorted(files, key=lambda path: path.name, reverse=True)]
