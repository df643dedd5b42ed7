"""Jobs over REST: one POST per kind of job, its state, and its story as server-sent events."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import APIRouter, Body, Depends, Header, Request, WebSocket, WebSocketDisconnect
from fastapi.responses import JSONResponse, Response, StreamingResponse

from recording.clock import mono_s
from server.api.callers import accept_socket, caller_of, request_id_of
from server.api.job_commands import CommandHeaders, JobCommands
from server.api.lease import FencingHeader, LeaseHeader, require_lease
from server.api.problems import problem_response
from server.api.state_view import job_view
from server.api.views import EVENT_STREAM, JobView, Problem
from server.errors import ServerError
from server.jobs.engine import Job
from server.jobs.service import JobBody, JobService
from server.link.errors import LinkError

# STOP over a socket that is open already: a browser sends no seventh request to a host while six have no answer.

STOPPED, NOT_CONFIRMED = "stopped", "not confirmed"


def stop_line_router(service: JobService, commands: JobCommands) -> APIRouter:
    """Socket /v1/stop: whatever the page says stops, and is answered when it has; POST /v1/stop is the same."""
    router = APIRouter()

    @router.websocket("/stop")
    async def line(socket: WebSocket) -> None:
        if not await accept_socket(socket):
            return
        with contextlib.suppress(WebSocketDisconnect):
            while (await socket.receive())["type"] != "websocket.disconnect":
                commands.stopped(caller_of(socket), "")
                await socket.send_text(await _stop_from_panel(service))

    return router


async def _stop_from_panel(service: JobService) -> str:
    try:
        await service.engine.stop("stopped in the panel")
    except (ServerError, LinkError):
        return NOT_CONFIRMED
    return STOPPED


AnyJobRequest = Annotated[JobBody, Body(discriminator="kind")]
KeyHeader = Annotated[
    str | None,
    Header(
        max_length=128, pattern=r"^[\x21-\x7e]+$", description="fresh per command, the same on a retry; fleets must"
    ),
]
ExpiresHeader = Annotated[
    float,
    Header(ge=0, le=1e11, description="unix seconds of this server (GET /v1/time) after which not to start; 0: never"),
]
STORY: dict[int | str, dict[str, Any]] = {200: EVENT_STREAM, 404: {"model": Problem}}
EVENT_POLL_S = 0.1


def jobs_router(service: JobService) -> APIRouter:
    """Routes under /v1/jobs and /v1/stop."""
    router = APIRouter(prefix="/v1", tags=["jobs"])
    refused: dict[int | str, dict[str, Any]] = {status: {"model": Problem} for status in (400, 403, 409, 422, 503)}
    cancelled: dict[int | str, dict[str, Any]] = {404: {"model": Problem}, 409: {"model": Problem}}
    control, commands = require_lease(service.engine.leases), JobCommands(service)

    router.include_router(stop_line_router(service, commands))

    @router.post("/jobs", status_code=202, response_model=JobView, responses=refused)
    async def start_job(
        body: AnyJobRequest,
        request: Request,
        longreach_lease: LeaseHeader = "",
        longreach_fencing: FencingHeader = 0,
        idempotency_key: KeyHeader = None,
        longreach_expires: ExpiresHeader = 0.0,
    ) -> Response:
        """Start a job; 202 with its Location, 409 when another one runs or a plan is refused."""
        sent = CommandHeaders(
            caller=caller_of(request),
            request_id=request_id_of(request),
            idempotency_key=idempotency_key or "",
            lease_id=longreach_lease,
            fencing=longreach_fencing,
            expires_unix_s=longreach_expires,
        )
        given = await commands.start(body, sent)
        return Response(given.response_body, given.http_status, {"Location": given.location}, "application/json")

    @router.get("/jobs", response_model=list[JobView])
    async def list_jobs() -> list[JobView]:
        """The last jobs, newest last, without their events."""
        return [job_view(job, events_from=10**9) for job in service.engine.jobs]

    @router.get("/jobs/{job_id}", response_model=JobView, responses={404: {"model": Problem}})
    async def read_job(job_id: str) -> JobView | JSONResponse:
        """A job with its events and, at its end, its result."""
        job = service.engine.find_job(job_id)
        return job_view(job) if job else _unknown_job_response(job_id)

    @router.get("/jobs/{job_id}/events", response_model=None, response_class=StreamingResponse, responses=STORY)
    async def follow_job(
        job_id: str, last_event_id: Annotated[str, Header(max_length=64)] = ""
    ) -> StreamingResponse | JSONResponse:
        """The events of a job as server-sent events; resumes after Last-Event-ID; ends with the job."""
        job = service.engine.find_job(job_id)
        if job is None:
            return _unknown_job_response(job_id)
        seen = int(last_event_id[:18]) if last_event_id.isdecimal() else 0
        return StreamingResponse(_job_event_stream(job, seen), media_type="text/event-stream")

    @router.post("/jobs/{job_id}/cancel", status_code=202, response_model=JobView, responses=cancelled)
    async def cancel(job_id: str, request: Request) -> Response:
        """Stop one job: its state is `stopping` until the machine stands still, then `stopped`. Needs no control."""
        job = service.engine.find_job(job_id)
        if job is None:
            return _unknown_job_response(job_id)
        if job.has_ended:
            return problem_response(
                409, "Job has ended", f"job {job_id} is {job.state.value}", "job_ended", "nothing to do"
            )
        commands.cancel(job, caller_of(request), request_id_of(request))
        return JSONResponse(job_view(job).model_dump(mode="json"), status_code=202)

    @router.post("/stop", response_model=JobView | None, responses={503: {"model": Problem}})
    async def stop(request: Request) -> JobView | None:
        """Stop motion (software) and the running job; from anyone, at any time."""
        commands.stopped(caller_of(request), request_id_of(request))
        await service.engine.stop("stopped over REST")
        return job_view(service.engine.current) if service.engine.current else None

    @router.post("/disarm", status_code=204, dependencies=[Depends(control)], responses=refused)
    async def disarm() -> None:
        """Leave the armed state."""
        await service.cell.link.disarm()

    @router.post("/reset", status_code=204, dependencies=[Depends(control)], responses=refused)
    async def reset() -> None:
        """Clear a latched PLC fault; never restarts motion."""
        await service.cell.link.reset()

    return router


async def _job_event_stream(job: Job, seen: int) -> AsyncIterator[str]:
    keep_alive = mono_s()
    while True:
        view = job_view(job, events_from=seen)
        for event in view.events:
            seen = event.number
            yield f"id: {event.number}\nevent: progress\ndata: {event.model_dump_json()}\n\n"
        if job.has_ended:
            yield f"event: end\ndata: {json.dumps(job_view(job).model_dump(mode='json'))}\n\n"
            return
        if mono_s() - keep_alive > 10.0:
            keep_alive = mono_s()
            yield ": still here\n\n"
        await asyncio.sleep(EVENT_POLL_S)


def _unknown_job_response(job_id: str) -> JSONResponse:
    return problem_response(404, "Unknown job", f"no job {job_id[:32]!r} among the last 200", "unknown_job")
