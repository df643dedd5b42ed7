"""/v1/events: what happens to the whole machine, as server-sent events with ids; and what feeds it.

Plain StreamingResponse instead of fastapi.sse: each event is encoded once for all readers.
"""

import asyncio
import json
import time
from collections import deque
from collections.abc import AsyncIterator, Callable
from typing import Annotated, Any

from fastapi import APIRouter, Header, Query
from fastapi.responses import JSONResponse, StreamingResponse

from server.api.lease import control_view
from server.api.oversight import fault_views
from server.api.problems import problem_response
from server.api.state import StateCache
from server.api.views import EVENT_STREAM, Problem
from server.jobs.engine import Job, JobEvent
from server.jobs.service import JobService

# The machine's event log: numbered, kept for late readers, encoded once for all of them.

EVENTS_KEPT_MAX = 2000
KEEP_ALIVE_S = 10.0


class EventLog:
    """Belongs to the event loop. Ids are `<life>-<number>`: a reader of another life is notified of the gap."""

    def __init__(self, life: str) -> None:
        self.life, self.number = life, 0
        self.readers = 0
        self._kept: deque[tuple[int, str]] = deque(maxlen=EVENTS_KEPT_MAX)
        self._state, self._state_number = "", 0
        self._fresh = asyncio.Event()

    def add(self, kind: str, data: dict[str, Any]) -> None:
        """One event for everybody, now and later."""
        self.number += 1
        text = json.dumps({"t_unix_s": round(time.time(), 3), **data})
        self._kept.append((self.number, f"id: {self.life}-{self.number}\nevent: {kind}\ndata: {text}\n\n"))
        self._wake_waiters()

    def show_state(self, state_json: str) -> None:
        """The newest state: not kept, a reader gets the newest only."""
        self._state_number += 1
        self._state = f"event: state\ndata: {state_json}\n\n"
        self._wake_waiters()

    def _wake_waiters(self) -> None:
        self._fresh.set()
        self._fresh = asyncio.Event()

    def resume_position(self, last_id: str) -> tuple[int, str]:
        """Number to go on behind, and why something is missing (empty: nothing is)."""
        life, _, number = last_id.partition("-")
        oldest = self._kept[0][0] if self._kept else 1
        if not last_id:
            return self.number, ""
        if life != self.life or not number.isdecimal():
            return 0, "the server has restarted since that event"
        if int(number) + 1 < oldest:
            return 0, f"only the last {EVENTS_KEPT_MAX} events are kept"
        return min(int(number), self.number), ""

    async def follow_events(self, last_id: str, with_state: bool) -> AsyncIterator[str]:
        """Server-sent events behind `last_id`, for ever; without one from now on."""
        number, gap = self.resume_position(last_id)
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


READERS_MAX = 200
STATE_WATCH_PERIOD_S = 0.2
STATE_EVENT_INTERVAL_TICKS = 5  # of STATE_WATCH_PERIOD_S: a state a second
SSE: dict[int | str, dict[str, Any]] = {200: EVENT_STREAM, 503: {"model": Problem, "description": "too many readers"}}


def events_router(log: EventLog) -> APIRouter:
    """Route /v1/events."""
    router = APIRouter(prefix="/v1/events", tags=["events"])

    @router.get("", response_model=None, response_class=StreamingResponse, responses=SSE)
    async def follow_events(
        last_event_id: Annotated[str, Header(max_length=64)] = "",
        state: Annotated[bool, Query(description="also the state, once a second")] = True,
    ) -> StreamingResponse | JSONResponse:
        """Events `job`, `control`, `link`, `fault`, and `state`; resumes after Last-Event-ID and reports a `gap`."""
        if log.readers >= READERS_MAX:
            return problem_response(
                503, "Too many readers", f"{READERS_MAX} follow already", "too_many_readers", "try later"
            )
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        return StreamingResponse(
            log.follow_events(last_event_id, state), media_type="text/event-stream", headers=headers
        )

    return router


class EventFeed:
    """Logs the events of the engine and of control; five times a second it also compares link and faults."""

    def __init__(self, service: JobService, log: EventLog, cache: StateCache) -> None:
        self._service, self._log, self._cache = service, log, cache
        self._seen: dict[str, Any] = {}
        service.engine.on_event(self._log_job_event)
        service.engine.leases.on_change(self._control)

    def _log_job_event(self, job: Job, event: JobEvent) -> None:
        payload = {"job_id": job.job_id, "kind": job.kind, "owner": job.owner, "state": job.state.value}
        self._log.add("job", payload | {"name": event.name, "number": event.number, "text": event.text})

    def _control(self) -> None:
        self._log.add("control", control_view(self._service.engine.leases).model_dump(mode="json"))

    async def run(self) -> None:
        """Until cancelled."""
        tick = 0
        while True:
            self._changed("link", lambda: {"phase": self._service.cell.link.health.phase.value})
            self._changed("fault", lambda: {"faults": [view.fault_id for view in fault_views(self._service)]})
            if tick % STATE_EVENT_INTERVAL_TICKS == 0 and self._log.readers:
                self._log.show_state(self._cache.fresh_text())
            tick += 1
            await asyncio.sleep(STATE_WATCH_PERIOD_S)

    def _changed(self, kind: str, read: Callable[[], dict[str, Any]]) -> None:
        now = read()
        if self._seen.get(kind) != now:
            self._seen[kind] = now
            self._log.add(kind, now)
