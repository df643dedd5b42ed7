"""STOP over a socket that is open already: a browser sends no seventh request to a host while six have no answer."""

import contextlib

from fastapi import APIRouter, WebSocket, WebSocketDisconnect

from server.api.callers import caller_of
from server.api.job_commands import JobCommands
from server.api.panel_origin import accepted
from server.errors import ServerError
from server.jobs.service import JobService
from server.link.errors import LinkError

STOPPED, NOT_CONFIRMED = "stopped", "not confirmed"


def stop_line_router(service: JobService, commands: JobCommands) -> APIRouter:
    """Socket /v1/stop: whatever the page says stops, and is answered when it has; POST /v1/stop is the same."""
    router = APIRouter()

    @router.websocket("/stop")
    async def line(socket: WebSocket) -> None:
        if not await accepted(socket):
            return
        with contextlib.suppress(WebSocketDisconnect):
            while (await socket.receive())["type"] != "websocket.disconnect":
                commands.stopped(caller_of(socket), "")
                await socket.send_text(await _stopped(service))

    return router


async def _stopped(service: JobService) -> str:
    try:
        await service.engine.stop("stopped in the panel")
    except (ServerError, LinkError):
        return NOT_CONFIRMED
    return STOPPED
