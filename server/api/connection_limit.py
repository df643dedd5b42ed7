"""How many connections there may be, so that a STOP always gets one: idle ones of the busiest address give way."""

import asyncio
import logging
import resource
import time
from collections import Counter
from collections.abc import Collection
from typing import Any

log = logging.getLogger(__name__)
BACKLOG = 64  # connections that asyncio accepts in one turn, each with its descriptor, before any of them is looked at
QUEUE = 1024  # connections that wait in the kernel, without a descriptor of ours: one more would come a second later
RESERVE = 128 + 4 * BACKLOG  # descriptors of our own (24 at rest; files, database, pipes), and of turns under way
CONNECTIONS_MIN = 16
CONNECTIONS_MAX = 4096  # a hundred panels with all their streams; each takes some 50 kB
LOG_PERIOD_S = 1.0


def most_connections(descriptors: int) -> int:
    """How many connections, with our own files, fit under a limit of descriptors (`ulimit -n`; -1: none)."""
    if descriptors == resource.RLIM_INFINITY:
        return CONNECTIONS_MAX
    return min(max(descriptors - RESERVE, descriptors // 4, CONNECTIONS_MIN), CONNECTIONS_MAX)


def one_to_close(connections: Collection[Any], limit: int) -> Any | None:
    """Of uvicorn's connections, HTTP and WebSocket, the one that gives way; None where there are not too many.

    Too many are more than `limit`, or of one address more than half of that. Of the address that has most: the one that
    is idle longest, else the one whose request is oldest, else any.
    """
    if len(connections) <= limit // 2:
        return None
    open_ones = [connection for connection in connections if not connection.transport.is_closing()]
    counts = Counter(_address(connection) for connection in open_ones)
    address, most = max(counts.items(), key=lambda item: item[1], default=("", 0))
    if len(open_ones) <= limit and most <= limit // 2:
        return None
    return min((connection for connection in open_ones if _address(connection) == address), key=_standing)


def _address(connection: Any) -> str:
    return connection.client[0] if connection.client else ""


def _standing(connection: Any) -> tuple[int, float]:
    """Idle before busy before a WebSocket, and the one that has been so longest first."""
    idle, since_s = getattr(connection, "idle", None), getattr(connection, "since_s", 0.0)
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
