"""Who may open a socket: our own page, or a program that sends no Origin."""

from urllib.parse import urlsplit

from fastapi import WebSocket


def same_origin(socket: WebSocket) -> bool:
    """Whether the socket was opened by our own page, or by a program that sends no Origin."""
    origin = socket.headers.get("origin")
    return origin is None or urlsplit(origin).netloc == socket.headers.get("host")
