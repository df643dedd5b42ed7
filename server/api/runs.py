"""Recordings over REST: list, and the MCAP file itself with range requests."""

import asyncio
from pathlib import Path as FilePath
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query
from fastapi.responses import FileResponse, JSONResponse

from server.api.problems import problem
from server.api.run_files import RUN_ID, GrowingFile, run_ids, run_path
from server.api.views import Problem, View

RunId = Annotated[str, Path(pattern=RUN_ID, description="as in the list of runs")]
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


def runs_router(folder: FilePath) -> APIRouter:
    """Routes /v1/runs and /v1/runs/{run_id}/mcap."""
    router = APIRouter(prefix="/v1/runs", tags=["runs"])

    @router.get("", response_model=list[RunView])
    async def list_runs(limit: Annotated[int, Query(ge=1, le=1000)] = 100) -> list[RunView]:
        """All recordings, newest first."""
        return await asyncio.to_thread(_views, folder, limit)

    @router.get("/{run_id}/mcap", response_model=None, response_class=FileResponse, responses=FILE)
    async def run_mcap(run_id: RunId) -> FileResponse | JSONResponse:
        """The MCAP file; `Range: bytes=...` returns a part of it, so that an interrupted download can resume.

        A recording that is being written is returned as far as it exists.
        """
        path = await asyncio.to_thread(run_path, folder, run_id)
        if path is None:
            return problem(404, "Unknown run", f"no recording {run_id[:64]!r}", "unknown_run", "see GET /v1/runs")
        return GrowingFile(path, media_type="application/octet-stream", filename=path.name)

    return router


def _views(folder: FilePath, limit: int) -> list[RunView]:
    views = []
    for run_id in run_ids(folder)[:limit]:
        path = run_path(folder, run_id)
        if path is not None:
            state = path.stat()
            views.append(RunView(run_id=run_id, bytes=state.st_size, changed_unix_s=round(state.st_mtime, 3)))
    return views
