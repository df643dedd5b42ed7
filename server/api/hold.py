"""Hold-to-run over a WebSocket of its own: press with a job, answer every challenge, let go and it ramps down.

Page: `{"press": {job}, "lease_id": "...", "fencing": n}`; then `{"seq", "reply", "bond"}` for each challenge; then
`{"release": "why"}`. Server: `{"held": job_id, "bond": "..."}` or `{"refused": "...", "code": "..."}`; `{"challenge":
{"seq", "nonce"}}` 25 times a second; `{"ended": state, "reason"}` when the button was let go, or need not be held any
more. A socket that closes is a button let go.
"""

import asyncio
import contextlib
import json
import logging
import secrets
import time
from typing import Annotated, Any

from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from recording.clock import mono_ns
from server.api.callers import accept_socket, caller_of, request_id_of
from server.api.hold_rule import mode_of, require_commissioned
from server.api.panel_memory import PanelMemory
from server.errors import ServerError
from server.jobs.engine import Job
from server.jobs.hold import HoldToRun
from server.jobs.keeper import Command
from server.jobs.request_bodies import ExecuteRequest
from server.jobs.service import JobBody, JobService
from server.link.errors import LinkError

log = logging.getLogger(__name__)

JOB_END_POLL_PERIOD_S = 0.05  # how soon the end of the job is seen
PRESS_MESSAGE_TIMEOUT_S = 5.0


class HoldStart(BaseModel):
    """The first message: what is to run while the button is down, and under whose control."""

    model_config = ConfigDict(extra="forbid")

    press: Annotated[JobBody, Field(discriminator="kind")]
    lease_id: str = Field(min_length=1, max_length=128)
    fencing: int = Field(ge=0, le=2**62)


class HoldReply(BaseModel):
    """An answer to a challenge."""

    model_config = ConfigDict(extra="forbid", strict=True)

    seq: int
    reply: int
    bond: str


class HoldRelease(BaseModel):
    """The button was let go, and what the page says it was."""

    model_config = ConfigDict(extra="forbid", strict=True)

    release: str = Field(max_length=200)


FROM_PAGE: TypeAdapter[HoldReply | HoldRelease] = TypeAdapter(HoldReply | HoldRelease)


def hold_router(service: JobService, memory: PanelMemory) -> APIRouter:
    """Route /v1/hold."""
    router = APIRouter()

    @router.websocket("/v1/hold")
    async def hold(socket: WebSocket) -> None:
        if not await accept_socket(socket):
            return
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await _serve_hold_to_run(socket, service, memory)
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await socket.close()

    return router


async def _serve_hold_to_run(socket: WebSocket, service: JobService, memory: PanelMemory) -> None:
    try:
        async with asyncio.timeout(PRESS_MESSAGE_TIMEOUT_S):
            text = await socket.receive_text()
        press = HoldStart.model_validate_json(text)
        lease = service.engine.leases.check(press.lease_id, press.fencing)
        cell = service.cell
        require_commissioned(mode_of(cell.settings.mode, cell.link.latest), press.press, cell.not_commissioned)
        job = await service.start(press.press, lease, Command(caller_of(socket), request_id_of(socket)))
    except (ServerError, LinkError) as error:
        return await _send(socket, refused=str(error), code=getattr(error, "code", "link"))
    except (ValidationError, TimeoutError) as error:
        return await _send(socket, refused=f"not a valid hold request: {error}"[:300], code="invalid_request")
    bond = press.press.plan_hash if isinstance(press.press, ExecuteRequest) else job.job_id
    held = HoldToRun(bond, lambda: secrets.randbits(32), mono_ns())
    memory.held_by = lease.owner
    try:
        await _supervise_hold_to_run(socket, service, memory, job, held, bond)
    finally:
        memory.held_by = ""


async def _supervise_hold_to_run(
    socket: WebSocket, service: JobService, memory: PanelMemory, job: Job, held: HoldToRun, bond: str
) -> None:
    """Until the job needs no hold any more or the button is up; then the stop comes first, words after it."""
    changed = asyncio.Event()
    hearing = asyncio.create_task(_receive_hold_replies(socket, service, held, changed))
    try:
        await service.engine.hold_until(held.dead_ns)
        await _send(socket, held=job.job_id, bond=bond)
        await _ask_until_over(socket, job, held, changed)
    finally:  # whatever ended it, a socket that broke or the server's own end: nothing may go on moving
        hearing.cancel()
        if _is_hold_needed(job):
            await _stop(service, memory, held.why_ended or "the page is disconnected")
        await asyncio.gather(hearing, return_exceptions=True)
        await service.engine.hold_until(None)
    await _send(socket, ended=job.state.value, reason=job.reason)


async def _ask_until_over(socket: WebSocket, job: Job, held: HoldToRun, changed: asyncio.Event) -> None:
    while _is_hold_needed(job):
        challenge = held.poll(mono_ns())
        if held.why_ended:
            return
        if challenge is not None:
            try:
                await _send(socket, challenge={"seq": challenge.seq, "nonce": challenge.nonce})
            except (WebSocketDisconnect, RuntimeError):
                return held.release("the page's socket closed")
        wait_s = min(JOB_END_POLL_PERIOD_S, max(0.0, (held.next_ns - mono_ns()) * 1e-9))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(wait_s):
                await changed.wait()
        changed.clear()


async def _receive_hold_replies(
    socket: WebSocket, service: JobService, held: HoldToRun, changed: asyncio.Event
) -> None:
    """Answers and the release; anything else, and the socket's end, is a button let go."""
    try:
        while not held.why_ended:
            match FROM_PAGE.validate_json(await socket.receive_text()):
                case HoldReply(seq=seq, reply=reply, bond=bond):
                    if held.answer(seq, reply, bond):
                        await service.engine.hold_until(held.dead_ns)
                case HoldRelease(release=why):
                    held.release(f"button up ({why})")
    except (WebSocketDisconnect, RuntimeError):
        held.release("the page's socket closed")
    except ValidationError:
        held.release("the page sent an invalid answer")
    changed.set()


def _is_hold_needed(job: Job) -> bool:
    """Whether the job may still move: an execute moves no more once it looks, anything else until its end."""
    looks = job.kind == "execute" and any(event.name == "look" for event in job.events)
    return not job.has_ended and not looks


async def _stop(service: JobService, memory: PanelMemory, why: str) -> None:
    if "silent" in why:
        memory.alarm_book.raise_event("hold_lost", why, time.time())
    try:
        await asyncio.shield(service.engine.stop(f"hold-to-run: {why}"))
    except LinkError as error:
        log.warning("stop was not confirmed: %s; the PLC ramps by its own watchdog", error)


async def _send(socket: WebSocket, **message: Any) -> None:
    await socket.send_text(json.dumps(message))
