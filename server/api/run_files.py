"""Recordings on disk, found by id; an id never leaves the folder."""

import re
from pathlib import Path

from fastapi.responses import FileResponse
from starlette.types import Message, Receive, Scope, Send

RUN_ID = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,127}$"
_RUN_ID = re.compile(RUN_ID)


class GrowingFile(FileResponse):
    """A file that may be written to while it is sent: as many bytes as there were at the time of the request."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One answer, not longer than its Content-Length says."""
        left: int | None = None  # of what was promised; None before the head and behind the end

        async def bounded(message: Message) -> None:
            nonlocal left
            if message["type"] == "http.response.start":
                left = int(next(value for name, value in message["headers"] if name.lower() == b"content-length"))
                await send(message)
            elif left is not None:
                body = message["body"][:left]
                more = len(body) < left and message.get("more_body", False)
                left = left - len(body) if more else None
                await send({**message, "body": body, "more_body": more})

        await super().__call__(scope, receive, bounded)


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
