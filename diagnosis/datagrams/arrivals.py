"""When each datagram took effect, as far as the log's rows bound it, and which of them never came.

A datagram waits for the PLC's next cycle, the network takes a millisecond more or less, and two computers' clocks drift
apart by twenty millionths: none of it is a fault. A link that is replayed as if every reference had come on schedule
leaves that in the link, and through it in controllers and actuators.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from diagnosis.datagrams.lost import (
    TIME_TOLERANCE_S,
    Mask,
    Numbered,
    late_enough,
    lost_rather_than_late,
    never_came,
    never_received,
)
from machine.rotations import Array

STEADY_DELAY_TOLERANCE_S = 5e-4  # a steady delay below it is not one, but the wait for the next cycle
# Where each cycle is logged and longer than this, rows themselves show when a datagram came
RESOLVED_CYCLE_MIN_S = 1.5e-3
CLOCK_DRIFT_RATE_MAX = 2e-4  # by which two clocks may run apart
TYPICAL_CLOCK_DRIFT_RATE = 1.5e-4  # of two crystals
CLOCK_DRIFT_TRIALS_PER_SIDE = 20  # tried to either side
DRIFT_CONTRADICTION_RATIO_MAX = 0.78  # of the rows that a steady delay contradicts
LATE_DATAGRAM_MAX_FRAC = 2e-3  # of the datagrams: what is late more often is a fault, or a drift of the clocks
CONTRADICTED_ROWS_MAX_FRAC = 0.01  # of the rows, that may contradict a line more than they contradict the best one
MATCHED_ROWS_MIN = 50
DELAY_SEARCH_ROWS_MAX = 4000
CLOCK_DRIFT_TRIALS_MAX = 500  # tried to either side: one stamp a year away is not a drift
DRIFT_GRID_REFINEMENT = 8
ROW_PERIOD_RATIO_MAX = 1.5


@dataclass(frozen=True, slots=True)
class Arrivals:
    """Datagrams as they were sent, (k,) each, and as the rows show them.

    `t_s`: when it was sent, on the PLC's clock, moved by how far its arrival was off the link's steady delay.
    `earliest_s`, `latest_s`: between which two rows it came, infinite where none show it.
    `datagram_lost`: it never came; `loss_observable`: a row shows whether it did. None where no numbers were logged.
    `jitter_s`: how far they lie off a steady delay, RMS. `unsure_s`: how far arrivals that no row shows may lie off
    `t_s`, a standard deviation.
    """

    t_s: Array
    earliest_s: Array
    latest_s: Array
    datagram_lost: Mask | None
    loss_observable: Mask | None
    jitter_s: float = 0.0
    clock_drift_rate: float = 0.0
    unsure_s: float = 0.0


@dataclass(frozen=True, slots=True)
class _DelayBounds:
    """Rows (m,) that show a datagram: when, which, and `delay_low_s` < its delay <= `delay_high_s`."""

    t_s: Array
    datagram_index: NDArray[np.int64]
    delay_low_s: Array
    delay_high_s: Array

    def with_clock_drift(self, rate: float) -> Self:
        """As they would be, had the clocks run apart by `rate` from the middle of the rows on."""
        off = rate * (self.t_s - self.middle_s)
        return type(self)(self.t_s, self.datagram_index, self.delay_low_s - off, self.delay_high_s - off)

    @property
    def middle_s(self) -> float:
        """Half way through."""
        return 0.5 * float(self.t_s[0] + self.t_s[-1])

    @property
    def span_s(self) -> float:
        """From the first row to the last."""
        return float(self.t_s[-1] - self.t_s[0])

    def subsample_rows(self, most: int) -> Self:
        """About so many of the rows, spread over all."""
        every = slice(None, None, max(1, len(self.t_s) // most))
        return type(self)(
            self.t_s[every], self.datagram_index[every], self.delay_low_s[every], self.delay_high_s[every]
        )


@dataclass(frozen=True, slots=True)
class _DelayInterval:
    """Delays [s] that contradict the fewest rows, at `clock_drift_rate`."""

    least_s: float
    most_s: float
    contradicted_rows_frac: float
    clock_drift_rate: float = 0.0

    def nearest(self, to_s: float) -> float:
        """The one nearest to a given delay."""
        return float(np.clip(to_s, self.least_s, self.most_s))


def arrival_times(
    sent: Numbered,
    rows: Numbered,
    cycle_s: float,
    nominal_s: float,
    clock_known: bool = True,
) -> Arrivals:
    """When each datagram took effect, after a steady delay and its own jitter.

    Args:    sent: when (k,) [s] on the PLC's clock, and number (k,). rows: when (m,) [s], and the number of the last
             datagram received, negative where not logged. cycle_s: the PLC's. nominal_s: delay of the machine file.
             clock_known: whether the two clocks' offset is; without, a steady delay is whatever it may be at the least.
    Model:   the delay that contradicts the fewest rows, the one nearest to the machine file's; with clocks that run
             apart only where that halves the contradictions. A delay below STEADY_DELAY_TOLERANCE_S counts as 0. What
             stays is moved into the interval in which the rows saw the datagram appear, if that is no further away than
             a cycle and a sending period: beyond, it is a fault of the link.
    """
    known = on_schedule(sent, rows)
    bounds = _delay_bounds(sent, rows)
    if bounds is None:
        return known
    period_s = float(np.median(np.diff(sent[0])))
    if cycle_s > RESOLVED_CYCLE_MIN_S and float(np.median(np.diff(rows[0]))) < ROW_PERIOD_RATIO_MAX * cycle_s:
        return _now_and_then(known, bounds, cycle_s, nominal_s)
    most_s = cycle_s + period_s
    delay = _steady_or_drifting_delay(bounds, nominal_s, most_s)
    if (
        clock_known
        and delay.clock_drift_rate == 0.0
        and abs(delay.nearest(nominal_s) - nominal_s) > STEADY_DELAY_TOLERANCE_S
    ):
        delay = _least_drift_delay(bounds, nominal_s, delay)
    off = delay.clock_drift_rate * (sent[0] - bounds.middle_s)
    ends = np.array([-0.5, 0.5]) * delay.clock_drift_rate * bounds.span_s
    near = delay.nearest(nominal_s)
    away = near - nominal_s + ends
    named = 0.0
    if not clock_known:
        near = delay.least_s
    elif away.min() > STEADY_DELAY_TOLERANCE_S or away.max() < -STEADY_DELAY_TOLERANCE_S:
        near = 0.5 * (delay.least_s + delay.most_s)
        named = float(near - nominal_s + ends[np.argmin(np.abs(near - nominal_s + ends))])
    came = sent[0] + near + off
    lost, judged = known.datagram_lost, known.loss_observable
    if lost is None:
        lost, judged = never_came(came, (bounds.t_s, bounds.datagram_index))
    with_next = np.zeros(len(came), dtype=bool)
    if known.datagram_lost is not None and late_enough(known.datagram_lost, came, (bounds.t_s, bounds.datagram_index)):
        lost, with_next = with_next, known.datagram_lost
    earliest, latest = _rows_around(bounds, len(came), cycle_s)
    moved = _correction_into_rows(earliest, latest, came)
    moved[(np.abs(moved) > most_s) & ~with_next] = 0.0
    if lost is not None:
        moved[lost] = 0.0
    if named:
        named += float(np.median(moved))
    t_s = np.maximum.accumulate(came + moved - nominal_s - named)
    waited = _cycle_of(came + moved, bounds, cycle_s) - _cycle_of(came, bounds, cycle_s)
    some = np.mean(waited != 0.0) > CONTRADICTED_ROWS_MAX_FRAC  # a segment's first datagram may have been there before
    jitter_s = cycle_s * float(np.sqrt(np.mean(waited**2))) if some else 0.0
    share = float(np.mean(lost[judged])) if lost is not None and judged is not None and judged.any() else 0.0
    # Each waits up to one cycle for the next, punctual or not: what a network adds is often a tenth of a millisecond.
    unsure_s = float(np.linalg.norm([jitter_s, cycle_s, np.sqrt(share * (1.0 - share)) * period_s]))
    return Arrivals(t_s, earliest, latest, lost, judged, jitter_s, delay.clock_drift_rate, unsure_s)


def on_schedule(sent: Numbered, rows: Numbered) -> Arrivals:
    """Datagrams taken to have come when they were sent."""
    nowhere = np.full(len(sent[0]), np.inf)
    return Arrivals(sent[0], -nowhere, nowhere, *never_received(sent, rows))


def _now_and_then(known: Arrivals, bounds: _DelayBounds, cycle_s: float, nominal_s: float) -> Arrivals:
    """Where every cycle has a row: all on schedule but for the few that a row showed one later than they were due.

    Counted in rows, whatever their stamps are. One that no row shows is lost, or came with the next one: not late.
    """
    delay = _least_missed(bounds, nominal_s)
    if delay.most_s < nominal_s - TIME_TOLERANCE_S:  # no fault of a link makes it faster
        delay = _least_drift_delay(bounds, nominal_s, delay)
        if delay.clock_drift_rate:
            drifted = known.t_s + delay.least_s - nominal_s + delay.clock_drift_rate * (known.t_s - bounds.middle_s)
            _, shown_s = _rows_around(bounds, len(drifted), cycle_s)
            taken = np.where(np.abs(shown_s - drifted - nominal_s) < cycle_s, shown_s - nominal_s, drifted)
            known = replace(known, t_s=np.maximum.accumulate(taken), clock_drift_rate=delay.clock_drift_rate)
            delay = replace(delay, least_s=nominal_s, most_s=nominal_s)
    inside = delay.least_s <= nominal_s <= delay.most_s
    came = known.t_s + (nominal_s if inside else 0.5 * (delay.least_s + delay.most_s))
    shown, first = np.unique(bounds.datagram_index, return_index=True)
    late = np.zeros(len(came), dtype=bool)
    late[shown] = first - np.searchsorted(bounds.t_s, came[shown] - TIME_TOLERANCE_S) == 1
    if np.mean(late) > LATE_DATAGRAM_MAX_FRAC:
        return known
    if known.datagram_lost is None:
        lost, judged = never_came(came, (bounds.t_s, bounds.datagram_index))
        if lost is not None and judged is not None and lost_rather_than_late(lost, judged, int(late.sum())):
            known = replace(known, datagram_lost=lost, loss_observable=judged)
    return replace(known, t_s=np.maximum.accumulate(known.t_s + cycle_s * late))


def _delay_bounds(sent: Numbered, rows: Numbered) -> _DelayBounds | None:
    """What the rows say of the delay; None where numbers are missing, or not in order."""
    t_sent, number = sent
    t_row, seq = rows
    if len(number) < 2 or (np.diff(number) <= 0).any() or not (np.diff(t_sent) >= 0.0).all():
        return None
    if not np.isfinite(t_sent[[0, -1]]).all():
        return None
    at = np.searchsorted(number, seq)
    there = np.isfinite(t_row) & (seq >= 0) & (at < len(number))
    there[there] &= number[at[there]] == seq[there]
    t, shown = t_row[there], at[there].astype(np.int64)
    if len(t) < MATCHED_ROWS_MIN or (np.diff(t) <= 0.0).any() or (np.diff(shown) < 0).any():
        return None
    as_frequent = float(np.median(np.diff(t))) <= float(np.median(np.diff(t_sent))) + TIME_TOLERANCE_S
    following = _next_shown(t_sent, shown) if as_frequent else np.append(t_sent, np.inf)[shown + 1]
    return _DelayBounds(t, shown, t - following, t - t_sent[shown])


def _next_shown(t_sent: Array, shown: NDArray[np.int64]) -> Array:
    """When (m,) the next datagram was sent that any row shows: where rows are as frequent, the others may be lost."""
    seen = np.unique(shown)
    return np.append(t_sent[seen], np.inf)[np.searchsorted(seen, shown, side="right")]


def _steady_or_drifting_delay(bounds: _DelayBounds, nominal_s: float, most_s: float) -> _DelayInterval:
    """The delay, with a drift of the clocks only where that contradicts less than half as many rows as a steady one.

    Rates are tried that lie half of most_s apart at the ends.
    """
    steady = _least_missed(bounds, nominal_s)
    if steady.contradicted_rows_frac <= CONTRADICTED_ROWS_MAX_FRAC:
        return steady
    some = bounds.subsample_rows(DELAY_SEARCH_ROWS_MAX)
    step = min(0.5 * most_s / max(bounds.span_s, most_s), 0.25 * CLOCK_DRIFT_RATE_MAX)
    steps = min(int(CLOCK_DRIFT_RATE_MAX / step), CLOCK_DRIFT_TRIALS_MAX)
    best = _least_rate(some, nominal_s, [step * k for k in range(-steps, steps + 1)])
    best = _least_rate(
        some,
        nominal_s,
        [best + step * k / DRIFT_GRID_REFINEMENT for k in range(-DRIFT_GRID_REFINEMENT, DRIFT_GRID_REFINEMENT + 1)],
    )
    found = _least_missed(bounds.with_clock_drift(best), nominal_s)
    better = found.contradicted_rows_frac < 0.5 * steady.contradicted_rows_frac
    return _DelayInterval(found.least_s, found.most_s, found.contradicted_rows_frac, best) if better else steady


def _least_drift_delay(bounds: _DelayBounds, nominal_s: float, steady: _DelayInterval) -> _DelayInterval:
    """The least drift of the clocks from no delay at the first or the last row that contradicts hardly any row, or
    clearly fewer than a steady delay; else that delay.

    Why: two clocks that run apart by seventy millionths are five milliseconds apart after a minute, and every 20 ms a
         datagram shows no more: that was taken for a delay.
    """
    step = TYPICAL_CLOCK_DRIFT_RATE / CLOCK_DRIFT_TRIALS_PER_SIDE
    for rate in sorted(
        (step * k for k in range(-CLOCK_DRIFT_TRIALS_PER_SIDE, CLOCK_DRIFT_TRIALS_PER_SIDE + 1) if k), key=abs
    ):
        leaning = bounds.with_clock_drift(rate)
        for near in (nominal_s + 0.5 * rate * bounds.span_s, nominal_s - 0.5 * rate * bounds.span_s):
            early, late = leaning.delay_low_s + TIME_TOLERANCE_S - near, near - leaning.delay_high_s - TIME_TOLERANCE_S
            misses = float(np.mean((early > 0.0) | (late > 0.0)))
            if misses <= max(CONTRADICTED_ROWS_MAX_FRAC, DRIFT_CONTRADICTION_RATIO_MAX * steady.contradicted_rows_frac):
                return _DelayInterval(near, near, misses, rate)
    return steady


def _least_rate(bounds: _DelayBounds, nominal_s: float, rates: list[float]) -> float:
    """Of the rates that contradict about the fewest rows, the one in the middle."""
    misses = np.array(
        [_least_missed(bounds.with_clock_drift(rate), nominal_s).contradicted_rows_frac for rate in rates]
    )
    return float(np.mean(np.array(rates)[misses <= misses.min() + CONTRADICTED_ROWS_MAX_FRAC]))


def _least_missed(bounds: _DelayBounds, nominal_s: float) -> _DelayInterval:
    """The range of steady delays that contradict about the fewest rows."""
    low, high = np.sort(bounds.delay_low_s + TIME_TOLERANCE_S), np.sort(bounds.delay_high_s)
    low_end = np.unique(np.round(np.concatenate([low, high, [nominal_s]]), 7))
    tried = low_end[np.isfinite(low_end)]
    too_early = len(low) - np.searchsorted(low - 0.5 * TIME_TOLERANCE_S, tried, side="right")
    too_late = np.searchsorted(high + 0.5 * TIME_TOLERANCE_S, tried, side="left")
    misses = (too_early + too_late) / len(low)
    good = misses <= misses.min() + CONTRADICTED_ROWS_MAX_FRAC
    best = int(np.argmin(np.where(good, np.abs(tried - nominal_s), np.inf)))
    first, last = best, best
    while first > 0 and good[first - 1]:
        first -= 1
    while last < len(tried) - 1 and good[last + 1]:
        last += 1
    return _DelayInterval(float(tried[first]), float(tried[last]), float(misses[best]))


def _cycle_of(t_s: Array, bounds: _DelayBounds, cycle_s: float) -> Array:
    """The cycle (k,) that takes what comes at t_s (k,)."""
    return np.ceil((t_s - bounds.t_s[0] - 0.1 * TIME_TOLERANCE_S) / cycle_s)


def _rows_around(bounds: _DelayBounds, count: int, cycle_s: float) -> tuple[Array, Array]:
    """The cycle after the last row that does not show a datagram yet (k,), and the first row that does, or a later one.

    Infinite where there is none.
    """
    first = np.searchsorted(bounds.datagram_index, np.arange(count), side="left")
    hi = np.append(bounds.t_s, np.inf)[first]
    lo = np.append(-np.inf, bounds.t_s)[first] + cycle_s
    return np.minimum(lo, hi), hi


def _correction_into_rows(earliest: Array, latest: Array, came: Array) -> Array:
    """By how much each arrival (k,) lies outside the two rows between which the log saw it appear."""
    moved = np.where(np.isfinite(earliest + latest), np.clip(came, earliest, latest) - came, 0.0)
    moved[np.abs(moved) < TIME_TOLERANCE_S] = 0.0
    return moved
