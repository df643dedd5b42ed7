"""The clients, in a process of their own: readers of /v1/events, and questions for the state at an even rate.

Open loop: a question is due at its time whether or not the one before was answered, and its latency counts from there,
so that a server which stands still is charged for every question that waited.
"""

import asyncio
import multiprocessing
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection as Pipe
from typing import Self, cast

from benchmarks.server.load.http_client import AnswerError, Connection

CONNECTIONS = 16  # kept alive for the questions
DRAIN_S = 5.0
_BROKEN = (OSError, EOFError, AnswerError)


@dataclass(frozen=True, slots=True)
class Demand:
    """What the clients do. `rate_hz` 0: no questions."""

    port: int
    readers: int
    rate_hz: float
    seconds: float
    host: str = "127.0.0.1"


@dataclass(slots=True)
class Seen:
    """What they saw. Latencies from the due time; -1 stands for a question that was never answered."""

    latencies_us: list[int] = field(default_factory=list)
    statuses: dict[int, int] = field(default_factory=dict)
    broken: int = 0
    late_start_max_us: int = 0  # how late this process itself began a question: its own share of what it measures
    events: int = 0
    event_bytes: int = 0
    readers_at_end: int = 0
    reader_events_min: int = 0
    cpu_s: float = 0.0  # of this process: what clients elsewhere would not take from the machine that is measured


async def demand(asked: Demand) -> Seen:
    """Do it; returns after `seconds` and at most DRAIN_S."""
    seen, counts = Seen(), [0] * asked.readers
    reading = [asyncio.create_task(_read(asked, seen, counts, number)) for number in range(asked.readers)]
    try:
        await _questions(asked, seen)
    finally:
        seen.readers_at_end = sum(not task.done() for task in reading)
        for task in reading:
            task.cancel()
        await asyncio.gather(*reading, return_exceptions=True)
    seen.events, seen.reader_events_min = sum(counts), min(counts, default=0)
    return seen


async def _read(asked: Demand, seen: Seen, counts: list[int], number: int) -> None:
    """One reader of /v1/events, until cancelled; one that breaks stays broken, so that it shows."""
    connection = await Connection.opened(asked.host, asked.port)
    try:
        async for line in connection.stream("/v1/events"):
            seen.event_bytes += len(line)
            counts[number] += line.startswith(b"event: ")
    except _BROKEN:
        seen.broken += 1
    finally:
        connection.close()


async def _questions(asked: Demand, seen: Seen) -> None:
    if asked.rate_hz <= 0.0:
        return await asyncio.sleep(asked.seconds)
    free: asyncio.Queue[Connection | None] = asyncio.Queue()
    for _ in range(CONNECTIONS):
        free.put_nowait(None)
    n, start_s = round(asked.seconds * asked.rate_hz), time.monotonic()
    asking: set[asyncio.Task[None]] = set()
    for number in range(n):
        due_s = start_s + number / asked.rate_hz
        await asyncio.sleep(max(0.0, due_s - time.monotonic()))
        seen.late_start_max_us = max(seen.late_start_max_us, round((time.monotonic() - due_s) * 1e6))
        task = asyncio.create_task(_ask(asked, seen, free, due_s))
        asking.add(task)
        task.add_done_callback(asking.discard)
    if asking:
        await asyncio.wait(asking, timeout=DRAIN_S)
    for task in asking:
        task.cancel()
    seen.latencies_us += [-1] * (n - len(seen.latencies_us))
    while not free.empty():
        if (connection := free.get_nowait()) is not None:
            connection.close()


async def _ask(asked: Demand, seen: Seen, free: "asyncio.Queue[Connection | None]", due_s: float) -> None:
    connection = await free.get()
    try:
        if connection is None:
            connection = await Connection.opened(asked.host, asked.port)
        answer = await connection.get("/v1/state")
        seen.latencies_us.append(round((time.monotonic() - due_s) * 1e6))
        seen.statuses[answer.status] = seen.statuses.get(answer.status, 0) + 1
    except _BROKEN:
        seen.broken += 1
        connection = None
    finally:
        free.put_nowait(connection)


def _run(pipe: Pipe, asked: Demand) -> None:
    """Entry point of the process."""
    pipe.send("ready")
    pipe.recv()
    before_s, seen = time.process_time(), asyncio.run(demand(asked))
    seen.cpu_s = time.process_time() - before_s
    pipe.send(seen)


class ClientProcess:
    """The same in a process of its own, which has begun and imported everything before anything is measured."""

    def __init__(self, asked: Demand) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = cast("tuple[Pipe, Pipe]", context.Pipe())
        self._process = context.Process(target=_run, args=(theirs, asked), name="load-clients", daemon=True)
        self._process.start()
        theirs.close()

    def __enter__(self) -> Self:
        """Wait until it is ready. Raises: EOFError: the process ended without a word."""
        self._pipe.recv()
        return self

    def __exit__(self, *_exc: object) -> None:
        """End it."""
        self._process.join(5.0)
        if self._process.is_alive():
            self._process.kill()
        self._pipe.close()

    def demand(self, meanwhile: Callable[[], None]) -> Seen:
        """Do it; `meanwhile` is called about twice a second. Raises: EOFError: the process ended without a word."""
        self._pipe.send("go")
        while not self._pipe.poll(0.5):
            meanwhile()
        return cast("Seen", self._pipe.recv())
