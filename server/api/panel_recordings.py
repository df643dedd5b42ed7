"""Recordings for the page: list, download, and the replay of one finished run."""

import asyncio
import struct
import sys
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from fastapi import APIRouter
from fastapi.responses import FileResponse, JSONResponse, Response

from server.api.problems import problem_response
from server.api.runs import GrowingFile, run_path
from server.api.views import View
from server.jobs.service import JobService

LISTED_RECORDINGS_MAX = 100
REPLAY_READ_TIMEOUT_S = 60.0
FOXGLOVE_LAYOUT_FILE = files("recording") / "viewers" / "foxglove-layout.json"


class RecordingView(View):
    """One file."""

    name: str
    size_mb: float
    unix_s: float


@dataclass(slots=True)
class _OpenedReplay:
    """The one run that is being replayed."""

    name: str = ""
    file_size_and_mtime: tuple[int, int] = (0, 0)  # size and time of change: the run that is being recorded grows
    replay_json: bytes = b""
    jpeg_data: bytes = b""


def recordings_router(service: JobService) -> APIRouter:
    """Routes under /v1/panel/recordings."""
    router = APIRouter(prefix="/v1/panel/recordings", tags=["panel"])
    folder = Path(service.cell.settings.recording.folder)
    opened = _OpenedReplay()
    reading = asyncio.Lock()

    @router.get("", response_model=list[RecordingView])
    async def list_panel_recordings() -> list[RecordingView]:
        """All recordings with the panel's details, newest first."""
        return await asyncio.to_thread(_newest_recordings, folder)

    @router.get("/viewers/foxglove-layout", include_in_schema=False)
    async def layout() -> Response:
        """Foxglove layout for recordings of longreach."""
        name = {"Content-Disposition": "attachment; filename=longreach-foxglove-layout.json"}
        return Response(FOXGLOVE_LAYOUT_FILE.read_bytes(), media_type="application/json", headers=name)

    @router.get("/{name}/file", response_model=None)
    async def recording_file(name: str) -> FileResponse | JSONResponse:
        """The MCAP file: opens in Foxglove and Rerun."""
        path = _recording_path(folder, name)
        return (
            GrowingFile(path, media_type="application/octet-stream", filename=name)
            if path
            else _unknown_recording_response(name)
        )

    @router.get("/{name}/replay", response_model=None)
    async def recording_replay(name: str) -> Response:
        """Contents of a run over time, for the replay; read in a separate process."""
        path = _recording_path(folder, name)
        if path is None:
            return _unknown_recording_response(name)
        async with reading:
            stat = path.stat()
            version = (stat.st_size, stat.st_mtime_ns)
            if (opened.name, opened.file_size_and_mtime) != (name, version):
                code, out, error = await _read(path)
                if code != 0:
                    return problem_response(
                        409, "Not readable", error or f"reading ended with code {code}", "unreadable"
                    )
                (size,) = struct.unpack_from("<I", out)
                opened.name, opened.file_size_and_mtime = name, version
                opened.replay_json, opened.jpeg_data = out[4 : 4 + size], out[4 + size :]
        return Response(opened.replay_json, media_type="application/json")

    @router.get("/{name}/pictures/{start}-{end}", response_model=None)
    async def recording_picture(name: str, start: int, end: int) -> Response:
        """An image of the run whose replay was opened last."""
        if opened.name != name or not 0 <= start < end <= len(opened.jpeg_data):
            return problem_response(404, "Not opened", "open the replay of the run first", "not_opened")
        return Response(opened.jpeg_data[start:end], media_type="image/jpeg")

    return router


async def _read(path: Path) -> tuple[int | None, bytes, str]:
    pipe = asyncio.subprocess.PIPE
    command = (sys.executable, "-P", "-m", "server.api.panel_replay_reading", str(path))
    process = await asyncio.create_subprocess_exec(*command, stdout=pipe, stderr=pipe)
    try:
        async with asyncio.timeout(REPLAY_READ_TIMEOUT_S):
            out, error = await process.communicate()
    except TimeoutError:
        process.kill()
        await process.wait()
        return None, b"", f"reading took longer than {REPLAY_READ_TIMEOUT_S:.0f} s"
    return process.returncode, out, error.decode(errors="replace")[-300:]


def _newest_recordings(folder: Path) -> list[RecordingView]:
    try:
        found = [(path, path.stat()) for path in folder.glob("*.mcap") if run_path(folder, path.stem)]
    except OSError:
        return []
    newest = sorted(found, key=lambda one: -one[1].st_mtime)[:LISTED_RECORDINGS_MAX]
    return [
        RecordingView(name=path.name, size_mb=round(stat.st_size / 1e6, 1), unix_s=round(stat.st_mtime, 1))
        for path, stat in newest
    ]


def _recording_path(folder: Path, name: str) -> Path | None:
    """A recording by its file's name; nothing outside the folder can be named, or linked."""
    return run_path(folder, name.removesuffix(".mcap")) if name.endswith(".mcap") else None


def _unknown_recording_response(name: str) -> JSONResponse:
    return problem_response(404, "Unknown recording", f"there is no recording {name[:80]!r}", "unknown_recording")
