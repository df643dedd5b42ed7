"""A camera that replays stored pictures over HTTP, to and fro so that the path never jumps; a process of its own."""

import asyncio
import multiprocessing
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import TracebackType
from typing import Self

import uvicorn

from longreach.processes import free_port
from recording.clock import mono_ns
from sim_plc.camera.frames import Frame, FrameHub
from sim_plc.camera.http_app import camera_app

_STOP_S = 4.0


def to_and_fro(n: int) -> Iterator[int]:
    """0, 1, ... n - 1, n - 2, ... 1, 0, 1, ...: no picture follows itself."""
    while True:
        yield from range(n - 1)
        yield from range(n - 1, 0, -1)


async def _replay(hub: FrameHub, pictures: Sequence[bytes], rate_hz: float) -> None:
    """Publish at absolute deadlines; stamps of the camera's own clock, one period apart."""
    period_ns = round(1e9 / rate_hz)
    start_ns = mono_ns()
    for number, index in enumerate(to_and_fro(len(pictures))):
        await asyncio.sleep(max(0.0, (start_ns + number * period_ns - mono_ns()) * 1e-9))
        hub.publish(Frame(pictures[index], number * period_ns, number))


async def _serve(pictures: Sequence[bytes], host: str, port: int, rate_hz: float) -> None:
    hub = FrameHub()
    config = uvicorn.Config(
        camera_app(hub, lambda: {"status": "ok"}, None),
        host=host,
        port=port,
        log_level="warning",
        lifespan="off",
        timeout_graceful_shutdown=1,
    )
    replay = asyncio.create_task(_replay(hub, pictures, rate_hz))
    try:
        await uvicorn.Server(config).serve()
    finally:
        replay.cancel()


def run_replay(files: Sequence[Path], host: str, port: int, rate_hz: float) -> None:
    """Serve until SIGTERM."""
    asyncio.run(_serve([file.read_bytes() for file in files], host, port, rate_hz))


class ReplayCamera(AbstractContextManager["ReplayCamera"]):
    """The process: started on entry, ended on exit."""

    def __init__(self, files: Sequence[Path], rate_hz: float, host: str = "127.0.0.1") -> None:
        port = free_port()
        self.url = f"http://{host}:{port}/stream"
        self._process: BaseProcess = multiprocessing.get_context("spawn").Process(
            target=run_replay, args=(tuple(files), host, port, rate_hz), name="replay-camera", daemon=True
        )

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid or 0

    def __enter__(self) -> Self:
        self._process.start()
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _tb: TracebackType | None
    ) -> None:
        self._process.terminate()
        self._process.join(_STOP_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
