"""Connections that say nothing, or a head without end, are closed, and idle ones where there are too many."""

import asyncio
import resource
import time

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from server.api.connection_limit import most_connections, one_to_close

HEADER_S = 10.0  # a request's head is one packet; uvicorn itself closes idle connections after their first answer
HEAD_MAX = 64 * 1024  # the parser itself keeps whatever comes


class PatientProtocol(HttpToolsProtocol):
    """uvicorn's protocol that looks every HEADER_S whether one request's head has been awaited all that time.

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
        if self._head_bytes > HEAD_MAX and self._awaits_head and not self.transport.is_closing():
            self.send_400_response(f"The head is longer than {HEAD_MAX} bytes.")

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
    def idle(self) -> bool:
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
        self._watch = self.loop.call_later(HEADER_S, self._look)

    def _look_no_more(self) -> None:
        if self._watch is not None:
            self._watch.cancel()

    def _look(self) -> None:
        if self.transport.is_closing():
            return
        awaited = self._answered if self._awaits_head else None
        if awaited is not None and awaited == self._awaited:
            self.transport.close()
            return
        self._awaited = awaited
        self._look_later()
