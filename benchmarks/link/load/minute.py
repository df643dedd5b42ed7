"""One minute of the link under load, as it is saved, and many of them together."""

import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

from benchmarks.link.load.lateness import Percentiles, lateness_us, percentiles
from benchmarks.link.load.tap import TapFigures
from protocol.timeouts import COMMAND_PERIOD
from server.link.contracts import LinkHealth


@dataclass(frozen=True, slots=True)
class Minute:
    """Counters are of this minute alone, unless they say otherwise."""

    number: int
    where: str  # "process": the real link process; "server": in the server's own
    seconds: float
    underruns: int
    watchdog_trips: int
    interruptions: list[str]  # why trajectories ended early
    run_frac: float  # share of the PLC's states in RUN
    commands: int
    lateness_us: list[int]  # of every send, seen from outside
    in_run: list[int]  # 1 for the sends while the PLC was in RUN, 0 for those before and after a trajectory
    gap_max_ms: float  # longest time between two commands
    own_p50_us: float  # by the client itself, over its last 1000 sends
    own_p99_us: float
    own_max_us: float  # since its start
    buffer_start_min_ms: float | None  # in the first second of a trajectory, while the ring fills
    buffer_min_ms: float | None  # later, while knots were still to come
    lost_to_plc: int
    lost_to_pc: int
    pairs: int
    process_ms: float  # median time the pipeline took for a pair
    cpu_frac: dict[str, float]  # of one core, by process
    major_faults: dict[str, int]
    policies: dict[str, str]
    warning: str  # the link's own
    load_average: float  # of the whole computer, at the end
    last_state: str  # of the PLC
    ended_in: str  # link phase after the trajectory

    @property
    def pairs_per_s(self) -> float:
        """Stereo pairs worked on per second."""
        return self.pairs / self.seconds


@dataclass(frozen=True, slots=True)
class Marks:
    """Counters at the start of a minute."""

    underruns: int = 0
    lost_to_plc: int = 0
    watchdog_trips: int = 0
    lost_to_pc: int = 0


def wire_figures(tap: TapFigures, marks: Marks, health: LinkHealth) -> dict[str, Any]:
    """The part of a minute that the tap and the client's own health tell."""
    gaps_ns = [after - before for before, after in zip(tap.sent_ns, tap.sent_ns[1:], strict=False)]
    return {
        "underruns": _since(tap.underruns, marks.underruns),
        "watchdog_trips": _since(tap.watchdog_trips, marks.watchdog_trips),
        "lost_to_plc": _since(tap.lost_to_plc, marks.lost_to_plc),
        "lost_to_pc": health.lost - marks.lost_to_pc,
        "run_frac": tap.running / max(1, tap.states),
        "commands": len(tap.sent_ns),
        "lateness_us": lateness_us(tap.sent_ns, COMMAND_PERIOD.duration_ns),
        "in_run": [int(running) for running in tap.sent_in_run],
        "gap_max_ms": max(gaps_ns, default=0) / 1e6,
        "own_p50_us": health.lateness_p50_us,
        "own_p99_us": health.lateness_p99_us,
        "own_max_us": health.lateness_max_us,
        "buffer_start_min_ms": _ms(tap.buffer_start_min_us),
        "buffer_min_ms": _ms(tap.buffer_min_us),
        "warning": health.warning,
        "last_state": tap.last_state,
        "ended_in": health.phase.value,
    }


def _since(now: int, before: int) -> int:
    """Of a counter that begins anew with every session."""
    return now - before if now >= before else now


def _ms(us: int | None) -> float | None:
    return None if us is None else us / 1e3


@dataclass(frozen=True, slots=True)
class Total:
    """Many minutes together."""

    where: str
    minutes: float
    underruns: int
    watchdog_trips: int
    interruptions: int
    run_frac: float
    lateness: Percentiles  # of all sends
    lateness_in_run: Percentiles  # of those while the PLC was in RUN
    own_p50_us: float  # median and largest of the client's own windows, and its maximum
    own_p99_us: float
    own_max_us: float
    gap_max_ms: float
    buffer_start_min_ms: float
    buffer_min_ms: float
    lost: int
    pairs_per_s: float
    process_ms: float
    cpu_frac: dict[str, float]
    major_faults: int
    policies: dict[str, str]
    load_average: float


def total_of(minutes: Sequence[Minute]) -> Total:
    """All minutes of one kind; at least one."""
    seconds = sum(minute.seconds for minute in minutes)
    starts = [m.buffer_start_min_ms for m in minutes if m.buffer_start_min_ms is not None]
    depths = [m.buffer_min_ms for m in minutes if m.buffer_min_ms is not None]
    names = minutes[-1].cpu_frac
    return Total(
        where=minutes[0].where,
        minutes=seconds / 60.0,
        underruns=sum(m.underruns for m in minutes),
        watchdog_trips=sum(m.watchdog_trips for m in minutes),
        interruptions=sum(len(m.interruptions) for m in minutes),
        run_frac=statistics.mean(m.run_frac for m in minutes),
        lateness=percentiles([us for m in minutes for us in m.lateness_us]),
        lateness_in_run=percentiles(
            [us for m in minutes for us, running in zip(m.lateness_us, m.in_run, strict=True) if running]
        ),
        own_p50_us=statistics.median(m.own_p50_us for m in minutes),
        own_p99_us=max(m.own_p99_us for m in minutes),
        own_max_us=max(m.own_max_us for m in minutes),
        gap_max_ms=max(m.gap_max_ms for m in minutes),
        buffer_start_min_ms=min(starts, default=0.0),
        buffer_min_ms=min(depths, default=0.0),
        lost=sum(m.lost_to_plc + m.lost_to_pc for m in minutes),
        pairs_per_s=sum(m.pairs for m in minutes) / seconds,
        process_ms=statistics.median(m.process_ms for m in minutes),
        cpu_frac={name: statistics.mean(m.cpu_frac.get(name, 0.0) for m in minutes) for name in names},
        major_faults=sum(sum(m.major_faults.values()) for m in minutes),
        policies=minutes[-1].policies,
        load_average=statistics.mean(m.load_average for m in minutes),
    )


def minute_from(data: dict[str, Any]) -> Minute:
    """A minute as it was saved; fields that this version does not know are passed over."""
    known = {field.name for field in fields(Minute)}
    return Minute(**{name: value for name, value in data.items() if name in known})


def as_data(minute: Minute) -> dict[str, Any]:
    """A minute for saving."""
    return asdict(minute)
