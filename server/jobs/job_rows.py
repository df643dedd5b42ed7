"""Jobs on disk: a row before anything moves, its end when it ends, and an honest end after a crash."""

import json
import sqlite3
from typing import Any

from recording.clock import mono_s
from server.jobs.engine import Job, JobState

SHOWN = 200  # jobs that the engine remembers
KEPT = 10_000
INTERRUPTED = (
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
        (JobState.INTERRUPTED.value, INTERRUPTED, *open_states),
    )
    db.execute("DELETE FROM jobs WHERE number <= (SELECT max(number) FROM jobs) - ?", (KEPT,))
    return found


def read_jobs(db: sqlite3.Connection, limit: int = SHOWN) -> list[Job]:
    """The last jobs, oldest first."""
    rows = db.execute("SELECT * FROM jobs ORDER BY number DESC LIMIT ?", (limit,)).fetchall()
    return [_job(row) for row in reversed(rows)]


def _job(row: sqlite3.Row) -> Job:
    now = mono_s()
    job = Job(row["job_id"], row["kind"], row["owner"], JobState(row["state"]), row["reason"], row["code"])
    job.result = json.loads(row["result"]) if row["result"] else None
    job.fencing, job.started_unix_s = row["fencing"], row["started_unix_s"]
    job.started_mono_s, job.ended_mono_s = now - row["elapsed_s"], now
    return job
