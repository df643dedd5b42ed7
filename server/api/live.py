"""The live channel: the state ten times a second over a WebSocket, made once for all who look."""

import asyncio
import contextlib
import json
import logging

from fastapi import APIRouter, WebSocket

from server.api.callers import accept_socket
from server.api.panel_memory import PanelMemory

log = logging.getLogger(__name__)

STATE_PERIOD_S = 0.1
MESSAGES_IN_FLIGHT_MAX = 2


class LiveFeed:
    """The newest state as text. Runs as one task; alarms are latched here also while no page is open."""

    def __init__(self, memory: PanelMemory) -> None:
        self._memory = memory
        self._text = ""
        self._fresh = asyncio.Event()

    async def run(self) -> None:
        """Until cancelled."""
        while True:
            self._tick()
            await asyncio.sleep(STATE_PERIOD_S)

    def _tick(self) -> None:
        try:
            view = self._memory.live_message()
        except Exception:  # a defect in the view: the page says that nothing is current, and the next tick tries again
            log.exception("the live state could not be built")
            return
        self._text = view.model_dump_json() if self._memory.n_viewers else ""
        self._fresh.set()
        self._fresh = asyncio.Event()

    async def next_state(self) -> str:
        """The next state, as soon as there is one."""
        while True:
            await self._fresh.wait()
            if self._text:
                return self._text


def live_router(memory: PanelMemory, feed: LiveFeed) -> APIRouter:
    """Route /v1/live: text frames hold LiveView JSON; the page answers each with {"seen": true}.

    {"scrub": 0..1} requests a place on the previewed path in the 3D view.

    Two states may be under way: a page that is slow misses some, and never shows what has waited in a queue for it.
    """
    router = APIRouter()

    @router.websocket("/v1/live")
    async def live(socket: WebSocket) -> None:
        if not await accept_socket(socket):
            return
        memory.n_viewers += 1
        room = asyncio.Semaphore(MESSAGES_IN_FLIGHT_MAX)
        tasks = [
            asyncio.create_task(_send(socket, feed, room)),
            asyncio.create_task(_receive_viewer_messages(socket, memory, room)),
        ]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            memory.n_viewers -= 1
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    return router


async def _send(socket: WebSocket, feed: LiveFeed, room: asyncio.Semaphore) -> None:
    while True:
        await room.acquire()
        await socket.send_text(await feed.next_state())


async def _receive_viewer_messages(socket: WebSocket, memory: PanelMemory, room: asyncio.Semaphore) -> None:
    """Acknowledgements and requests about the view only; unknown messages are ignored."""
    while True:
        with contextlib.suppress(ValueError, TypeError, AttributeError):
            said = json.loads(await socket.receive_text())
            if said.get("seen"):
                room.release()
            if (frac := said.get("scrub")) is not None:
                memory.scrub(float(frac))
