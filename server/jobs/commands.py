"""A command as the store keeps it: who sent it, with which key, and what they were answered."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from server.access.lease import Lease
from server.access.roles import Caller
from server.jobs.engine import Job
from server.store.audit_rows import AuditEntry
from server.store.idempotency import Answered

INSIDE = Caller("server", "engineer", "")


@dataclass(frozen=True, slots=True)
class Command:
    """One request to start a job. `answer` makes the answer that a retry with the same key is given."""

    caller: Caller = INSIDE
    request_id: str = ""
    key: str = ""
    answer: Callable[[Job], Answered] | None = None


INSIDE_COMMAND = Command()  # of the server itself


@dataclass(frozen=True, slots=True)
class Began:
    """What one transaction writes before a job begins."""

    job: Job
    body: str
    audit: AuditEntry
    key: str
    answered: Answered | None


def began(job: Job, body: str, plan_hash: str, lease: Lease | None, command: Command) -> Began:
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
        idempotency_key=command.key,
        plan_hash=plan_hash,
        job_id=job.job_id,
    )
    answered = command.answer(job) if command.answer is not None and command.key else None
    return Began(job, body, entry, command.key, answered)
