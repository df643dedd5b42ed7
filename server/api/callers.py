"""Who sent a request: set by the guard in front of the application, read by the routes that write the audit."""

from collections.abc import Callable

from fastapi import WebSocket
from starlette.requests import HTTPConnection

from server.access.hosts import origin_allowed
from server.access.roles import Caller


def caller_of(request: HTTPConnection) -> Caller:
    """The caller that the guard recognised; without a guard, the operator at this computer."""
    known = getattr(request.state, "caller", None)
    if isinstance(known, Caller):
        return known
    return Caller(address=request.client.host if request.client else "")


def admission_of(request: HTTPConnection) -> Callable[[], bool]:
    """Whether this caller would be admitted now; always, without a guard."""
    still: Callable[[], bool] | None = getattr(request.state, "admitted_still", None)
    return still or (lambda: True)


def request_id_of(request: HTTPConnection) -> str:
    """The id under which this request is found in log and audit."""
    return str(getattr(request.state, "request_id", ""))


# Who may open a socket: our own page, or a program that sends no Origin.


def same_origin(socket: WebSocket) -> bool:
    """The guard's own rule, for sockets that are served without a guard."""
    return origin_allowed(socket.headers.get("origin"), socket.headers.get("host", ""))


async def accept_socket(socket: WebSocket) -> bool:
    """Open a socket for an allowed origin; it is closed for any other."""
    if not same_origin(socket):
        await socket.close(code=4403, reason="foreign origin")
        return False
    await socket.accept()
    return True
