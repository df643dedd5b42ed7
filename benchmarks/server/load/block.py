"""One block of the load bench, as it is saved, and its verdict."""

import dataclasses
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.link.load.lateness import percentiles

P99_MAX_MS = 50.0
LOST_MAX_FRAC = 0.10


@dataclass(frozen=True, slots=True)
class Block:
    """`seconds` with or without clients, the machine moving and vision at work in both."""

    number: int
    clients: bool
    seconds: float
    pairs: float
    replay_hz: float
    underruns: int
    run_frac: float  # share of the looks at the PLC that found it in RUN
    jobs: dict[str, int]
    cpu_frac: dict[str, float]
    load_average: float
    latencies_us: list[int]  # of every question, from when it was due; -1: never answered
    statuses: dict[str, int]
    broken: int
    late_start_max_us: int
    events: int
    event_bytes: int
    readers_at_end: int
    reader_events_min: int

    @property
    def pairs_per_s(self) -> float:
        """Stereo pairs that vision worked through a second."""
        return self.pairs / self.seconds


def block_from(data: dict[str, Any]) -> Block:
    """A block as it was saved; fields of a later version are passed over."""
    known = {field.name for field in dataclasses.fields(Block)}
    return Block(**{name: value for name, value in data.items() if name in known})


@dataclass(frozen=True, slots=True)
class Verdict:
    """All blocks together. `lost_frac`: against the rate replayed; `lost_by_clients_frac`: against the quiet blocks."""

    blocks: int
    questions: int
    p50_ms: float
    p99_ms: float
    max_ms: float
    unanswered: int
    not_200: int
    underruns: int
    pairs_per_s_quiet: float
    pairs_per_s: float
    lost_frac: float
    lost_by_clients_frac: float
    run_frac: float
    readers_lost: int
    events: int

    @property
    def holds(self) -> bool:
        """The acceptance: p99, underruns, vision (against the rate replayed), every reader and answer."""
        return (
            self.questions > 0
            and self.p99_ms <= P99_MAX_MS
            and self.underruns == 0
            and self.lost_frac <= LOST_MAX_FRAC
            and self.readers_lost == self.unanswered == self.not_200 == 0
        )


def verdict_of(blocks: Sequence[Block], readers: int) -> Verdict:
    """Of blocks of both kinds; a question never answered counts as slower than all others."""
    loaded, quiet = ([b for b in blocks if b.clients is kind] for kind in (True, False))
    latencies = [us for block in loaded for us in block.latencies_us]
    worst = max(latencies, default=0)
    late = percentiles([float(us if us >= 0 else max(worst, 10_000_000)) for us in latencies])
    rate = _rate(loaded)
    rate_quiet, replayed = _rate(quiet), _replayed(loaded)
    return Verdict(
        blocks=len(loaded),
        questions=len(latencies),
        p50_ms=late.p50_us / 1e3,
        p99_ms=late.p99_us / 1e3,
        max_ms=late.max_us / 1e3,
        unanswered=sum(us < 0 for us in latencies),
        not_200=sum(count for block in loaded for status, count in block.statuses.items() if status != "200"),
        underruns=sum(block.underruns for block in blocks),
        pairs_per_s_quiet=rate_quiet,
        pairs_per_s=rate,
        lost_frac=1.0 - rate / replayed if replayed else 0.0,
        lost_by_clients_frac=1.0 - rate / rate_quiet if rate_quiet else 0.0,
        run_frac=statistics.mean(block.run_frac for block in loaded) if loaded else 0.0,
        readers_lost=sum(readers - block.readers_at_end for block in loaded),
        events=sum(block.events for block in loaded),
    )


def _replayed(blocks: Sequence[Block]) -> float:
    return sum(b.replay_hz * b.seconds for b in blocks) / sum(b.seconds for b in blocks) if blocks else 0.0


def _rate(blocks: Sequence[Block]) -> float:
    return sum(block.pairs for block in blocks) / sum(block.seconds for block in blocks) if blocks else 0.0
