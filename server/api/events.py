"""/v1/events: what happens to the whole machine, as server-sent events with ids; and what feeds it.

Plain StreamingResponse instead of fastapi.sse: each event is encoded once for all readers.
"""

import asyncio
from collections.abc import Callable
from typing import Annotated, Any

from fastapi import APIRouter, Header, Query
from fastapi.responses import JSONResponse, StreamingResponse

from server.api.event_log import EventLog
from server.api.fault_list import fault_views
from server.api.lease_views import control_view
from server.api.problems import problem
from server.api.state_cache import StateCache
from server.api.views import EVENT_STREAM, Problem
from server.jobs.engine import Job, JobEvent
from server.jobs.service import JobService

READERS_MAX = 200
WATCH_S = 0.2
STATE_EVERY = 5  # of WATCH_S: a state a second
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
            return problem(503, "Too many readers", f"{READERS_MAX} follow already", "too_many_readers", "try later")
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        return StreamingResponse(log.follow(last_event_id, state), media_type="text/event-stream", headers=headers)

    return router


class EventFeed:
    """Logs the events of the engine and of control; five times a second it also compares link and faults."""

    def __init__(self, service: JobService, log: EventLog, cache: StateCache) -> None:
        self._service, self._log, self._cache = service, log, cache
        self._seen: dict[str, Any] = {}
        service.engine.on_event(self._job)
        service.engine.leases.on_change(self._control)

    def _job(self, job: Job, event: JobEvent) -> None:
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
            if tick % STATE_EVERY == 0 and self._log.readers:
                self._log.show(self._cache.text())
            tick += 1
            await asyncio.sleep(WATCH_S)

    def _changed(self, kind: str, read: Callable[[], dict[str, Any]]) -> None:
        now = read()
        if self._seen.get(kind) != now:
            self._seen[kind] = now
            self._log.add(kind, now)
