"""How many connections there may be, so that a STOP always gets one: idle ones of the busiest address give way."""

import asyncio
import logging
import resource
import time
from collections import Counter
from collections.abc import Collection
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

log = logging.getLogger(__name__)
# Connections that asyncio accepts in one turn, each with its descriptor, before any of them is looked at
ACCEPTS_PER_TURN_MAX = 64
# Connections that wait in the kernel, without a descriptor of ours: one more would come a second later
LISTEN_BACKLOG = 1024
RESERVED_DESCRIPTORS = (
    128 + 4 * ACCEPTS_PER_TURN_MAX
)  # descriptors of our own (24 at rest; files, database, pipes), and of turns under way
CONNECTIONS_MIN = 16
CONNECTIONS_MAX = 4096  # a hundred panels with all their streams; each takes some 50 kB
LOG_PERIOD_S = 1.0


def most_connections(descriptors: int) -> int:
    """How many connections, with our own files, fit under a limit of descriptors (`ulimit -n`; -1: none)."""
    if descriptors == resource.RLIM_INFINITY:
        return CONNECTIONS_MAX
    return min(max(descriptors - RESERVED_DESCRIPTORS, descriptors // 4, CONNECTIONS_MIN), CONNECTIONS_MAX)


def one_to_close(connections: Collection[Any], limit: int) -> Any | None:
    """Of uvicorn's connections, HTTP and WebSocket, the one that gives way; None where there are not too many.

    Too many are more than `limit`, or of one address more than half of that. Of the address that has most: the one that
    is idle longest, else the one whose request is oldest, else any.
    """
    if len(connections) <= limit // 2:
        return None
    open_ones = [connection for connection in connections if not connection.transport.is_closing()]
    counts = Counter(_client_address(connection) for connection in open_ones)
    address, most = max(counts.items(), key=lambda item: item[1], default=("", 0))
    if len(open_ones) <= limit and most <= limit // 2:
        return None
    return min(
        (connection for connection in open_ones if _client_address(connection) == address), key=_eviction_order_key
    )


def _client_address(connection: Any) -> str:
    return connection.client[0] if connection.client else ""


def _eviction_order_key(connection: Any) -> tuple[int, float]:
    """Idle before busy before a WebSocket, and the one that has been so longest first."""
    idle, since_s = getattr(connection, "is_idle", None), getattr(connection, "since_s", 0.0)
    return (2, 0.0) if idle is None else (0 if idle else 1, since_s)


class ExhaustionLog:
    """Handler of the event loop's errors: descriptors that are used up are one line a second, with what to do."""

    def __init__(self) -> None:
        self._said_s, self._unsaid = -LOG_PERIOD_S, 0

    def __call__(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """As asyncio's default handler, but for connections that could not be accepted."""
        error = context.get("exception")
        if not (isinstance(error, OSError) and "accept" in context.get("message", "")):
            return loop.default_exception_handler(context)
        self._unsaid += 1
        now_s = time.monotonic()
        if now_s - self._said_s >= LOG_PERIOD_S:
            log.error("%s connections were not accepted: %s; raise 'ulimit -n'", self._unsaid, error.strerror)
            self._said_s, self._unsaid = now_s, 0
        return None


# Connections that say nothing, or a head without end, are closed, and idle ones where there are too many.

# A request's head is one packet; uvicorn itself closes idle connections after their first answer
HTTP_HEAD_TIMEOUT_S = 10.0
HTTP_HEAD_MAX_BYTES = 64 * 1024  # the parser itself keeps whatever comes


class PatientProtocol(HttpToolsProtocol):
    """uvicorn's protocol that looks every HTTP_HEAD_TIMEOUT_S whether one request's head has been awaited all that
    time.

    A kept-alive connection that asks steadily awaits a head at nearly every look, but each time another one.
    """

    _watch: asyncio.TimerHandle | None = None
    _awaited: int | None = None  # number of the request whose head was awaited at the last look
    _answered = 0
    _head_bytes = 0
    since_s = 0.0  # idle, or working on a request, since then
    connections_max = most_connections(resource.getrlimit(resource.RLIMIT_NOFILE)[0])

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to look."""
        super().connection_made(transport)
        self.since_s = time.monotonic()
        self._make_room()
        self._awaited = self._answered
        self._look_later()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop looking."""
        self._look_no_more()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Read on, unless a head has become too long."""
        self._head_bytes += len(data)
        super().data_received(data)
        if self._head_bytes > HTTP_HEAD_MAX_BYTES and self._awaits_head and not self.transport.is_closing():
            self.send_400_response(f"The head is longer than {HTTP_HEAD_MAX_BYTES} bytes.")

    def on_headers_complete(self) -> None:
        """A head has come whole."""
        super().on_headers_complete()
        self._head_bytes, self.since_s = 0, time.monotonic()

    def on_response_complete(self) -> None:
        """Count: the next head is another one."""
        self._answered += 1
        self._head_bytes, self.since_s = 0, time.monotonic()
        super().on_response_complete()

    def handle_websocket_upgrade(self) -> None:
        """From here on the connection is the WebSocket's, which has its own pings."""
        self._look_no_more()
        super().handle_websocket_upgrade()

    @property
    def is_idle(self) -> bool:
        """Whether no request is under way."""
        return self._awaits_head

    def _make_room(self) -> None:
        surplus = one_to_close(self.connections, self.connections_max)
        if surplus is not None:
            surplus.transport.abort()  # not close: a client that reads nothing would hold its descriptor

    @property
    def _awaits_head(self) -> bool:
        return self.cycle is None or self.cycle.response_complete

    def _look_later(self) -> None:
        self._watch = self.loop.call_later(HTTP_HEAD_TIMEOUT_S, self._close_if_stalled)

    def _look_no_more(self) -> None:
        if self._watch is not None:
            self._watch.cancel()

    def _close_if_stalled(self) -> None:
        if self.transport.is_closing():
            return
        awaited = self._answered if self._awaits_head else None
        if awaited is not None and awaited == self._awaited:
            self.transport.close()
            return
        self._awaited = awaited
        self._look_later()
