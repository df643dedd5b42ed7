"""Connections that open and then say nothing, or half a request for ever, are closed (slow clients hold no socket)."""

import asyncio

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

HEADER_S = 10.0  # a request's head is one packet; uvicorn itself closes idle connections after their first answer


class PatientH11Protocol(H11Protocol):
    """uvicorn's h11 protocol that looks every HEADER_S whether a request's head has been awaited all that time."""

    _watch: asyncio.TimerHandle | None = None
    _was_waiting = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to look."""
        super().connection_made(transport)
        self._was_waiting = True
        self._look_later()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop looking."""
        if self._watch is not None:
            self._watch.cancel()
        super().connection_lost(exc)

    def _look_later(self) -> None:
        self._watch = self.loop.call_later(HEADER_S, self._look)

    def _look(self) -> None:
        if self.transport.is_closing():
            return
        waiting = self.conn.their_state is h11.IDLE
        if waiting and self._was_waiting:
            self.transport.close()
            return
        self._was_waiting = waiting
        self._look_later()
