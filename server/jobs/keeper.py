"""The keeper: what jobs, leases and findings leave on disk, and what the next life of the server finds there."""

import asyncio
import json
import logging
import sqlite3
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import asdict, dataclass
from typing import Any

from recording.clock import mono_ns, mono_s
from server.access.lease import Lease
from server.access.roles import Caller
from server.calibration.calibration_life import LocalCalibration
from server.jobs.cell import Cell
from server.jobs.engine import Job, JobEvent, JobState
from server.jobs.knowledge import PreviewedPlan
from server.store.audit_rows import (
    AuditEntry,
    add_audit,
    add_calibration,
    add_plan,
    forget_old_audit,
    read_fencing,
    read_operating_time,
    save_fencing,
    save_operating_time,
)
from server.store.database import Database, StoreError, Work
from server.store.idempotency import StoredAnswer, forget_answer, save_answer

# A command as the store keeps it: who sent it, with which key, and what they were answered.

SERVER_CALLER = Caller("server", "engineer", "")


@dataclass(frozen=True, slots=True)
class Command:
    """One request to start a job. `make_answer` makes the answer that a retry with the same key is given."""

    caller: Caller = SERVER_CALLER
    request_id: str = ""
    idempotency_key: str = ""
    make_answer: Callable[[Job], StoredAnswer] | None = None


SERVER_COMMAND = Command()  # of the server itself


@dataclass(frozen=True, slots=True)
class JobStartRows:
    """What one transaction writes before a job begins."""

    job: Job
    request_body: str
    audit_entry: AuditEntry
    idempotency_key: str
    stored_answer: StoredAnswer | None


def job_start_rows(job: Job, body: str, plan_hash: str, lease: Lease | None, command: Command) -> JobStartRows:
    """The rows of a job that is about to begin."""
    entry = AuditEntry(
        t_unix_s=time.time(),
        who=command.caller.name,
        role=command.caller.role,
        address=command.caller.address,
        action=f"job.{job.kind}",
        lease_owner=lease.owner if lease else "",
        fencing=job.fencing,
        request_id=command.request_id,
        idempotency_key=command.idempotency_key,
        plan_hash=plan_hash,
        job_id=job.job_id,
    )
    answered = command.make_answer(job) if command.make_answer is not None and command.idempotency_key else None
    return JobStartRows(job, body, entry, command.idempotency_key, answered)


log = logging.getLogger(__name__)
STORE_PROBE_PERIOD_S = 2.0
RESERVED_QUEUE_PLACES = 64  # places of the queue that jobs and control have for themselves


# Jobs on disk: a row before anything moves, its end when it ends, and an honest end after a crash.

LISTED_JOBS_MAX = 200  # jobs that the engine remembers
JOBS_KEPT_MAX = 10_000
INTERRUPTED_JOB_REASON = (
    "the server ended while this job ran (killed, crashed or without power); "
    "the PLC's watchdog ramped the machine down; arm and look again"
)


def add_job(db: sqlite3.Connection, job: Job, body: str) -> None:
    """The row of a job that is about to begin."""
    db.execute(
        "INSERT INTO jobs (job_id, kind, owner, fencing, body, state, started_unix_s) VALUES (?, ?, ?, ?, ?, ?, ?)",
        (job.job_id, job.kind, job.owner, job.fencing, body, job.state.value, job.started_unix_s),
    )


def end_job(db: sqlite3.Connection, job: Job, result: Any) -> None:
    """How it ended; `result` as JSON data."""
    db.execute(
        "UPDATE jobs SET state = ?, code = ?, reason = ?, elapsed_s = ?, result = ? WHERE job_id = ?",
        (job.state.value, job.code, job.reason, job.elapsed_s, json.dumps(result), job.job_id),
    )


def end_interrupted(db: sqlite3.Connection) -> list[str]:
    """Give every job without an end the end that it had: the server's own. Their ids."""
    open_states = (JobState.RUNNING.value, JobState.STOPPING.value)
    found = [row[0] for row in db.execute("SELECT job_id FROM jobs WHERE state IN (?, ?)", open_states)]
    db.execute(
        "UPDATE jobs SET state = ?, code = 'interrupted', reason = ? WHERE state IN (?, ?)",
        (JobState.INTERRUPTED.value, INTERRUPTED_JOB_REASON, *open_states),
    )
    db.execute("DELETE FROM jobs WHERE number <= (SELECT max(number) FROM jobs) - ?", (JOBS_KEPT_MAX,))
    return found


def read_jobs(db: sqlite3.Connection, limit: int = LISTED_JOBS_MAX) -> list[Job]:
    """The last jobs, oldest first."""
    rows = db.execute("SELECT * FROM jobs ORDER BY number DESC LIMIT ?", (limit,)).fetchall()
    return [_job_from_row(row) for row in reversed(rows)]


def _job_from_row(row: sqlite3.Row) -> Job:
    now = mono_s()
    job = Job(row["job_id"], row["kind"], row["owner"], JobState(row["state"]), row["reason"], row["code"])
    job.result = json.loads(row["result"]) if row["result"] else None
    job.fencing, job.started_unix_s = row["fencing"], row["started_unix_s"]
    job.started_mono_s, job.ended_mono_s = now - row["elapsed_s"], now
    return job


# The index of findings: what a job left that others ask for by REST, plans by hash and calibrations by number.


class Keeper:
    """Belongs to the event loop; the database has its thread. `result_of` makes JSON data of a job's result."""

    def __init__(
        self, database: Database, result_of: Callable[[Any], Any], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.database = database
        self._clock = clock
        self._zero_s = clock()  # when the operating-hours counter would have stood at zero, on that clock
        self._result_of = result_of
        self.plan_expiries_ns: dict[str, int] = {}  # by hash, of this life: a plan of an earlier one cannot be executed
        self._unsaved: dict[str, Job] = {}
        self._taken_up: Callable[[list[Job], int], None] = lambda _jobs, _fencing: None
        self._restored = False

    @property
    def why_not_storing(self) -> str:
        """Why nothing can be kept now, and so nothing may move; empty when all is well."""
        return self.database.problem

    # --- a new life -------------------------------------------------------------------------------------------------

    def on_restored(self, taken_up: Callable[[list[Job], int], None]) -> None:
        """Call with the last jobs, each with an honest end, and the highest fencing number, once they are read."""
        self._taken_up = taken_up

    def restore(self) -> None:
        """Read what the last life left; if that fails, `watch` tries again and nothing moves until then."""
        try:
            self._apply_stored_state(*self._read_stored_state())
        except StoreError as error:
            log.error("earlier jobs are not known yet: %s", error)

    def _read_stored_state(self) -> tuple[list[Job], int]:
        for job_id in self.database.write(end_interrupted):
            log.warning("job %s was interrupted: the server ended while it ran", job_id)
        self.database.write(forget_old_audit)
        self._zero_s = self._clock() - self.database.read(read_operating_time)
        return self.database.read(read_jobs), self.database.read(read_fencing)

    def _apply_stored_state(self, jobs: list[Job], fencing: int) -> None:
        self._taken_up(jobs, fencing)
        self._restored = True

    # --- commands: written before they are carried out or answered --------------------------------------------------

    async def begin(self, began: JobStartRows) -> None:
        """Job, audit and answer in one transaction. Raises: StoreError: nothing was written, nothing may begin."""
        self.check()

        def rows(db: sqlite3.Connection) -> None:
            add_job(db, began.job, began.request_body)
            save_fencing(db, began.job.fencing)
            add_audit(db, began.audit_entry)
            if began.stored_answer is not None:
                save_answer(db, began.audit_entry.who, began.idempotency_key, began.stored_answer)

        try:
            await self.database.write_async(rows)
        except StoreError:
            who, key = began.audit_entry.who, began.idempotency_key
            if began.stored_answer is not None:  # a disk that was late may write it all the same: the job was refused
                self.queue_write(lambda db: forget_answer(db, who, key))
            raise

    async def control(self, entry: AuditEntry) -> None:
        """A new holder of control: fencing number and audit in one transaction.

        Raises: StoreError: not written; the lease must not be given.
        """

        def rows(db: sqlite3.Connection) -> None:
            save_fencing(db, entry.fencing)
            add_audit(db, entry)

        await self.database.write_async(rows)

    def check(self) -> None:
        """Raises: StoreError: nothing can be written down now, so nothing may move."""
        if self.why_not_storing or not self._restored:
            raise StoreError(self.why_not_storing or "the database has not been read yet")

    # --- what may not wait for the disk -----------------------------------------------------------------------------

    def queue_audit_line(self, entry: AuditEntry) -> None:
        """A line about what happened already, or about a refusal: queued; a full queue is logged."""
        self.queue_write(lambda db: add_audit(db, entry))

    def queue_write(self, work: Work[Any]) -> None:
        """Queue a write whose failure is only logged."""
        try:
            self.database.submit(work, RESERVED_QUEUE_PLACES).add_done_callback(_log_write_error)
        except StoreError as error:
            log.error("not written: %s", error)

    def on_job_event(self, job: Job, event: JobEvent) -> None:
        """Listener of the engine: the end of a job, tried again until it is on disk."""
        if event.name == "ended":
            self._unsaved[job.job_id] = job
            self._save_ends()

    def _save_ends(self) -> None:
        for job in list(self._unsaved.values()):
            result = self._result_of(job.result)
            try:
                done = self.database.submit(lambda db, job=job, result=result: end_job(db, job, result))
            except StoreError:
                return
            done.add_done_callback(lambda done, job=job: self._mark_job_saved(done, job))

    def _mark_job_saved(self, done: "Future[None]", job: Job) -> None:
        if not done.cancelled() and done.exception() is None:
            self._unsaved.pop(job.job_id, None)

    async def watch(self) -> None:
        """Until cancelled: find out whether the disk can be written (again), and save what waits for it."""
        while True:
            await asyncio.sleep(STORE_PROBE_PERIOD_S)
            self._save_ends()
            try:
                if not self._restored:
                    self._apply_stored_state(*await asyncio.to_thread(self._read_stored_state))
                operating_s = self._clock() - self._zero_s
                await self.database.write_async(lambda db, now_s=operating_s: save_operating_time(db, now_s))
            except StoreError:
                continue  # logged by the database, once


def _log_write_error(done: "Future[Any]") -> None:
    if not done.cancelled() and (error := done.exception()) is not None:
        log.error("not written: %s", error)


class FindingLog:
    """Listener of the engine: at a job's end, what is new goes into the store."""

    def __init__(self, cell: Cell, keeper: Keeper) -> None:
        self._cell, self._keeper = cell, keeper
        self._known: LocalCalibration | None = cell.knowledge.kept_calibration

    def on_job_event(self, job: Job, event: JobEvent) -> None:
        """Keep the previewed plan and the calibration that the ended job left."""
        if event.name != "ended":
            return
        if isinstance(job.result, PreviewedPlan):
            self._plan(job.job_id, job.result)
        life = self._cell.knowledge.kept_calibration
        if life is not None and life is not self._known:
            self._known = life
            self._store_calibration(job.job_id)

    def _plan(self, job_id: str, previewed: PreviewedPlan) -> None:
        made_unix_s, now_ns = time.time(), mono_ns()
        expires_unix_s = made_unix_s + (previewed.expires_ns - now_ns) * 1e-9
        plan = previewed.plan
        view = json.dumps(
            {
                "length_mm": round(plan.length_m * 1e3, 1),
                "duration_s": round(plan.duration_s, 2),
                "predicted_sigma_mm": [round(value, 2) for value in previewed.predicted_sigma_mm],
                "q_goal_rad": [float(value) for value in previewed.q_goal],
            }
        )
        plan_hash = previewed.plan_hash
        kept = {known: t_ns for known, t_ns in self._keeper.plan_expiries_ns.items() if t_ns > now_ns}
        self._keeper.plan_expiries_ns = kept | {plan_hash: previewed.expires_ns}
        self._keeper.queue_write(lambda db: add_plan(db, plan_hash, job_id, made_unix_s, expires_unix_s, view))

    def _store_calibration(self, job_id: str) -> None:
        record = self._cell.knowledge.calibration_record
        if record is None:
            return
        made, view = time.time(), json.dumps(asdict(record))
        figures = (record.method, record.sigma_deg, record.residual_rms_mm)
        self._keeper.queue_write(lambda db: add_calibration(db, made, job_id, *figures, view))
