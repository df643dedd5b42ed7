"""The live channel: the state ten times a second, and the camera picture, over one WebSocket."""

import asyncio
import contextlib
from urllib.parse import urlsplit

from fastapi import APIRouter, WebSocket, WebSocketDisconnect

from server.api.state_view import state_view
from server.jobs.service import JobService

STATE_PERIOD_S = 0.1


def live_router(service: JobService) -> APIRouter:
    """Route /v1/live: text frames hold StateView JSON, binary frames the newest camera picture (JPEG)."""
    router = APIRouter()

    @router.websocket("/v1/live")
    async def live(socket: WebSocket) -> None:
        if not same_origin(socket):
            await socket.close(code=4403, reason="foreign origin")
            return
        await socket.accept()
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await _feed(socket, service)

    return router


async def _feed(socket: WebSocket, service: JobService) -> None:
    shown_ns = 0
    while True:
        view = state_view(service.cell, service.engine, service.context)
        await socket.send_text(view.model_dump_json())
        preview = service.cell.vision.latest_preview
        if preview is not None and preview[1] != shown_ns:
            shown_ns = preview[1]
            await socket.send_bytes(preview[0])
        await asyncio.sleep(STATE_PERIOD_S)


def same_origin(socket: WebSocket) -> bool:
    """Whether the socket was opened by our own page, or by a program that sends no Origin."""
    origin = socket.headers.get("origin")
    return origin is None or urlsplit(origin).netloc == socket.headers.get("host")
