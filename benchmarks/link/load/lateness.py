"""How late sends were, over a whole run: every value is kept, 50 a second. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

EARLY_SHARE = 0.002  # of all sends may seem to be too early
_EARLY_MAX_NS = 10_000_000  # by at most this much; what comes still earlier belongs to no deadline that is known


@dataclass(frozen=True, slots=True)
class Percentiles:
    """Of some times [us]; all 0 without any."""

    n: int = 0
    p50_us: float = 0.0
    p99_us: float = 0.0
    max_us: float = 0.0


def percentiles(values_us: Sequence[float]) -> Percentiles:
    """Median, 99th percentile (nearest rank) and maximum."""
    if not values_us:
        return Percentiles()
    ordered = sorted(values_us)
    n = len(ordered)
    return Percentiles(n, ordered[n // 2], ordered[min(n - 1, n * 99 // 100)], ordered[-1])


def lateness_us(sent_ns: Sequence[int], period_ns: int) -> list[int]:
    """How far each send was behind its deadline, as far as that shows from outside [us].

    Model:   deadlines lie on a grid of one period, whose phase is that of the earliest sends; a send belongs to the
             first deadline after the send before it, so that a send more than a period late counts in full.
    Args:    sent_ns: times of the sends, rising [ns].
    """
    if not sent_ns:
        return []
    phase_ns = _phase_ns(sent_ns, period_ns)
    due_ns = sent_ns[0] - (sent_ns[0] - phase_ns) % period_ns
    late: list[int] = []
    for t_ns in sent_ns:
        early = t_ns < due_ns and due_ns - t_ns < _EARLY_MAX_NS
        late.append(max(0, t_ns - due_ns) // 1000)
        due_ns = (due_ns if early else t_ns - (t_ns - phase_ns) % period_ns) + period_ns
    return late


def _phase_ns(sent_ns: Sequence[int], period_ns: int) -> int:
    """Where in the period the sends begin: behind the widest stretch of it in which none falls.

    The earliest few are passed over: a time stamp may be wrong by what its process was held up in between.
    """
    places = sorted(t_ns % period_ns for t_ns in sent_ns)
    before = [places[-1] - period_ns, *places[:-1]]
    first = max(range(len(places)), key=lambda i: places[i] - before[i])
    return places[(first + round(EARLY_SHARE * len(places))) % len(places)]
