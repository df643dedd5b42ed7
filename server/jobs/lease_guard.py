"""The guard: a job whose lease was lost or went stale is stopped with a ramp, and says why."""

import asyncio
import contextlib
import logging

from server.jobs.engine import JobEngine
from server.link.errors import LinkError

log = logging.getLogger(__name__)
LEASE_CHECK_PERIOD_S = 0.1


async def guard_lease(engine: JobEngine) -> None:
    """Until cancelled: look at every change of the holder, and ten times a second for staleness."""
    changed = asyncio.Event()
    unsubscribe = engine.leases.on_change(changed.set)
    try:
        while True:
            changed.clear()
            expel_unadmitted(engine)
            await enforce_lease(engine)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LEASE_CHECK_PERIOD_S):
                    await changed.wait()
    finally:
        unsubscribe()


def expel_unadmitted(engine: JobEngine) -> None:
    """A key that was revoked, or a session that ended, takes its control along."""
    ended = engine.leases.expel_unadmitted()
    if ended is not None:
        log.warning("control of %s (%s) has ended: no longer admitted", ended.owner, ended.kind)


async def stop_unguarded(engine: JobEngine) -> None:
    """Stop the job that ran under a lease while the guard failed: it is not known whether that lease still held.

    Raises: LinkError: the stop was not confirmed; the PLC ramps by its own watchdog.
    """
    job = engine.current
    if job is not None and not job.has_ended and job.fencing != 0 and job.state.value != "stopping":
        await engine.stop("the server's lease guard failed; its log says how")


async def enforce_lease(engine: JobEngine) -> None:
    """Stop the running job if its lease no longer holds. A job without one (fencing 0) is the server's own."""
    job = engine.current
    if job is None or job.has_ended or job.fencing == 0:
        return
    lost = engine.leases.why_lost(job.fencing)
    if not lost or job.state.value == "stopping":
        return
    log.warning("job %s (%s) is stopped: %s", job.job_id, job.kind, lost)
    try:
        await engine.stop(lost)
    except LinkError as error:
        log.warning("stop was not confirmed: %s; the PLC ramps by its own watchdog", error)
