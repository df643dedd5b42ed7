"""Connections that last: each goes on only while its caller would be admitted still (key, session, role).

What reads is cut off; a WebSocket is closed. A command that has been admitted is short, and is carried out.
"""

import asyncio
import contextlib
from collections.abc import Callable

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.access.gatekeeper import KeyRequiredError

CHECK_S = 0.4  # with the key file's period (server/access/keys.py): out of force within a second
CLOSE = {"type": "websocket.close", "code": 4401, "reason": "unauthorized"}
DISCONNECT = {"type": "websocket.disconnect", "code": 4401, "reason": "unauthorized"}
OVER = "the key is no longer valid, or the session has ended"
StillAdmitted = Callable[[], bool]


async def read_while(still: StillAdmitted, app: ASGIApp, scope: Scope, receive: Receive, send: Send) -> None:
    """A GET. A timer, no task: nearly all of them are over before it goes off.

    Raises: KeyRequiredError: no longer admitted before anything was answered.
    """
    loop, begun, patience = asyncio.get_running_loop(), False, asyncio.timeout(None)

    async def sending(message: Message) -> None:
        nonlocal begun
        begun = True
        await send(message)

    def look() -> None:
        nonlocal timer
        if still():
            timer = loop.call_later(CHECK_S, look)
        else:
            patience.reschedule(loop.time())

    timer = loop.call_later(CHECK_S, look)
    try:
        async with patience:
            await app(scope, receive, sending)
    except TimeoutError:
        if not patience.expired():
            raise
        if not begun:
            raise KeyRequiredError(OVER) from None
        with contextlib.suppress(RuntimeError):  # a file's length was promised: the connection is dropped instead
            await send({"type": "http.response.body", "body": b"", "more_body": False})
    finally:
        timer.cancel()


async def socket_while(still: StillAdmitted, app: ASGIApp, scope: Scope, receive: Receive, send: Send) -> None:
    """A WebSocket. Its end looks to the route like any other: nothing is cancelled amid a start or a stop."""
    over = asyncio.Event()

    async def receiving() -> Message:
        message = await receive()
        return DISCONNECT if over.is_set() else message

    async def sending(message: Message) -> None:
        if over.is_set():
            raise OSError(OVER)  # for starlette the other end is gone
        await send(message)

    async def watch() -> None:
        while still():  # noqa: ASYNC110 a changed key file sends no notification
            await asyncio.sleep(CHECK_S)
        over.set()
        await send(CLOSE)

    watching = asyncio.create_task(watch(), name="admission")
    try:
        await app(scope, receiving, sending)
    finally:
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)
