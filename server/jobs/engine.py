"""The one engine that runs plans: it acts, remembers that it moved the machine, and stops it on every ending."""

import asyncio
import contextlib
import logging
import time
from collections import deque
from collections.abc import Awaitable, Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from enum import Enum
from typing import Any
from uuid import uuid4

from recording.clock import mono_s
from server.access.desk import LeaseDesk
from server.access.lease import Lease
from server.errors import BusyError, JobFailedError, ServerError
from server.jobs.performer import Performer
from server.jobs.requests import Plan, Progress, Record, Request
from server.link.errors import LinkError
from server.listeners import Listeners

log = logging.getLogger(__name__)

# Longest wait for the ramp when a job ends early: |qd|/qdd_stop is below 0.5 s, the rest is the link
STOP_TIMEOUT_S = 3.0


class JobState(Enum):
    """Life of a job; the last four are ends."""

    RUNNING = "running"
    STOPPING = "stopping"
    DONE = "done"
    FAILED = "failed"
    STOPPED = "stopped"
    INTERRUPTED = "interrupted"  # the server itself ended while it ran


@dataclass(frozen=True, slots=True)
class JobEvent:
    """One line of a job's story; `number` lets a late subscriber resume."""

    number: int
    elapsed_s: float
    name: str
    current: float
    target: float
    unit: str
    text: str


@dataclass(slots=True)
class Job:
    """One run of one plan, with its story and its end."""

    job_id: str
    kind: str
    owner: str
    state: JobState = JobState.RUNNING
    reason: str = ""
    code: str = ""
    result: Any = None
    started_unix_s: float = field(default_factory=time.time)
    started_mono_s: float = field(default_factory=mono_s)
    ended_mono_s: float | None = None
    events: list[JobEvent] = field(default_factory=list)
    fencing: int = 0  # of the lease it runs under; 0: the server's own

    @property
    def has_ended(self) -> bool:
        """Whether the job has reached an end."""
        return self.state not in (JobState.RUNNING, JobState.STOPPING)

    @property
    def elapsed_s(self) -> float:
        """Seconds since the start, up to the end."""
        return (self.ended_mono_s or mono_s()) - self.started_mono_s


class JobEngine:
    """Runs one motion job at a time. Busy is an error that names who is."""

    def __init__(self, performer: Performer, earlier: Iterable[Job] = (), leases: LeaseDesk | None = None) -> None:
        self._performer = performer
        self.leases = leases or LeaseDesk()
        self._task: asyncio.Task[None] | None = None
        self._stopping_job: Job | None = None
        self._closing = False
        self._listeners = Listeners[[Job, JobEvent]]("a job's event")
        #: Why a job that failed could not go on, where that is known better than its error says (a suspended PC).
        self.interruption: Callable[[Job], str] = lambda _job: ""
        self.not_noted = ""  # what of the running job, or else of the last one, could not be written down
        # a thread of its own: a step of a plan must not queue behind file lists and results in the default executor
        self._planner = ThreadPoolExecutor(1, thread_name_prefix="plan")
        self.current: Job | None = None
        self.jobs: deque[Job] = deque(earlier, maxlen=200)

    def restore(self, jobs: Iterable[Job], fencing: int) -> None:
        """Take up what an earlier life left: its jobs, and the fencing number that the next holder's is above."""
        ours = list(self.jobs)
        self.jobs.clear()
        self.jobs.extend([*(job for job in jobs if job not in ours), *ours])
        self.leases.book.fencing = max(self.leases.book.fencing, fencing)

    def on_event(self, listener: Callable[[Job, JobEvent], None]) -> None:
        """Call `listener(job, event)` for everything that happens to any job, on the event loop.

        One that raises is logged, shows in `not_noted` and is passed over: no listener keeps a job from its end, or the
        machine from its stop.
        """
        self._listeners.add(listener)

    def find_job(self, job_id: str) -> Job | None:
        """The job of that id among the last 200."""
        return next((job for job in self.jobs if job.job_id == job_id), None)

    def submit(self, kind: str, plan: Plan, owner: str, lease: Lease | None = None) -> Job:
        """Start a plan now, under a lease; without one it is the server's own.

        Raises: BusyError naming the running job and its owner; JobFailedError: the server is shutting down.
        """
        job = self._reserve_job(kind, plan, owner, lease)
        self._start_job_task(job, plan)
        return job

    async def submit_kept(
        self, kind: str, plan: Plan, owner: str, lease: Lease | None, keep: Callable[[Job], Awaitable[None]]
    ) -> Job:
        """As `submit`, but nothing begins before `keep` has written the job down; if it cannot, nothing begins.

        Raises: BusyError; whatever `keep` raises, the job has failed then.
        """
        job = self._reserve_job(kind, plan, owner, lease)
        try:
            await keep(job)
        except BaseException as error:
            plan.close()
            job.code = getattr(error, "code", "internal")
            self._end(job, JobState.FAILED, f"it was not started: {error}")
            raise
        lost = self.leases.why_lost(job.fencing) if lease else ""
        if job.state is JobState.STOPPING or lost:  # while it was written down
            plan.close()
            self._end(job, JobState.STOPPED, job.reason or lost)
        else:
            self._start_job_task(job, plan)
        return job

    def _reserve_job(self, kind: str, plan: Plan, owner: str, lease: Lease | None) -> Job:
        if self._closing:
            plan.close()
            raise JobFailedError("the server is shutting down; try again when it is back", "closing")
        if self.current is not None and not self.current.has_ended:
            plan.close()
            busy = self.current
            raise BusyError(
                f"job {busy.job_id} ({busy.kind}) of {busy.owner} is {busy.state.value} since {busy.elapsed_s:.0f} s; "
                "wait for its end or stop it",
                {"owner": busy.owner, "job_id": busy.job_id, "kind": busy.kind, "state": busy.state.value},
            )
        job = Job(job_id=uuid4().hex[:12], kind=kind, owner=owner, fencing=lease.fencing if lease else 0)
        self.current, self._task, self.not_noted = job, None, ""
        self.jobs.append(job)
        return job

    def _start_job_task(self, job: Job, plan: Plan) -> None:
        self._task = asyncio.create_task(self._run(job, plan), name=f"job-{job.kind}-{job.job_id}")
        self._task.add_done_callback(lambda _: self._ended_before_its_first_step(job, plan))

    async def stop(self, reason: str, only: Job | None = None) -> None:
        """Stop the motion and whatever job runs; always allowed. Returns when the job has ended.

        The ramp is requested before anything else: the job may be in a step that cannot be interrupted.
        With `only`, nothing is stopped unless it is that job which runs.
        """
        job, task = self.current, self._task
        if only is not None and (job is not only or only.has_ended):
            return
        running = job if job is not None and not job.has_ended else None
        first = running is not None and self._stopping_job is not running  # a closed tab stops by its socket and lease
        self._stopping_job = running or self._stopping_job
        if running is not None and first:
            running.state, running.reason = JobState.STOPPING, reason
        ramp = asyncio.ensure_future(self._performer.stop_motion(reason))
        if running is not None:
            await self._stop_job(running, task, reason if first else None)
        await ramp
        ours = running is not None and self.current is running
        if ours and self._performer.may_be_moving:  # begun by the job's last step, after the ramp
            await self._performer.stop_motion(reason)

    async def _stop_job(self, job: Job, task: asyncio.Task[None] | None, reason: str | None) -> None:
        """Cancel the job (a reason: it is the first to ask) and wait for its end, after the ramp has been requested."""
        if task is not None and reason is not None:
            task.cancel()
        await asyncio.sleep(0.0)
        if reason is not None and not job.has_ended:  # one that did not move has reported its end already
            self._report_event(job, "stopping", 0.0, 1.0, "", reason)
        if task is not None:
            await asyncio.wait({task}, timeout=STOP_TIMEOUT_S)

    async def hold_until(self, t_mono_ns: int | None) -> None:
        """Let motion go on until then only [monotonic ns], whatever this process does; None: it need not be held."""
        await self._performer.hold_until(t_mono_ns)

    async def close(self) -> None:
        """End everything: the machine is left holding, and no job begins any more."""
        self._closing = True
        try:
            await self.stop("server is shutting down")
        finally:
            self._planner.shutdown(wait=False)

    async def _run(self, job: Job, plan: Plan) -> None:
        try:
            self._report_event(job, "started", 0.0, 1.0, "", f"{job.kind} started for {job.owner}")
            job.result = await self._execute_plan(job, plan)
            self._end(job, JobState.DONE, "")
        except asyncio.CancelledError:
            await self._stop_safely(job.reason or "job cancelled")
            self._end(job, JobState.STOPPED, job.reason or "cancelled")
            raise
        except (ServerError, LinkError) as error:
            await self._stop_safely(str(error))
            if interruption := self.interruption(job):
                self._end(job, JobState.STOPPED, interruption)
            else:
                job.code = getattr(error, "code", "link")
                self._end(job, JobState.FAILED, str(error))
        except Exception as error:  # outermost loop of the shell: a defect must still leave the machine holding
            log.exception("job %s (%s) failed with an internal error", job.job_id, job.kind)
            await self._stop_safely("internal error")
            job.code = "internal"
            self._end(job, JobState.FAILED, f"internal error: {error!r}; see the server's log")
        finally:
            self._performer.release()
            plan.close()

    def _ended_before_its_first_step(self, job: Job, plan: Plan) -> None:
        """A task that is cancelled before it begins never enters `_run`: its job needs an end all the same."""
        if not job.has_ended:
            plan.close()
            self._end(job, JobState.STOPPED, job.reason or "cancelled")

    async def _execute_plan(self, job: Job, plan: Plan) -> object:
        reply: object = None
        while True:
            request, result = await self._advance_plan_in_thread(plan, reply)
            if job.state is JobState.STOPPING:  # whatever became of the cancellation: nothing follows a stop
                raise asyncio.CancelledError
            if request is None:
                return result
            if isinstance(request, Progress):
                self._report_event(job, request.name, request.current, request.target, request.unit, request.text)
                reply = None
            elif isinstance(request, Record):
                self._performer.record(request)
                if request.text:
                    self._report_event(job, "record", 0.0, 0.0, "", request.text)
                reply = None
            else:
                reply = await self._performer.perform(request)

    async def _stop_safely(self, reason: str) -> None:
        """Ask for the ramp even while being cancelled, once or again: waited for, and bounded in time."""
        if not self._performer.may_be_moving:
            return
        stop = asyncio.ensure_future(self._performer.stop_motion(reason))
        until_s = mono_s() + STOP_TIMEOUT_S
        while not stop.done() and (left_s := until_s - mono_s()) > 0.0:
            with contextlib.suppress(asyncio.CancelledError):  # another stop: that is what is being done
                await asyncio.wait({stop}, timeout=left_s)
        error = stop.exception() if stop.done() and not stop.cancelled() else TimeoutError("no answer in time")
        if error is not None:
            log.warning("stop was not confirmed: %s; the PLC ramps by its own watchdog", error)

    async def _advance_plan_in_thread(self, plan: Plan, reply: object) -> tuple[Request | None, object]:
        """The plan's next request, or (None, its result). Planning is heavy, so it runs outside the event loop.

        A cancelled job waits for the step to finish, however often it is cancelled: a generator cannot be closed while
        it runs.
        """
        step = asyncio.get_running_loop().run_in_executor(self._planner, _advance_plan, plan, reply)
        try:
            return await asyncio.shield(step)
        except asyncio.CancelledError:
            while not step.done():
                with contextlib.suppress(asyncio.CancelledError):
                    await asyncio.wait({step})
            raise

    def _end(self, job: Job, state: JobState, reason: str) -> None:
        job.state, job.reason, job.ended_mono_s = state, reason, mono_s()
        self._report_event(job, "ended", 1.0, 1.0, "", f"{state.value}{': ' + reason if reason else ''}")

    def _report_event(self, job: Job, name: str, current: float, target: float, unit: str, text: str) -> None:
        event = JobEvent(len(job.events) + 1, round(job.elapsed_s, 3), name, current, target, unit, text)
        job.events.append(event)
        problem = self._listeners.call(job, event)  # the machine comes to its end whatever fails there
        if problem:
            self.not_noted = f"job {job.job_id}: {problem}; report it, see the server's log"


def _advance_plan(plan: Plan, reply: object) -> tuple[Request | None, object]:
    try:
        return plan.send(reply), None
    except StopIteration as end:
        return None, end.value
