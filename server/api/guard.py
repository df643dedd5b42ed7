"""The guard in front of the application, for HTTP and WebSocket: request id, who is calling, size and patience."""

import asyncio
import contextlib
import logging
import re
from collections.abc import Callable
from http.cookies import CookieError, SimpleCookie
from uuid import uuid4

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from recording.clock import mono_s
from server.access.errors import AccessError
from server.access.gatekeeper import Credentials, Gatekeeper, KeyRequiredError
from server.access.roles import SAFE_METHODS
from server.access.sessions import SESSION_COOKIE_NAME
from server.api.problems import problem_of

# Connections that last: each goes on only while its caller would be admitted still (key, session, role).

ACCESS_CHECK_PERIOD_S = 0.4  # with the key file's period (server/access/keys.py): out of force within a second
UNAUTHORIZED_CLOSE = {"type": "websocket.close", "code": 4401, "reason": "unauthorized"}
UNAUTHORIZED_DISCONNECT = {"type": "websocket.disconnect", "code": 4401, "reason": "unauthorized"}
ACCESS_ENDED_REASON = "the key is no longer valid, or the session has ended"
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
            timer = loop.call_later(ACCESS_CHECK_PERIOD_S, look)
        else:
            patience.reschedule(loop.time())

    timer = loop.call_later(ACCESS_CHECK_PERIOD_S, look)
    try:
        async with patience:
            await app(scope, receive, sending)
    except TimeoutError:
        if not patience.expired():
            raise
        if not begun:
            raise KeyRequiredError(ACCESS_ENDED_REASON) from None
        with contextlib.suppress(RuntimeError):  # a file's length was promised: the connection is dropped instead
            await send({"type": "http.response.body", "body": b"", "more_body": False})
    finally:
        timer.cancel()


async def socket_while(still: StillAdmitted, app: ASGIApp, scope: Scope, receive: Receive, send: Send) -> None:
    """A WebSocket. Its end looks to the route like any other: nothing is cancelled amid a start or a stop."""
    over = asyncio.Event()

    async def receiving() -> Message:
        message = await receive()
        return UNAUTHORIZED_DISCONNECT if over.is_set() else message

    async def sending(message: Message) -> None:
        if over.is_set():
            raise OSError(ACCESS_ENDED_REASON)  # for starlette the other end is gone
        await send(message)

    async def watch() -> None:
        while still():  # noqa: ASYNC110 a changed key file sends no notification
            await asyncio.sleep(ACCESS_CHECK_PERIOD_S)
        over.set()
        await send(UNAUTHORIZED_CLOSE)

    watching = asyncio.create_task(watch(), name="admission")
    try:
        await app(scope, receiving, sending)
    finally:
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)


log = logging.getLogger(__name__)
REQUEST_BODY_MAX_BYTES = 64 * 1024  # the longest command is 300 bytes
REQUEST_BODY_TIMEOUT_S = 10.0  # a body that comes slower is given up
REQUEST_ID_PATTERN = re.compile(r"[A-Za-z0-9._-]{1,64}")
SECURE_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class BodyTooLargeError(AccessError):
    """More than any command needs."""

    code = "body_too_large"
    status = 413
    hint = "a command has at most a few hundred bytes"


class SlowBodyError(AccessError):
    """A body that does not arrive."""

    code = "slow_body"
    status = 408
    hint = "send the body with its request"


class Guard:
    """ASGI middleware."""

    def __init__(self, app: ASGIApp, gatekeeper: Gatekeeper) -> None:
        self._app, self._gatekeeper = app, gatekeeper

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One connection."""
        if scope["type"] not in ("http", "websocket"):
            return await self._app(scope, receive, send)
        headers = Headers(scope=scope)
        request_id = _request_id(headers)
        try:
            scope.setdefault("state", {})["caller"] = self._gatekeeper.identify_caller(credentials_of(scope), mono_s())
            scope["state"]["request_id"] = request_id
            scope["state"]["admitted_still"] = self._admits_still(scope)
            if scope["type"] == "http":
                _check_length(headers)
                if "content-length" in headers or "transfer-encoding" in headers:  # without either no body can come
                    receive = (await _read_whole_body(receive)).receive
                send = _with_headers(send, request_id)
            await self._forward_while_admitted(scope, receive, send)
        except AccessError as error:
            await _send_refusal(error, scope, receive, send, request_id)

    async def _forward_while_admitted(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Through to the application; what may last, only while its caller is admitted."""
        if self._gatekeeper.open or (scope["type"] == "http" and scope["method"] not in SAFE_METHODS):
            return await self._app(scope, receive, send)
        carried = socket_while if scope["type"] == "websocket" else read_while
        await carried(scope["state"]["admitted_still"], self._app, scope, receive, send)

    def _admits_still(self, scope: Scope) -> Callable[[], bool]:
        asked = credentials_of(scope)
        return lambda: self._gatekeeper.admits_still(asked, mono_s())


class _BufferedBody:
    """A body that has arrived whole; after it, what the connection says next (its end)."""

    def __init__(self, body: bytes, receive: Receive) -> None:
        self._message: Message | None = {"type": "http.request", "body": body, "more_body": False}
        self._receive = receive

    async def receive(self) -> Message:
        message, self._message = self._message, None
        return message if message is not None else await self._receive()


async def _read_whole_body(receive: Receive) -> _BufferedBody:
    """The whole body. Raises: BodyTooLargeError, SlowBodyError."""
    parts, size = [], 0
    try:
        async with asyncio.timeout(REQUEST_BODY_TIMEOUT_S):
            while True:
                message = await receive()
                parts.append(message.get("body", b""))
                size += len(parts[-1])
                if size > REQUEST_BODY_MAX_BYTES:
                    raise BodyTooLargeError(f"the body is longer than {REQUEST_BODY_MAX_BYTES} bytes")
                if not message.get("more_body", False):
                    return _BufferedBody(b"".join(parts), receive)
    except TimeoutError:
        raise SlowBodyError(f"the body did not arrive within {REQUEST_BODY_TIMEOUT_S:.0f} s") from None


def credentials_of(scope: Scope) -> Credentials:
    """What a connection says about itself."""
    headers = Headers(scope=scope)
    kind, _, secret = headers.get("authorization", "").partition(" ")
    return Credentials(
        method="WEBSOCKET" if scope["type"] == "websocket" else scope["method"],
        path=scope["path"],
        address=scope["client"][0] if scope.get("client") else "",
        host=headers.get("host", ""),
        origin=headers.get("origin"),
        bearer=secret.strip() if kind.lower() == "bearer" else "",
        cookie=_session_cookie_value(headers.get("cookie", "")),
    )


def _session_cookie_value(header: str) -> str:
    try:
        morsel = SimpleCookie(header).get(SESSION_COOKIE_NAME)
    except CookieError:
        return ""
    return morsel.value if morsel is not None else ""


def _request_id(headers: Headers) -> str:
    given = headers.get("x-request-id", "")
    return given if REQUEST_ID_PATTERN.fullmatch(given) else uuid4().hex[:16]


def _check_length(headers: Headers) -> None:
    length = headers.get("content-length", "0")
    if length.isdecimal() and int(length[:20]) > REQUEST_BODY_MAX_BYTES:
        raise BodyTooLargeError(f"the body has {length[:20]} bytes (limit {REQUEST_BODY_MAX_BYTES})")


def _with_headers(send: Send, request_id: str) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers["X-Request-Id"] = request_id
            for name, value in SECURE_HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return sending


async def _send_refusal(error: AccessError, scope: Scope, receive: Receive, send: Send, request_id: str) -> None:
    log.info("refused %s (%s): %s", scope.get("method", "WEBSOCKET"), request_id, error.code)
    if scope["type"] == "websocket":
        return await send({"type": "websocket.close", "code": 4403, "reason": error.code})
    answer = problem_of(error)
    if isinstance(error, KeyRequiredError):
        if scope["path"] == "/" and "text/html" in Headers(scope=scope).get("accept", ""):
            answer.status_code = 303
            answer.headers["Location"] = "login"  # a proxy may have put us under a path of its own
        answer.headers["WWW-Authenticate"] = "Bearer"
    if error.status in (408, 413):
        answer.headers["Connection"] = "close"
    await answer(scope, receive, _with_headers(send, request_id))
