"""The camera picture for the page: encoded once a frame by the vision process, only ever the newest for a viewer.

One binary message a frame: length of the header (uint32, little endian), header (JSON), picture (JPEG). The header
holds what was found in that very picture, so that the overlay never belongs to another one. A viewer says "next" for
every frame it has drawn; two may be under way, so a slow one skips frames instead of falling behind.
"""

import asyncio
import contextlib
import struct

from fastapi import APIRouter, WebSocket, WebSocketDisconnect

from recording.clock import mono_ns
from server.api.panel_origin import accepted
from server.api.video_overlay import overlay_of
from server.camera.contracts import FrameReport
from server.jobs.service import JobService

UNDER_WAY_MAX = 2


class VideoHub:
    """The newest frame, and who waits for it. Belongs to one event loop."""

    def __init__(self, service: JobService) -> None:
        self._service = service
        self._arrived = asyncio.Event()
        self._number = 0
        self._message = b""
        self.viewers = 0
        service.cell.vision.on_report(self._take)

    def _take(self, report: FrameReport) -> None:
        """Packed once for all viewers; without viewers nothing is packed."""
        if report.preview_jpeg is None or self.viewers == 0:
            return
        age_ms = (mono_ns() - report.t_receive_mono_ns) * 1e-6
        header = overlay_of(self._service.cell, self._service.context, report, age_ms).model_dump_json().encode()
        self._message = struct.pack("<I", len(header)) + header + report.preview_jpeg
        self._number += 1
        self._arrived.set()
        self._arrived = asyncio.Event()

    async def after(self, number: int) -> tuple[int, bytes]:
        """The newest frame, as soon as there is one after that number."""
        while self._number <= number:
            await self._arrived.wait()
        return self._number, self._message

    @property
    def number(self) -> int:
        """Of the newest frame."""
        return self._number


def video_router(service: JobService) -> APIRouter:
    """Route /v1/video."""
    router = APIRouter()
    hub = VideoHub(service)

    @router.websocket("/v1/video")
    async def video(socket: WebSocket) -> None:
        if not await accepted(socket):
            return
        hub.viewers += 1
        try:
            with contextlib.suppress(WebSocketDisconnect, RuntimeError):
                await _show(socket, hub)
        finally:
            hub.viewers -= 1

    return router


async def _show(socket: WebSocket, hub: VideoHub) -> None:
    room = asyncio.Semaphore(UNDER_WAY_MAX)
    sending = asyncio.create_task(_send(socket, hub, room))
    drawn = asyncio.create_task(_count_drawn(socket, room))
    try:
        await asyncio.wait({sending, drawn}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in (sending, drawn):
            task.cancel()
        await asyncio.gather(sending, drawn, return_exceptions=True)


async def _send(socket: WebSocket, hub: VideoHub, room: asyncio.Semaphore) -> None:
    number = hub.number
    while True:
        await room.acquire()
        number, message = await hub.after(number)
        await socket.send_bytes(message)


async def _count_drawn(socket: WebSocket, room: asyncio.Semaphore) -> None:
    while True:
        await socket.receive_text()
        room.release()
