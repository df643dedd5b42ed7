"""The machine's event log: numbered, kept for late readers, encoded once for all of them."""

import asyncio
import json
import time
from collections import deque
from collections.abc import AsyncIterator
from typing import Any

KEPT = 2000
KEEP_ALIVE_S = 10.0


class EventLog:
    """Belongs to the event loop. Ids are `<life>-<number>`: a reader of another life is notified of the gap."""

    def __init__(self, life: str) -> None:
        self.life, self.number = life, 0
        self.readers = 0
        self._kept: deque[tuple[int, str]] = deque(maxlen=KEPT)
        self._state, self._state_number = "", 0
        self._fresh = asyncio.Event()

    def add(self, kind: str, data: dict[str, Any]) -> None:
        """One event for everybody, now and later."""
        self.number += 1
        text = json.dumps({"t_unix_s": round(time.time(), 3), **data})
        self._kept.append((self.number, f"id: {self.life}-{self.number}\nevent: {kind}\ndata: {text}\n\n"))
        self._wake()

    def show(self, state_json: str) -> None:
        """The newest state: not kept, a reader gets the newest only."""
        self._state_number += 1
        self._state = f"event: state\ndata: {state_json}\n\n"
        self._wake()

    def _wake(self) -> None:
        self._fresh.set()
        self._fresh = asyncio.Event()

    def after(self, last_id: str) -> tuple[int, str]:
        """Number to go on behind, and why something is missing (empty: nothing is)."""
        life, _, number = last_id.partition("-")
        oldest = self._kept[0][0] if self._kept else 1
        if not last_id:
            return self.number, ""
        if life != self.life or not number.isdecimal():
            return 0, "the server has restarted since that event"
        if int(number) + 1 < oldest:
            return 0, f"only the last {KEPT} events are kept"
        return min(int(number), self.number), ""

    async def follow(self, last_id: str, with_state: bool) -> AsyncIterator[str]:
        """Server-sent events behind `last_id`, for ever; without one from now on."""
        number, gap = self.after(last_id)
        self.readers += 1
        try:
            yield f"retry: 1000\nevent: hello\ndata: {json.dumps({'life': self.life, 'number': self.number})}\n\n"
            if gap:
                yield f"event: gap\ndata: {json.dumps({'reason': gap})}\n\n"
            shown = 0
            while True:
                fresh = self._fresh
                late = [text for kept, text in self._kept if kept > number] if number < self.number else []
                number = self.number
                if with_state and shown != self._state_number:
                    shown = self._state_number
                    late.append(self._state)
                if late:
                    yield "".join(late)
                    continue
                try:
                    async with asyncio.timeout(KEEP_ALIVE_S):
                        await fresh.wait()
                except TimeoutError:
                    yield ": still here\n\n"
        finally:
            self.readers -= 1
