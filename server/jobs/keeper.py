"""The keeper: what jobs, leases and findings leave on disk, and what the next life of the server finds there."""

import asyncio
import logging
import sqlite3
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from server.jobs.commands import Began
from server.jobs.engine import Job, JobEvent
from server.jobs.job_rows import add_job, end_interrupted, end_job, read_jobs
from server.store.audit_rows import AuditEntry, add_audit, forget_old_audit
from server.store.database import Database, Work
from server.store.errors import StoreError
from server.store.idempotency import forget_answer, save_answer
from server.store.lease_rows import read_fencing, save_fencing
from server.store.operating_time import read_operating_time, save_operating_time

log = logging.getLogger(__name__)
PROBE_S = 2.0
SPARE = 64  # places of the queue that jobs and control have for themselves


class Keeper:
    """Belongs to the event loop; the database has its thread. `result_of` makes JSON data of a job's result."""

    def __init__(
        self, database: Database, result_of: Callable[[Any], Any], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.database = database
        self._clock = clock
        self._zero_s = clock()  # when the operating-hours counter would have stood at zero, on that clock
        self._result_of = result_of
        self._unsaved: dict[str, Job] = {}
        self._taken_up: Callable[[list[Job], int], None] = lambda _jobs, _fencing: None
        self._restored = False

    @property
    def problem(self) -> str:
        """Why nothing can be kept now, and so nothing may move; empty when all is well."""
        return self.database.problem

    # --- a new life -------------------------------------------------------------------------------------------------

    def on_restored(self, taken_up: Callable[[list[Job], int], None]) -> None:
        """Call with the last jobs, each with an honest end, and the highest fencing number, once they are read."""
        self._taken_up = taken_up

    def restore(self) -> None:
        """Read what the last life left; if that fails, `watch` tries again and nothing moves until then."""
        try:
            self._take(*self._left())
        except StoreError as error:
            log.error("earlier jobs are not known yet: %s", error)

    def _left(self) -> tuple[list[Job], int]:
        for job_id in self.database.write(end_interrupted):
            log.warning("job %s was interrupted: the server ended while it ran", job_id)
        self.database.write(forget_old_audit)
        self._zero_s = self._clock() - self.database.read(read_operating_time)
        return self.database.read(read_jobs), self.database.read(read_fencing)

    def _take(self, jobs: list[Job], fencing: int) -> None:
        self._taken_up(jobs, fencing)
        self._restored = True

    # --- commands: written before they are carried out or answered --------------------------------------------------

    async def begin(self, began: Began) -> None:
        """Job, audit and answer in one transaction.

        Raises: StoreError: nothing was written, nothing may begin.
        """
        self.check()

        def rows(db: sqlite3.Connection) -> None:
            add_job(db, began.job, began.body)
            save_fencing(db, began.job.fencing)
            add_audit(db, began.audit)
            if began.answered is not None:
                save_answer(db, began.audit.who, began.key, began.answered)

        try:
            await self.database.written(rows)
        except StoreError:
            who, key = began.audit.who, began.key
            if began.answered is not None:  # a disk that was late may write it all the same: the job was refused
                self.later(lambda db: forget_answer(db, who, key))
            raise

    async def control(self, entry: AuditEntry) -> None:
        """A new holder of control: fencing number and audit in one transaction.

        Raises: StoreError: not written; the lease must not be told.
        """

        def rows(db: sqlite3.Connection) -> None:
            save_fencing(db, entry.fencing)
            add_audit(db, entry)

        await self.database.written(rows)

    def check(self) -> None:
        """Raises: StoreError: nothing can be written down now, so nothing may move."""
        if self.problem or not self._restored:
            raise StoreError(self.problem or "the database has not been read yet")

    # --- what may not wait for the disk -----------------------------------------------------------------------------

    def audit(self, entry: AuditEntry) -> None:
        """A line about what happened already, or about a refusal: queued; a full queue is logged."""
        self.later(lambda db: add_audit(db, entry))

    def later(self, work: Work[Any]) -> None:
        """Queue a write whose failure is only logged."""
        try:
            self.database.submit(work, SPARE).add_done_callback(_logged)
        except StoreError as error:
            log.error("not written: %s", error)

    def note(self, job: Job, event: JobEvent) -> None:
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
            done.add_done_callback(lambda done, job=job: self._saved(done, job))

    def _saved(self, done: "Future[None]", job: Job) -> None:
        if not done.cancelled() and done.exception() is None:
            self._unsaved.pop(job.job_id, None)

    async def watch(self) -> None:
        """Until cancelled: find out whether the disk can be written (again), and save what waits for it."""
        while True:
            await asyncio.sleep(PROBE_S)
            self._save_ends()
            try:
                if not self._restored:
                    self._take(*await asyncio.to_thread(self._left))
                operating_s = self._clock() - self._zero_s
                await self.database.written(lambda db, now_s=operating_s: save_operating_time(db, now_s))
            except StoreError:
                continue  # logged by the database, once


def _logged(done: "Future[Any]") -> None:
    if not done.cancelled() and (error := done.exception()) is not None:
        log.error("not written: %s", error)
