"""The server's end: the motion is ended before a port is closed or a reader waited for."""

import asyncio
import contextlib
import signal
import socket
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
    monkeypatch.setattr(module, "JOB_END_TIMEOUT_S", 5.0 if way == "hangs" else 60.0)  # a loaded computer is slow
    port, order = free_port(), []
    url = f"http://127.0.0.1:{port}"

    async def stop_motion() -> None:
        async with httpx.AsyncClient() as late:
            order.append((await late.get(f"{url}/stop")).json())
        if way == "fails":
            raise OSError("the link is gone")
        if way == "hangs":
            await asyncio.sleep(60.0)

    app = served()
    app.state.stop_motion = stop_motion
    config = config_of(app, HttpSettings(port=port))
    config.timeout_graceful_shutdown = 1
    server = StoppingServer(config, app)
    serving = asyncio.create_task(server.run_to_the_end())
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


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
async def test_a_signal_during_the_start_ends_what_was_started_and_waits_for_no_compiler(number: int) -> None:
    order, started = [], asyncio.Event()

    @contextlib.asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        try:
            started.set()
            await asyncio.Event().wait()  # a compiler that takes minutes
            yield
        finally:
            order.append("what was started is ended")

    app = FastAPI(lifespan=lifespan)
    app.state.stop_motion = order.append
    server = StoppingServer(config_of(app, HttpSettings(port=free_port())), app, lambda: order.append("listening"))
    before = signal.getsignal(number)
    serving = asyncio.create_task(server.run_to_the_end())
    async with asyncio.timeout(20.0):
        await started.wait()
        signal.raise_signal(number)
        signal.raise_signal(number)  # the impatient end nothing sooner
        await serving
    assert order == ["what was started is ended"]
    assert signal.getsignal(number) is before


async def test_it_is_announced_when_it_listens_and_never_before() -> None:
    port, order = free_port(), []
    app = served()

    async def stop_motion() -> None:
        order.append("motion ended")

    def listening() -> None:
        with socket.create_connection(("127.0.0.1", port), 5.0):
            order.append("connected")
        server.should_exit = True

    app.state.stop_motion = stop_motion
    server = StoppingServer(config_of(app, HttpSettings(port=port)), app, listening)
    async with asyncio.timeout(20.0):
        await server.run_to_the_end()
    assert order == ["connected", "motion ended"]
