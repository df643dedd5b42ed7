"""The jobs' journal on disk: a line at start and end of a job, so that a killed server's job is not forgotten."""

import json
import logging
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from server.jobs.engine import Job, JobEvent, JobState

log = logging.getLogger(__name__)

KEPT = 200
INTERRUPTED = (
    "the server ended while this job ran (killed, crashed or without power); "
    "the PLC's watchdog ramped the machine down; arm and look again"
)


@dataclass(frozen=True, slots=True)
class JobJournal:
    """One file of JSON lines. `path` None keeps nothing."""

    path: Path | None

    def restore(self) -> list[Job]:
        """The last jobs of earlier lives, oldest first; one without an end was interrupted. Shortens the file."""
        if self.path is None or not self.path.exists():
            return []
        jobs: dict[str, Job] = {}
        for line in self.path.read_text(encoding="utf-8", errors="replace").splitlines():
            _read_into(jobs, line)
        restored = list(jobs.values())[-KEPT:]
        for job in restored:
            if not job.ended:
                log.warning("job %s (%s) of %s was interrupted: the server ended while it ran", *_who(job))
                job.state, job.reason, job.code = JobState.INTERRUPTED, INTERRUPTED, "interrupted"
        self._rewrite(restored)
        return restored

    def note(self, job: Job, event: JobEvent) -> None:
        """Listener of the engine: keeps starts and ends. A full disk is logged, it does not end a job."""
        if self.path is None or event.name not in ("started", "ended"):
            return
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("a", encoding="utf-8") as file:
                file.write(_line(job))
        except OSError as error:
            log.error("job journal %s: %s; jobs are not kept", self.path, error)

    def _rewrite(self, jobs: list[Job]) -> None:
        if self.path is None:
            return
        fresh = self.path.with_suffix(".new")
        try:
            fresh.write_text("".join(_line(job) for job in jobs), encoding="utf-8")
            os.replace(fresh, self.path)
        except OSError as error:
            log.error("job journal %s: %s; it is left as it was", self.path, error)


def _who(job: Job) -> tuple[str, str, str]:
    return job.job_id, job.kind, job.owner


def _line(job: Job) -> str:
    kept: dict[str, Any] = {"job_id": job.job_id, "kind": job.kind, "owner": job.owner, "state": job.state.value}
    kept |= {"code": job.code, "reason": job.reason, "started_unix_s": job.started_unix_s, "elapsed_s": job.elapsed_s}
    return json.dumps(kept) + "\n"


def _read_into(jobs: dict[str, Job], line: str) -> None:
    """Take one line; what is damaged (a line cut off by the kill) is passed over."""
    try:
        kept = json.loads(line)
        now = time.monotonic()
        job = Job(str(kept["job_id"]), str(kept["kind"]), str(kept["owner"]), JobState(kept["state"]))
        job.code, job.reason = str(kept["code"]), str(kept["reason"])
        job.started_unix_s = float(kept["started_unix_s"])
        job.started_mono_s, job.ended_mono_s = now - float(kept["elapsed_s"]), now
    except (ValueError, KeyError, TypeError):
        return
    jobs[job.job_id] = job
