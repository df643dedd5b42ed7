"""Gap diagnoses alongside the server: one process each, low priority, never in the way of motion."""

import asyncio
import contextlib
import json
import os
import sys
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from uuid import uuid4

from recording.clock import mono_s
from recording.spawn import SINGLE_THREAD_ENVIRONMENT
from server.errors import BusyError, ServerError

DIAGNOSIS_NICENESS = "10"
DIAGNOSIS_TIMEOUT_S = 3600.0
DIAGNOSES_KEPT_MAX = 50
DIAGNOSE_COMMAND = (sys.executable, "-P", "-m", "longreach.cli", "diagnose")
UNFINISHED_STATES = ("waiting", "running")


@dataclass(slots=True)
class Diagnosis:
    """One run of `longreach diagnose`; its state is waiting, running, done, failed or stopped.

    `recordings`: several are diagnosed together, as one of the same machine; `job_id`: whose recording is the last one.
    """

    diagnosis_id: str
    recordings: tuple[Path, ...]
    job_id: str = ""
    state: str = "running"
    reason: str = ""
    last_line: str = ""
    started_s: float = field(default_factory=mono_s)
    ended_s: float | None = None
    task: asyncio.Task[None] | None = None

    @property
    def recording(self) -> str:
        """The first one's name."""
        return self.recordings[0].name

    @property
    def elapsed_s(self) -> float:
        """Seconds since the start, up to the end."""
        return (self.ended_s or mono_s()) - self.started_s


class DiagnosisBusyError(BusyError):
    """Another diagnosis has the processors."""

    hint = "wait for its end (GET /v1/diagnoses/{diagnosis_id}) or end it (DELETE /v1/diagnoses/{diagnosis_id})"


class Diagnoses:
    """Belongs to the event loop. One at a time: the processors are the machine's."""

    def __init__(self, folder: Path, command: tuple[str, ...] = DIAGNOSE_COMMAND) -> None:
        self._folder, self._command = folder / "diagnoses", command
        self._turn = asyncio.Lock()
        self.all: deque[Diagnosis] = deque(maxlen=DIAGNOSES_KEPT_MAX)

    def find_diagnosis(self, diagnosis_id: str) -> Diagnosis | None:
        """The one of that id."""
        return next((diagnosis for diagnosis in self.all if diagnosis.diagnosis_id == diagnosis_id), None)

    def start(self, *recordings: Path) -> Diagnosis:
        """Begin. Raises: DiagnosisBusyError naming the diagnosis that runs, or waits to."""
        running = next((diagnosis for diagnosis in self.all if diagnosis.state in UNFINISHED_STATES), None)
        if running is not None:
            raise DiagnosisBusyError(
                f"diagnosis {running.diagnosis_id} of {running.recording} runs since {running.elapsed_s:.0f} s; wait "
                "for its end or end it",
                {"diagnosis_id": running.diagnosis_id},
            )
        return self._start_diagnosis(Diagnosis(uuid4().hex[:12], recordings))

    def queue_diagnosis(self, recordings: tuple[Path, ...], job_id: str) -> Diagnosis:
        """Begin as soon as no other one runs: what an identification's job asks for."""
        busy = any(diagnosis.state in UNFINISHED_STATES for diagnosis in self.all)
        return self._start_diagnosis(Diagnosis(uuid4().hex[:12], recordings, job_id, "waiting" if busy else "running"))

    async def stop(self, one: Diagnosis) -> None:
        """End it, if it runs or waits."""
        if one.state in UNFINISHED_STATES and one.task is not None:
            one.task.cancel()
            await asyncio.wait({one.task})
            if one.state in UNFINISHED_STATES:  # before its first step
                one.state, one.reason, one.ended_s = "stopped", "stopped", mono_s()

    async def close(self) -> None:
        """End what runs, those that wait first."""
        for diagnosis in reversed(self.all):
            await self.stop(diagnosis)

    def result(self, one: Diagnosis) -> dict[str, Any]:
        """The whole answer. Raises: ServerError: the file is gone or no JSON."""
        try:
            return json.loads(self._result_path(one, "json").read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ServerError(f"result of diagnosis {one.diagnosis_id}: {error}") from error

    def page(self, one: Diagnosis) -> Path:
        """The report for people."""
        return self._result_path(one, "html")

    def _start_diagnosis(self, one: Diagnosis) -> Diagnosis:
        self.all.append(one)
        one.task = asyncio.create_task(self._in_turn(one), name=f"diagnosis-{one.diagnosis_id}")
        return one

    def _result_path(self, one: Diagnosis, ending: str) -> Path:
        return self._folder / f"{one.diagnosis_id}.{ending}"

    async def _in_turn(self, one: Diagnosis) -> None:
        try:
            async with self._turn:
                one.state, one.started_s = "running", mono_s()
                await self._run(one)
        except asyncio.CancelledError:
            one.state, one.reason = "stopped", "stopped"
            raise
        finally:
            one.ended_s = mono_s()

    async def _run(self, one: Diagnosis) -> None:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            async with asyncio.timeout(DIAGNOSIS_TIMEOUT_S):
                code = await self._run_diagnosis_process(one)
            one.state, one.reason = ("done", "") if code == 0 else ("failed", one.last_line or f"exit code {code}")
        except (OSError, TimeoutError) as error:
            one.state, one.reason = "failed", str(error) or f"not done within {DIAGNOSIS_TIMEOUT_S:.0f} s"

    async def _run_diagnosis_process(self, one: Diagnosis) -> int:
        outputs = ("--json", str(self._result_path(one, "json")), "--html", str(self._result_path(one, "html")))
        process = await asyncio.create_subprocess_exec(
            *("nice", "-n", DIAGNOSIS_NICENESS, *self._command, *(str(path) for path in one.recordings), *outputs),
            env={**os.environ, **SINGLE_THREAD_ENVIRONMENT},
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
        )
        try:
            await _track_last_line(process, one)
            return await process.wait()
        finally:
            if process.returncode is None:
                with contextlib.suppress(ProcessLookupError):
                    process.kill()
                await process.wait()


async def _track_last_line(process: asyncio.subprocess.Process, one: Diagnosis) -> None:
    """Keep the last line that it says."""
    if process.stderr is None:
        return
    while chunk := await process.stderr.read(4096):
        lines = [line.strip() for line in chunk.decode("utf-8", "replace").splitlines() if line.strip()]
        one.last_line = lines[-1][:300] if lines else one.last_line
