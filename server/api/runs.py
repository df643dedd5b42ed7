"""Recordings over REST: list, and the MCAP file itself with range requests."""

import asyncio
import re
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi import Path as InPath
from fastapi.responses import FileResponse, JSONResponse
from starlette.types import Message, Receive, Scope, Send

from server.api.problems import problem_response
from server.api.views import Problem, View

# Recordings on disk, found by id; an id never leaves the folder.

RUN_ID_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,127}$"
_RUN_ID = re.compile(RUN_ID_PATTERN)


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
    """The recording of that id (its file name without .mcap); None when the folder itself does not hold it."""
    if not _RUN_ID.fullmatch(run_id) or ".." in run_id:
        return None
    path = folder / f"{run_id}.mcap"
    return path if path.is_file() and not path.is_symlink() else None


def path_inside(folder: Path, relative: str) -> Path | None:
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


RunId = Annotated[str, InPath(pattern=RUN_ID_PATTERN, description="as in the list of runs")]
FILE: dict[int | str, dict[str, Any]] = {
    200: {"description": "the whole file", "content": {"application/octet-stream": {}}},
    206: {"description": "the requested range", "content": {"application/octet-stream": {}}},
    400: {"description": "a range header that cannot be read", "content": {"text/plain": {}}},
    404: {"model": Problem},
    416: {"description": "a range outside the file", "content": {"text/plain": {}}},
}


class RunView(View):
    """One recording."""

    run_id: str
    bytes: int
    changed_unix_s: float


def runs_router(folder: Path) -> APIRouter:
    """Routes /v1/runs and /v1/runs/{run_id}/mcap."""
    router = APIRouter(prefix="/v1/runs", tags=["runs"])

    @router.get("", response_model=list[RunView])
    async def list_runs(limit: Annotated[int, Query(ge=1, le=1000)] = 100) -> list[RunView]:
        """All recordings, newest first."""
        return await asyncio.to_thread(_run_views, folder, limit)

    @router.get("/{run_id}/mcap", response_model=None, response_class=FileResponse, responses=FILE)
    async def run_mcap(run_id: RunId) -> FileResponse | JSONResponse:
        """The MCAP file; `Range: bytes=...` returns a part of it, so that an interrupted download can resume.

        A recording that is being written is returned as far as it exists.
        """
        path = await asyncio.to_thread(run_path, folder, run_id)
        if path is None:
            return problem_response(
                404, "Unknown run", f"no recording {run_id[:64]!r}", "unknown_run", "see GET /v1/runs"
            )
        return GrowingFile(path, media_type="application/octet-stream", filename=path.name)

    return router


def _run_views(folder: Path, limit: int) -> list[RunView]:
    views = []
    for run_id in run_ids(folder)[:limit]:
        path = run_path(folder, run_id)
        if path is not None:
            state = path.stat()
            views.append(RunView(run_id=run_id, bytes=state.st_size, changed_unix_s=round(state.st_mtime, 3)))
    return views
