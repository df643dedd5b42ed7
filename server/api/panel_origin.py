"""Who may open a socket: our own page, or a program that sends no Origin."""

from fastapi import WebSocket

from server.access.hosts import origin_allowed


def same_origin(socket: WebSocket) -> bool:
    """The guard's own rule, for sockets that are served without a guard."""
    return origin_allowed(socket.headers.get("origin"), socket.headers.get("host", ""))


async def accepted(socket: WebSocket) -> bool:
    """Open a socket for an allowed origin; it is closed for any other."""
    if not same_origin(socket):
        await socket.close(code=4403, reason="foreign origin")
        return False
    await socket.accept()
    return True
