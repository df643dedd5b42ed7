"""The server's end: the motion is ended before a port is closed or a reader waited for."""

import asyncio
import contextlib
from collections.abc import AsyncIterator

import httpx
import pytest
from fastapi import FastAPI
from fastapi.responses import StreamingResponse

from longreach.processes import free_port
from server import app as module
from server.app import StoppingServer, config_of
from server.settings import HttpSettings


def served() -> FastAPI:
    app = FastAPI()

    @app.get("/stop")
    async def stop() -> str:
        return "stopped"

    @app.get("/events")
    async def events() -> StreamingResponse:
        async def endless() -> AsyncIterator[bytes]:
            while True:
                yield b"data: x\n\n"
                await asyncio.sleep(0.01)

        return StreamingResponse(endless())

    return app


async def read(url: str, order: list[str]) -> None:
    """Endlessly, until it is cut off."""
    with contextlib.suppress(httpx.HTTPError):
        async with httpx.AsyncClient() as reader, reader.stream("GET", f"{url}/events") as events:
            async for _ in events.aiter_bytes():
                order.append("read")


@pytest.mark.parametrize("way", ["stops", "fails", "hangs"])
async def test_motion_ends_first_while_every_caller_is_answered(way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "STOP_S", 0.5)
    port, order = free_port(), []
    url = f"http://127.0.0.1:{port}"

    async def stop_motion() -> None:
        async with httpx.AsyncClient() as late:
            order.append((await late.get(f"{url}/stop")).json())
        if way == "fails":
            raise OSError("the link is gone")
        if way == "hangs":
            await asyncio.sleep(60.0)

    config = config_of(served(), HttpSettings(port=port))
    config.timeout_graceful_shutdown = 1
    server = StoppingServer(config, stop_motion)
    serving = asyncio.create_task(server.serve())
    while not server.started:  # noqa: ASYNC110 uvicorn says it by a flag only
        await asyncio.sleep(0.01)
    reading = asyncio.create_task(read(url, order))
    while "read" not in order:  # noqa: ASYNC110 as above
        await asyncio.sleep(0.01)
    server.should_exit = True
    async with asyncio.timeout(20.0):
        await serving
        await reading
    await asyncio.sleep(0.1)  # so that uvicorn's transports are closed before their loop is
    stopped = order.index("stopped")
    assert "read" in order[stopped:]  # the reader that nobody waits for was there all the time
