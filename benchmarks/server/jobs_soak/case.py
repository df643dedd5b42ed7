"""One job with its fault, from a machine that is ready to one that is ready again."""

import time
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeoutError
from concurrent.futures import wait as wait_for
from dataclasses import asdict, dataclass, field
from typing import Any

import httpx

from benchmarks.server.jobs_soak.faults import BAD_LINK, CUT, HARMLESS, Planned
from benchmarks.server.jobs_soak.sample import samples_of
from benchmarks.server.jobs_soak.stand import OWNER, Stand
from longreach.fleet_client import Finished, JobClient, JobRefusedError

FULL: tuple[dict[str, Any], ...] = ({"kind": "position"},)
QUICK: tuple[dict[str, Any], ...] = ({"kind": "look"}, {"kind": "retract", "distance_mm": 40.0})
HOME: dict[str, Any] = {"kind": "return"}
END_S = 300.0
READY_S = 90.0
HOME_TRIES = 3


@dataclass(frozen=True, slots=True)
class SoakCase:
    """Saved. `segment` counts the lives of the server, `t_s` the seconds of one; `samples` are taken at the end."""

    number: int
    segment: int
    t_s: float
    fault: str
    fault_at_s: float | None  # None: the job was over before
    ends: list[str]
    reached: bool | None
    seconds: float
    ready_after_s: float
    tasks: float
    store_bytes: float
    samples: list[dict[str, Any]]
    violations: list[str] = field(default_factory=list)


def run_case(number: int, segment: int, stand: Stand, fault: Planned, quick: bool, t0_s: float) -> SoakCase:
    """Run the jobs with the fault in the midst, find back, return to where it began, and look at what is held."""
    started_s = time.monotonic()
    bodies = QUICK if quick else FULL
    with JobClient(stand.url, owner=OWNER) as client, ThreadPoolExecutor(1) as pool:
        running = pool.submit(run_all, client, bodies)
        injected = _inject(stand, fault, running)
        ends, violations = _ended(stand, running)
    seconds = time.monotonic() - started_s
    violations += _judged(fault, ends, injected)
    trouble = stand.recover(READY_S)
    ready_after_s = time.monotonic() - started_s - seconds
    violations += [trouble] if trouble else _home(stand)
    return SoakCase(
        number=number,
        segment=segment,
        t_s=round(time.monotonic() - t0_s, 2),
        fault=fault.text,
        fault_at_s=injected,
        ends=[_told(end) for end in ends],
        reached=ends[-1].result.get("reached") if ends and isinstance(ends[-1].result, dict) else None,
        seconds=round(seconds, 2),
        ready_after_s=round(ready_after_s, 2),
        tasks=stand.metrics()["longreach_asyncio_tasks"],
        store_bytes=stand.store_bytes(),
        samples=[asdict(sample) for sample in samples_of(stand.server_pid, stand.link_port)],
        violations=violations,
    )


def run_all(client: JobClient, bodies: tuple[dict[str, Any], ...]) -> list[Finished]:
    """One after the other; the first that does not end well is the last."""
    ends: list[Finished] = []
    for body in bodies:
        try:
            ends.append(client.run(body))
        except (JobRefusedError, httpx.HTTPError) as error:
            ends.append(Finished("refused", str(error), None, 0.0))
        if ends[-1].state != "done":
            break
    return ends


def _inject(stand: Stand, fault: Planned, running: "Future[list[Finished]]") -> float | None:
    """Wait for the moment and do it; when it was done, None if the job was over before."""
    if fault.kind == "none":
        return None
    wait_for([running], timeout=fault.at_s)
    if running.done():
        return None
    match fault.kind:
        case "bad link":
            stand.relay(BAD_LINK)
        case "cut":
            stand.relay(CUT)
            time.sleep(fault.for_s)
            stand.relay()
        case "camera":
            stand.camera(fault.camera)
            time.sleep(fault.for_s)
            stand.camera()
        case "cancelled":
            stand.cancel()
        case "stopped":
            stand.stop()
        case "killed PLC":
            stand.kill_sim()
    return round(fault.at_s, 2)


def _ended(stand: Stand, running: "Future[list[Finished]]") -> tuple[list[Finished], list[str]]:
    try:
        return running.result(END_S), []
    except FutureTimeoutError:
        stand.stop()
        return running.result(60.0), [f"no end within {END_S:.0f} s; it was stopped"]


def _judged(fault: Planned, ends: list[Finished], injected: float | None) -> list[str]:
    """A job that nothing was done to must end well; every other one must say why it did not."""
    wrong = [f"ended as '{end.state}' without a reason" for end in ends if end.state != "done" and not end.reason]
    if ends[-1].state != "done" and (fault.kind in HARMLESS or injected is None):
        wrong.append(f"nothing that should end it was done to it: {_told(ends[-1])}")
    return wrong


def _home(stand: Stand) -> list[str]:
    """Back to where it began, so that the next job is like this one."""
    told = ""
    with JobClient(stand.url, owner=OWNER) as client:
        for _ in range(HOME_TRIES):
            end = run_all(client, (HOME,))[-1]
            if end.state == "done" or "no run has begun" in end.reason:
                return []
            told = _told(end)
            time.sleep(1.0)
            stand.recover(READY_S)
    return [f"did not return: {told}"]


def _told(end: Finished) -> str:
    return end.state + (f": {end.reason}" if end.state != "done" else "")
