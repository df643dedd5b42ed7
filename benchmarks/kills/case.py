"""What one kill showed, and what of it should not have been."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Literal, get_args

import numpy as np

from benchmarks.kills.figures import KillFigures, figures_of, largest_step
from machine.description import Machine
from protocol.codes import PlcState
from protocol.messages import State

Victim = Literal["server", "link", "plc", "all"]
VICTIMS: tuple[Victim, ...] = get_args(Victim)

RAMP_START_MAX_MS = 260.0
RAMP_MARGIN_MS = 12.0  # states come every 10 ms: rest is seen up to that late
TRAVEL_MAX_MM = 80.0
STEP_MAX = 1.1  # of qdd_max * dt
DRIFT_MAX_RAD = 5e-3  # of the encoders while nobody is armed: a boom that sinks, not a move
QUIET = (PlcState.BOOT, PlcState.DISARMED, PlcState.LINKED)
INTERRUPTED = ("failed", "stopped", "interrupted")


@dataclass(frozen=True, slots=True)
class Observed:
    """The PLC's states of the three parts of a case, and the jobs as the server reports them."""

    machine: Machine
    planned_s: float
    move: tuple[State, ...]  # with its ramp, as far as the PLC lived
    quiet: tuple[State, ...]  # from the restart to the next job
    after: tuple[State, ...]
    job: dict[str, Any]
    job_ended_s: float | None
    again: dict[str, Any]


@dataclass(frozen=True, slots=True)
class KillCase:
    """One kill: measured, reported, and what did not hold. `figures` is None for the PLC, whose clock dies with it."""

    victim: Victim
    number: int
    seed: int
    moment: float  # share of the move at which it was killed
    planned_s: float
    figures: KillFigures | None
    step: float  # largest change of qd_ref between two states, of qdd_max * dt
    job_state: str
    job_reason: str
    job_ended_s: float | None  # after the kill; None: only after the restart
    states_after: list[str]  # of the PLC, from the restart to the next job
    drift_mrad: float  # of the encoders in that time
    again: str  # how the next job ended
    armed_anew: bool  # whether the PLC went through HOLD before it ran again
    duration_s: float
    violations: list[str]


def judged(victim: Victim, number: int, seed: int, moment: float, seen: Observed, duration_s: float) -> KillCase:
    """The case, measured against its bounds."""
    figures = None if victim == "plc" else figures_of(seen.move, seen.machine)
    step = max(largest_step(part, seen.machine) for part in (_since_run(seen.move), seen.after))
    states_after = [name for name, _ in groupby(state.plc_state.name for state in seen.quiet)]
    names = [name for name, _ in groupby(state.plc_state.name for state in seen.after)]
    armed_anew = "HOLD" in names[: names.index("RUN")] if "RUN" in names else False
    drift_rad = _drift_rad(seen.quiet)
    violations = [
        *(_ramp_violations(figures) if figures is not None else ()),
        *_report_violations(victim, seen.job),
        *_restart_violations(seen, drift_rad, armed_anew),
    ]
    if step > STEP_MAX:
        violations.append(f"qd_ref steps by {step:.2f} of qdd_max dt (limit {STEP_MAX})")
    return KillCase(
        victim=victim,
        number=number,
        seed=seed,
        moment=moment,
        planned_s=seen.planned_s,
        figures=figures,
        step=step,
        job_state=seen.job.get("state", "unknown"),
        job_reason=seen.job.get("reason", ""),
        job_ended_s=seen.job_ended_s,
        states_after=states_after,
        drift_mrad=drift_rad * 1e3,
        again=f"{seen.again.get('state', 'unknown')}: {seen.again.get('reason', '')}".rstrip(": "),
        armed_anew=armed_anew,
        duration_s=duration_s,
        violations=violations,
    )


def failed_case(victim: Victim, number: int, seed: int, error: Exception, duration_s: float) -> KillCase:
    """A case that did not come to its end: that is a violation too, and says why."""
    return KillCase(
        victim=victim,
        number=number,
        seed=seed,
        moment=0.0,
        planned_s=0.0,
        figures=None,
        step=0.0,
        job_state="",
        job_reason="",
        job_ended_s=None,
        states_after=[],
        drift_mrad=0.0,
        again="",
        armed_anew=False,
        duration_s=duration_s,
        violations=[f"the case did not come to its end: {error}"],
    )


def _since_run(states: Sequence[State]) -> Sequence[State]:
    """From the first state of the move on."""
    first = next((i for i, state in enumerate(states) if state.plc_state is PlcState.RUN), len(states))
    return states[first:]


def _drift_rad(states: Sequence[State]) -> float:
    if not states:
        return 0.0
    qs = np.array([state.q for state in states])
    return float(np.abs(qs - qs[0]).max())


def _ramp_violations(figures: KillFigures) -> Iterator[str]:
    if figures.ramp_start_ms > RAMP_START_MAX_MS:
        yield f"ramp starts {figures.ramp_start_ms:.0f} ms after the last accepted command (limit 260 ms)"
    if figures.ramp_ms > figures.ramp_bound_ms + RAMP_MARGIN_MS:
        yield f"ramp takes {figures.ramp_ms:.0f} ms (|qd| / qdd_stop is {figures.ramp_bound_ms:.0f} ms)"
    if figures.tcp_travel_mm > TRAVEL_MAX_MM:
        yield f"TCP travels {figures.tcp_travel_mm:.1f} mm (limit {TRAVEL_MAX_MM:.0f} mm)"


def _report_violations(victim: Victim, job: dict[str, Any]) -> Iterator[str]:
    if not job:
        yield "the server does not know the job that was interrupted"
        return
    if job["state"] not in INTERRUPTED or not job["reason"]:
        yield f"the job is reported as '{job['state']}' with the reason '{job['reason']}'"
    elif victim == "plc" and "PLC" not in job["reason"]:
        yield f"the reason does not name the PLC's silence: '{job['reason']}'"
    elif victim == "link" and "link" not in job["reason"]:
        yield f"the reason does not name the link process: '{job['reason']}'"


def _restart_violations(seen: Observed, drift_rad: float, armed_anew: bool) -> Iterator[str]:
    wrong = {state.plc_state.name for state in seen.quiet if state.plc_state not in QUIET}
    if not seen.quiet:
        yield "no state of the PLC after the restart"
    if wrong:
        yield f"PLC in {', '.join(sorted(wrong))} before anybody armed it"
    if drift_rad > DRIFT_MAX_RAD:
        yield f"encoders moved by {drift_rad * 1e3:.1f} mrad before anybody armed"
    if seen.again.get("state") != "done":
        yield f"the next job ended as '{seen.again.get('state')}': {seen.again.get('reason')}"
    elif not armed_anew:
        yield "the next job ran without arming"
