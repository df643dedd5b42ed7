"""`longreach bench kills`: SIGKILL of server, link process and PLC in the middle of real jobs, case by case."""

import json
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.kills.case import (
    RAMP_START_MAX_MS,
    STEP_MAX,
    TRAVEL_MAX_MM,
    VICTIMS,
    KillCase,
    Victim,
    failed_case,
)
from benchmarks.kills.drill import run_case
from benchmarks.kills.figures import KillFigures
from recording.files import write_durably
from server.errors import SettingsError

DEFAULT_VICTIMS = "server,link,plc"
_EXPECTED = (TimeoutError, RuntimeError, ValueError, OSError)  # of a case on a computer that is too busy


class UnknownVictimError(SettingsError):
    """A name that is none of the victims."""


def victims_of(text: str) -> list[Victim]:
    """The victims of a comma list.

    Raises: UnknownVictimError: naming the one that does not exist.
    """
    names = [name.strip() for name in text.split(",") if name.strip()]
    unknown = [name for name in names if name not in VICTIMS]
    if unknown or not names:
        wrong = ", ".join(unknown) or "nothing"
        raise UnknownVictimError(
            f"victims = '{wrong}': choose from {', '.join(VICTIMS)} (all: server and link at once)"
        )
    return [victim for victim in VICTIMS if victim in names]


def command(n: int, seed: int, victims: str, folder: Path, console: Console) -> None:
    """Run or resume, show the table and every violation.

    Raises: UnknownVictimError: naming the victim that does not exist.
    """
    cases = bench(victims_of(victims), n, seed, folder, console)
    console.print(summary(cases))
    for case in cases:
        for violation in case.violations:
            console.print(f"{case.victim} {case.number}: {violation}", highlight=False)


def bench(victims: Sequence[Victim], n: int, seed: int, folder: Path, console: Console) -> list[KillCase]:
    """Run or resume n kills of each victim; every case is saved as soon as it is there."""
    folder.mkdir(parents=True, exist_ok=True)
    cases = []
    for number in range(1, n + 1):
        for victim in victims:
            saved = folder / f"{victim}-{seed}-{number}.json"
            if saved.exists():
                case = load_case(saved.read_text(encoding="utf-8"))
            else:
                case = _case(victim, number, seed, folder / f"{victim}-{seed}-{number}")
                write_durably(saved, json.dumps(asdict(case), indent=1))
            cases.append(case)
            console.print(line(case), highlight=False)
    return cases


def _case(victim: Victim, number: int, seed: int, folder: Path) -> KillCase:
    started_s = time.monotonic()
    try:
        return run_case(victim, number, seed, folder)
    except _EXPECTED as error:
        return failed_case(victim, number, seed, error, time.monotonic() - started_s)


def load_case(text: str) -> KillCase:
    """A case as it was saved."""
    data = json.loads(text)
    figures = data.pop("figures")
    return KillCase(**data, figures=KillFigures(**figures) if figures is not None else None)


def line(case: KillCase) -> str:
    """One case in one line."""
    figures, head = case.figures, f"{case.victim:6s} {case.number:3d} at {100 * case.moment:2.0f} %"
    measured = (
        f"ramp after {figures.ramp_start_ms:.0f} ms, {figures.ramp_ms:.0f} of {figures.ramp_bound_ms:.0f} ms, "
        f"{figures.tcp_speed_mm_s:.0f} mm/s, {figures.tcp_travel_mm:.0f} mm"
        if figures is not None
        else "clock died with the PLC"
    )
    told = f"job {case.job_state}: {case.job_reason[:60]}"
    wrong = f"  [red]{'; '.join(case.violations)}[/]" if case.violations else ""
    return f"{head}  {measured}; step {case.step:.2f}; {told}{wrong}"


_COLUMNS: tuple[tuple[str, Callable[[KillFigures], float], str], ...] = (
    (f"ramp starts ms (limit {RAMP_START_MAX_MS:.0f})", lambda f: f.ramp_start_ms, ".0f"),
    ("ramp ms over |qd|/qdd_stop", lambda f: f.ramp_ms - f.ramp_bound_ms, "+.0f"),
    ("reference at rest ms", lambda f: f.reference_at_rest_ms, ".0f"),
    ("TCP speed mm/s", lambda f: f.tcp_speed_mm_s, ".0f"),
    (f"TCP travel mm (limit {TRAVEL_MAX_MM:.0f})", lambda f: f.tcp_travel_mm, ".1f"),
    ("of the reference mm", lambda f: f.reference_travel_mm, ".1f"),
)


def summary(cases: Sequence[KillCase]) -> Table:
    """Median and maximum of every figure for each victim, and how many cases broke a rule."""
    table = Table(title="SIGKILL in the middle of a move: median, max", title_justify="left")
    for heading in ("killed", "N", *(name for name, _, _ in _COLUMNS)):
        table.add_column(heading)
    for heading in (f"step of qd_ref (limit {STEP_MAX})", "job told after s", "cases with violations"):
        table.add_column(heading)
    for victim in VICTIMS:
        group = [case for case in cases if case.victim == victim]
        if group:
            table.add_row(victim, str(len(group)), *_row(group))
    return table


def _row(group: Sequence[KillCase]) -> list[str]:
    figures = [case.figures for case in group if case.figures is not None]
    cells = [_two([value(f) for f in figures], form) for _, value, form in _COLUMNS]
    told = [case.job_ended_s for case in group if case.job_ended_s is not None]
    wrong = sum(bool(case.violations) for case in group)
    return [*cells, _two([case.step for case in group], ".2f"), _two(told, ".2f") or "after restart", str(wrong)]


def _two(values: Sequence[float], form: str) -> str:
    return f"{statistics.median(values):{form}}, {max(values):{form}}" if values else ""
