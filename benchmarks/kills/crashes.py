"""`longreach bench crashes`: SIGKILL of the whole server at a random moment of a run, case by case.

After each restart: the database is sound, the job has an end with a reason, the recording opens up to its last chunk,
a retry of the command with its key is answered and moves nothing, and nothing moves by itself.
"""

import json
import sqlite3
import time
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

from benchmarks.kills.drill import fast_machine
from benchmarks.kills.plc_process import PlcProcess, free_udp_port
from benchmarks.kills.relay import Relay
from benchmarks.kills.under_test import START_S, ServerUnderTest
from protocol.codes import PlcState
from recording.errors import RecordingError
from recording.files import read_text, write_durably
from recording.opening import read_run
from sim_plc.process import SimSettings

BODY = {"kind": "retract", "distance_mm": 300.0}
SPAN_S = 6.0  # of a run of 4 to 5 s: planning, arming, moving, settling, its end, and just after it
WATCH_S = 1.5
STILL_RAD = 2e-4
ENDS = ("done", "failed", "stopped", "interrupted")
_EXPECTED = (TimeoutError, RuntimeError, OSError)  # of a case on a computer that is too busy


@dataclass(frozen=True, slots=True)
class CrashCase:
    """One kill: when it fell, what the PLC was doing, what the next life found, and every rule that was broken."""

    number: int
    seed: int
    killed_after_s: float
    plc_state: str
    job_state: str
    job_reason: str
    recordings: list[str]
    violations: list[str]
    duration_s: float


def crashes(
    n: Annotated[int, typer.Option(help="how many kills")] = 20,
    seed: Annotated[int, typer.Option(help="of the moments")] = 1,
    folder: Annotated[Path, typer.Option(help="where every case is saved; a second run resumes")] = Path(
        "runs/bench-crashes"
    ),
) -> None:
    """SIGKILL the server at random points of a run; look at what the next life finds."""
    console, cases = Console(width=200), []
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(1, n + 1):
        case = _resumed(number, seed, folder)
        cases.append(case)
        console.print(line(case), highlight=False)
    console.print(summary(cases), highlight=False)
    if any(case.violations for case in cases):
        raise typer.Exit(1)


def _resumed(number: int, seed: int, folder: Path) -> CrashCase:
    saved = folder / f"{seed}-{number}.json"
    if saved.exists():
        return CrashCase(**json.loads(saved.read_text(encoding="utf-8")))
    started_s = time.monotonic()
    after_s = float(np.random.default_rng([seed, number]).uniform(0.0, SPAN_S))
    try:
        case = run_case(number, seed, after_s, folder / f"{seed}-{number}")
    except _EXPECTED as error:
        violations, spent_s = [f"the case did not come about: {error}"], time.monotonic() - started_s
        return CrashCase(number, seed, after_s, "", "", "", [], violations, spent_s)  # not saved: tried again next time
    write_durably(saved, json.dumps(asdict(case), indent=1))
    return case


def run_case(number: int, seed: int, after_s: float, folder: Path) -> CrashCase:
    """One case with processes of its own.

    Raises: TimeoutError, RuntimeError, OSError: it did not come to the kill or not back from it.
    """
    started_s = time.monotonic()
    folder.mkdir(parents=True, exist_ok=True)
    machine_file, _ = fast_machine(folder)
    settings = SimSettings(read_text(machine_file), seed=1, plc_port=free_udp_port(), camera=False)
    with PlcProcess(settings), Relay(settings.plc_port) as relay:
        server = ServerUnderTest(relay.port, machine_file, folder)
        try:
            server.start()
            relay.wait(lambda state: state.plc_state is PlcState.LINKED, START_S, "the link")
            key = {"Idempotency-Key": f"case-{number}"}
            job_id = server.start_job(BODY, key)
            time.sleep(after_s)
            plc_state = relay.states[-1].plc_state.name
            server.kill_all()
            server.close()
            found = _next_life(server, relay, job_id, key)
            recordings = opened(folder / "runs")
        finally:
            server.close()
    job, violations = found
    violations += database_faults(folder / "runs" / "longreach.sqlite3") + [text for text in recordings if "!" in text]
    told = str(job.get("state", "")), str(job.get("reason", ""))
    return CrashCase(
        number, seed, after_s, plc_state, *told, recordings, violations, round(time.monotonic() - started_s, 1)
    )


def _next_life(
    server: ServerUnderTest, relay: Relay, job_id: str, key: dict[str, str]
) -> tuple[dict[str, Any], list[str]]:
    """The job as the next life tells it, and what is wrong with that life."""
    server.start()
    time.sleep(1.0)  # the boom swings out
    before = relay.states[-1].q
    job, violations = server.job(job_id), []
    if job.get("state") not in ENDS or (job["state"] != "done" and not job["reason"]):
        violations.append(f"the job has no honest end: {job.get('state')} {job.get('reason')!r}")
    if server.start_job(BODY, key) != job_id:
        violations.append("a retry with its key began another job")
    time.sleep(WATCH_S)
    moved = max(abs(a - b) for a, b in zip(relay.states[-1].q, before, strict=True))
    if moved > STILL_RAD or relay.states[-1].plc_state in (PlcState.RUN, PlcState.HOLD):
        violations.append(f"the machine moved by itself: {moved:.1e} rad, PLC {relay.states[-1].plc_state.name}")
    return job, violations


def database_faults(path: Path) -> list[str]:
    """What is wrong with the database, as SQLite itself tells it."""
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as db:
        sound = db.execute("PRAGMA integrity_check").fetchone()[0]
        open_jobs = db.execute("SELECT count(*) FROM jobs WHERE state IN ('running', 'stopping')").fetchone()[0]
    return [f"database: {sound}"] * (sound != "ok") + [f"{open_jobs} jobs without an end"] * (open_jobs > 0)


def opened(folder: Path) -> list[str]:
    """Each recording in one line; one that cannot be opened carries a '!'."""
    told = []
    for path in sorted(folder.glob("*.mcap")):
        try:
            run = read_run(path)
            told.append(f"{path.stat().st_size} bytes, {'complete' if run.complete else 'cut'}")
        except RecordingError as error:
            told.append(f"! {path.name} ({path.stat().st_size} bytes): {error}")
    return told


def line(case: CrashCase) -> str:
    """One case in one line."""
    wrong = f"  [red]{'; '.join(case.violations)}[/]" if case.violations else ""
    told = f"job {case.job_state}, recording {', '.join(case.recordings) or 'none'}"
    return f"{case.number:3d} killed after {case.killed_after_s:.2f} s, PLC {case.plc_state}: {told}{wrong}"


def summary(cases: list[CrashCase]) -> str:
    """All in one line."""
    wrong = sum(bool(case.violations) for case in cases)
    states = sorted({case.plc_state for case in cases if case.plc_state})
    ends = {end: sum(case.job_state == end for case in cases) for end in ENDS}
    told = ", ".join(f"{count} {end}" for end, count in ends.items() if count)
    return f"N = {len(cases)} kills (PLC in {', '.join(states)}); jobs: {told}; cases with violations: {wrong}"
