"""Connections that open and then say nothing, or half a request for ever, are closed (slow clients hold no socket)."""

import asyncio

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

HEADER_S = 10.0  # a request's head is one packet; uvicorn itself closes idle connections after their first answer


class PatientH11Protocol(H11Protocol):
    """uvicorn's h11 protocol that looks every HEADER_S whether one request's head has been awaited all that time.

    A kept-alive connection that asks steadily awaits a head at nearly every look, but each time another one.
    """

    _watch: asyncio.TimerHandle | None = None
    _awaited: int | None = None  # number of the request whose head was awaited at the last look
    _answered = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to look."""
        super().connection_made(transport)
        self._awaited = self._answered
        self._look_later()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop looking."""
        if self._watch is not None:
            self._watch.cancel()
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """Count: the next head is another one."""
        self._answered += 1
        super().on_response_complete()

    def _look_later(self) -> None:
        self._watch = self.loop.call_later(HEADER_S, self._look)

    def _look(self) -> None:
        if self.transport.is_closing():
            return
        awaited = self._answered if self.conn.their_state is h11.IDLE else None
        if awaited is not None and awaited == self._awaited:
            self.transport.close()
            return
        self._awaited = awaited
        self._look_later()
