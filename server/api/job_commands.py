"""Starts a job for a caller: key first, then control, then the job, its audit and its answer in one transaction."""

import asyncio
import json
import logging
import time
from dataclasses import dataclass

from recording.clock import mono_s
from server.access.errors import AccessError
from server.access.lease import Lease, LeaseKind
from server.access.roles import Caller
from server.api.hold_rule import mode_of, require_hold
from server.api.state_view import job_view
from server.errors import ServerError
from server.jobs.engine import Job, JobState
from server.jobs.keeper import Command
from server.jobs.service import JobBody, JobService
from server.link.errors import LinkError
from server.store.audit_rows import AuditEntry
from server.store.idempotency import KeyMissingError, StoredAnswer, hash_of, read_answer, replay_of

log = logging.getLogger(__name__)
HTTP_ACCEPTED = 202


# Which presses of STOP get a line of the audit: all that stop something, and one in ten seconds of those that do not.
#
# A stop itself is never folded. Every caller may send one, without a key and at any rate: a line for each would
# fill the disk, and the queue that jobs and control need.

STOP_AUDIT_PERIOD_S = 10.0
TRACKED_ADDRESSES_MAX = 256


class FoldedStops:
    """By address; bounded, the ones that were silent for longest go first."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[float, int]] = {}  # when a line was written, and presses since

    def to_write(self, address: str, now_s: float, matters: bool) -> int | None:
        """How many presses before this one have no line, if this one is to have one; None: it is counted only."""
        at_s, folded = self._last.pop(address, (-STOP_AUDIT_PERIOD_S, 0))
        if not matters and now_s - at_s < STOP_AUDIT_PERIOD_S:
            self._last[address] = at_s, folded + 1
            return None
        self._last[address] = now_s, 0
        if len(self._last) > TRACKED_ADDRESSES_MAX:
            del self._last[next(iter(self._last))]
        return folded


class ExpiredError(AccessError):
    """The command came later than its sender wanted it."""

    code = "expired"
    status = 409
    hint = "GET /v1/time returns this server's clock; send the command again if it is still needed"


@dataclass(frozen=True, slots=True)
class CommandHeaders:
    """What a request carried in addition to its body."""

    caller: Caller
    request_id: str
    idempotency_key: str
    lease_id: str
    fencing: int | None
    expires_unix_s: float = 0.0


class JobCommands:
    """Belongs to the event loop. Only accepted commands are kept under their key: a refusal moved nothing."""

    def __init__(self, service: JobService) -> None:
        self._service = service
        self._in_progress: set[tuple[str, str]] = set()
        self._stopping: set[asyncio.Future[None]] = set()
        self._stops = FoldedStops()

    async def start(self, body: JobBody, sent: CommandHeaders) -> StoredAnswer:
        """The answer to a command, the same one for every retry with its key.

        Raises: KeyMissingError, KeyReusedError, KeyInProgressError, refusals of control, of the service, of the store.
        """
        try:
            return await self._run_command_once(body, sent)
        except (ServerError, LinkError) as error:
            self._audit_refusal(body.kind, sent, getattr(error, "code", "link"))
            raise

    async def _run_command_once(self, body: JobBody, sent: CommandHeaders) -> StoredAnswer:
        if not sent.idempotency_key:
            return await self._carried_out(body, sent, "")
        mark, body_hash = (sent.caller.name, sent.idempotency_key), hash_of(body.model_dump_json().encode())
        mine = mark not in self._in_progress
        self._in_progress.add(mark)
        try:
            replay = replay_of(await self._stored_answer(*mark), not mine, body_hash)
            return replay if replay is not None else await self._carried_out(body, sent, body_hash)
        finally:
            if mine:
                self._in_progress.discard(mark)

    async def _stored_answer(self, who: str, key: str) -> StoredAnswer | None:
        keeper = self._service.keeper
        return None if keeper is None else await keeper.database.read_async(lambda db: read_answer(db, who, key))

    async def _carried_out(self, body: JobBody, sent: CommandHeaders, body_hash: str) -> StoredAnswer:
        if 0.0 < sent.expires_unix_s < time.time():
            raise ExpiredError(f"the command expired {time.time() - sent.expires_unix_s:.1f} s ago")
        lease = self._service.engine.leases.check(sent.lease_id, sent.fencing)
        _require_key(sent, lease)
        cell = self._service.cell
        require_hold(mode_of(cell.settings.mode, cell.link.latest), body, lease, sent.caller)
        kept: list[StoredAnswer] = []

        def answer(job: Job) -> StoredAnswer:
            kept.append(answer_of(job, body_hash))
            return kept[0]

        command = Command(sent.caller, sent.request_id, sent.idempotency_key, answer)
        job = await self._service.start(body, lease, command)
        return kept[0] if kept else answer_of(job, body_hash)

    def cancel(self, job: Job, caller: Caller, request_id: str) -> None:
        """Begin to stop a job; returns immediately, the job is `stopping` then."""
        self._write_audit_entry(caller, request_id, "job.cancel", job.job_id)
        stopping = asyncio.ensure_future(self._service.engine.stop(f"cancelled by {caller.name}", job))
        self._stopping.add(stopping)
        stopping.add_done_callback(self._stop_done)
        if job.state is JobState.RUNNING:
            job.state, job.reason = JobState.STOPPING, f"cancelled by {caller.name}"

    def stopped(self, caller: Caller, request_id: str) -> None:
        """A line about STOP, which itself waits for nothing."""
        job = self._service.engine.current
        running = job is not None and job.state is JobState.RUNNING
        folded = self._stops.to_write(caller.address, mono_s(), matters=running)
        if folded is not None:
            detail = f"and {folded} more since the last line" if folded else ""
            self._write_audit_entry(
                caller, request_id, "stop", job.job_id if job is not None and not job.has_ended else "", detail
            )

    def _stop_done(self, done: "asyncio.Future[None]") -> None:
        self._stopping.discard(done)
        if not done.cancelled() and (error := done.exception()) is not None:
            log.warning("stop was not confirmed: %s; the PLC ramps by its own watchdog", error)

    def _write_audit_entry(self, caller: Caller, request_id: str, action: str, job_id: str, detail: str = "") -> None:
        if self._service.keeper is not None:
            entry = AuditEntry(
                time.time(),
                caller.name,
                caller.role,
                caller.address,
                action,
                request_id=request_id,
                job_id=job_id,
                detail=detail,
            )
            self._service.keeper.queue_audit_line(entry)

    def _audit_refusal(self, kind: str, sent: CommandHeaders, code: str) -> None:
        keeper, held = self._service.keeper, self._service.engine.leases.held
        if keeper is not None:
            who = sent.caller
            owner, fencing = (held.owner, held.fencing) if held else ("", 0)
            entry = AuditEntry(time.time(), who.name, who.role, who.address, f"job.{kind}", code, owner, fencing)
            keeper.queue_audit_line(entry)


def _require_key(sent: CommandHeaders, lease: Lease) -> None:
    if not sent.idempotency_key and (sent.caller.role == "fleet" or lease.kind is LeaseKind.FLEET):
        raise KeyMissingError("a fleet's command carries an Idempotency-Key, so that a retry cannot move twice")


def answer_of(job: Job, body_hash: str) -> StoredAnswer:
    """202 with the job as it is now and its Location."""
    text = json.dumps(job_view(job).model_dump(mode="json"))
    return StoredAnswer(body_hash, HTTP_ACCEPTED, f"../v1/jobs/{job.job_id}", text)  # a proxy may have a path before it
