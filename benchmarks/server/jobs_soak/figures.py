"""What many cases tell together: growth per process, handles, tasks, the database, ends."""

import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from benchmarks.server.jobs_soak.case import SoakCase
from benchmarks.server.jobs_soak.sample import MIB, Growth, growth_of

SLOPE_MAX_MIB_H = 2.0
WARM_UP_S = 400.0  # three minutes of PLC samples and 600 pairs with their previews are kept: until those are full
WARM_UP_CASES = 70  # the last 200 jobs are kept with their stories, about three a case: until those are full, too
WARM_UP_FRAC_MAX = 0.4  # of a short run
SoakKind = Literal["quick", "fast", "full"]
TOLD: dict[SoakKind, str] = {
    "quick": "QUICK: a case is a look and a short move, not a positioning job",
    "fast": "positioning jobs, the TCP at 0.15 m/s",
    "full": "positioning jobs",
}


@dataclass(frozen=True, slots=True)
class Figures:
    """Of the longest life of the server (the run itself when it was not cut); `cases` counts all."""

    cases: int
    segment_cases: int
    rss_mib: tuple[Growth, ...]
    files: tuple[Growth, ...]
    threads: tuple[Growth, ...]
    tasks: Growth | None
    store_bytes_per_case: float
    violations: int
    median_s: float

    @property
    def holds(self) -> bool:
        """Memory within its limit, handles and tasks as many at the end as after warm-up, no violation."""
        if self.tasks is None or not self.rss_mib:
            return False
        constant = all(abs(one.last - one.first) <= 2.0 for one in (*self.files, self.tasks))
        return constant and not self.violations and all(one.per_hour <= SLOPE_MAX_MIB_H for one in self.rss_mib)


def figures_of(cases: Sequence[SoakCase]) -> Figures:
    """Growth is fitted behind the warm-up of the longest segment."""
    lengths = Counter(case.segment for case in cases)
    longest = max(lengths, key=lambda segment: lengths[segment])
    segment = [case for case in cases if case.segment == longest]
    warm_s = min(WARM_UP_S, WARM_UP_FRAC_MAX * segment[-1].t_s)
    warm = int(min(WARM_UP_CASES, WARM_UP_FRAC_MAX * len(segment)))
    kept = [case for case in segment[warm:] if case.t_s >= warm_s]
    t_s = [case.t_s for case in kept]
    per_case = (kept[-1].store_bytes - kept[0].store_bytes) / (len(kept) - 1) if len(kept) > 1 else 0.0
    return Figures(
        cases=len(cases),
        segment_cases=len(segment),
        rss_mib=_by_process(kept, "rss_bytes", MIB),
        files=_by_process(kept, "files", 1.0),
        threads=_by_process(kept, "threads", 1.0),
        tasks=growth_of("asyncio tasks", t_s, [case.tasks for case in kept]),
        store_bytes_per_case=per_case,
        violations=sum(bool(case.violations) for case in cases),
        median_s=statistics.median(case.seconds for case in cases),
    )


def _by_process(kept: Sequence[SoakCase], what: str, unit: float) -> tuple[Growth, ...]:
    """One growth for each process that lived to the last case: of its last life only."""
    found = []
    for last in kept[-1].samples:
        series = [(case.t_s, one[what] / unit) for case in kept for one in case.samples if one["pid"] == last["pid"]]
        growth = growth_of(last["name"], [t for t, _ in series], [value for _, value in series])
        found += [growth] if growth is not None else []
    return tuple(found)


def line(case: SoakCase) -> str:
    """One case in one line."""
    memory = ", ".join(f"{one['name']} {one['rss_bytes'] / MIB:.0f}" for one in case.samples)
    at = "" if case.fault_at_s is None else f" at {case.fault_at_s:.1f} s"
    wrong = f"  [red]{'; '.join(case.violations)}[/]" if case.violations else ""
    return (
        f"{case.number:4d} {case.fault}{at}: {', '.join(case.ends)[:110]}; {case.seconds:.0f} s, ready "
        f"{case.ready_after_s:.1f} s later; MiB: {memory}; tasks {case.tasks:.0f}, database {case.store_bytes:.0f} "
        f"B{wrong}"
    )


def summary(figures: Figures, kind: SoakKind) -> str:
    """All in some lines."""
    rss = "; ".join(f"{_growth(one)} MiB/h, {one.first:.1f} to {one.last:.1f} MiB" for one in figures.rss_mib)
    counts = "; ".join(f"{one.name} {one.first:.0f} to {one.last:.0f}" for one in figures.files)
    threads = "; ".join(f"{one.name} {one.first:.0f} to {one.last:.0f}" for one in figures.threads)
    tasks = f"{figures.tasks.first:.0f} to {figures.tasks.last:.0f}" if figures.tasks else "too few samples"
    return (
        f"N reached {figures.cases} ({TOLD[kind]}), median {figures.median_s:.1f} s; cases with violations: "
        f"{figures.violations}\nmemory after warm-up, {figures.segment_cases} cases of one life (limit "
        f"{SLOPE_MAX_MIB_H:g} MiB/h): {rss or 'too few samples'}\nopen files: {counts}\nthreads: {threads}\n"
        f"asyncio tasks: {tasks}\ndatabase: {figures.store_bytes_per_case:.0f} bytes a case\n"
        f"{'holds' if figures.holds else 'DOES NOT HOLD'}"
    )


def _growth(one: Growth) -> str:
    return f"{one.name} {one.per_hour:+.2f} ({one.low:+.2f} to {one.high:+.2f})"
