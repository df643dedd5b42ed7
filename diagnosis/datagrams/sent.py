"""References as they were sent, on the PLC's clock: by which offset, and when each took effect."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.datagrams.arrivals import Arrivals, arrival_times, on_schedule
from diagnosis.log.findings import Finding
from diagnosis.log.quality import LOG_ROWS_MIN
from diagnosis.log.tables import Tables
from machine.effects.dynamics import Actuators
from machine.rotations import Array

# Which datagram a log row holds, where numbers were not logged: the one with the row's own reference.
SAME_REFERENCE_TOLERANCE_RAD = 1e-9
DATAGRAM_AGE_MAX_S = 0.5  # of a datagram: an older one with the same values is chance
DATAGRAMS_AHEAD_MAX = 2  # datagrams later than a row's time, for clocks that are a little off
DATAGRAMS_BACK_MAX = 200


def by_value(rows: tuple[Array, Array], sent: tuple[Array, Array]) -> NDArray[np.int64]:
    """Which datagram each row (m,) holds, counted from 0; -1 where none has its values, or its neighbours have, too.

    Args: rows, sent: when [s], (m,) and (k,), on one clock, and the reference (m, n) and (k, n) [rad].
    """
    (t_row, ref), (t_sent, q) = rows, sent
    found = np.full(len(t_row), -1, dtype=np.int64)
    if len(t_sent) < 2 or ref.shape[1:] != q.shape[1:]:
        return found
    alone = np.ones(len(q), dtype=bool)
    stays = _equal_rows(q[1:], q[:-1])
    alone[1:] &= ~stays
    alone[:-1] &= ~stays
    last = np.searchsorted(t_sent, t_row, side="right") - 1
    period_s = float(np.nanmedian(np.abs(np.diff(t_sent)))) if np.isfinite(t_sent).sum() > 1 else 0.0
    tried = (
        int(DATAGRAM_AGE_MAX_S / period_s) if period_s * DATAGRAMS_BACK_MAX > DATAGRAM_AGE_MAX_S else DATAGRAMS_BACK_MAX
    )
    for back in range(-DATAGRAMS_AHEAD_MAX, tried + 1):
        at = last - back
        open_ = np.nonzero((found < 0) & (at >= 0) & (at < len(q)))[0]
        fits = alone[at[open_]] & _equal_rows(ref[open_], q[at[open_]])
        found[open_[fits]] = at[open_[fits]]
    return found


def _equal_rows(a: Array, b: Array) -> NDArray[np.bool_]:
    """Rows whose known numbers are all the same, and some are known."""
    apart = np.abs(a - b)
    return np.asarray(
        (np.isnan(apart) | (apart < SAME_REFERENCE_TOLERANCE_RAD)).all(axis=1) & np.isfinite(apart).any(axis=1)
    )


EARLY_ARRIVAL_MIN_S = 1e-6  # a datagram arrives before it was sent, by more than rounding: the offset given is wrong
EARLY_ARRIVAL_MAX_S = 0.02  # beyond it the numbers are wrong, not the clocks
REPORTED_JITTER_MIN_S = 1e-4  # arrivals that are further off a steady delay, RMS, are reported
REPORTED_DRIFT_RATE_MIN = 5e-6  # so is a drift of the clocks


@dataclass(frozen=True, slots=True)
class SentReference:
    """The reference as sent, on the PLC's clock: t_s (k,), q (k, n); begins before the stretch does.

    `within_s` (2, k): between which times it came, by the log rows; None: unknown. `datagram_lost` (k,): datagrams that
    never arrived; None where the log cannot show it. `loss_observable` (k,): those that it can show; None: all.
    `unsure_s`: by how much those that no log row shows may have come at other times, a deviation.
    """

    t_s: Array
    q: Array
    datagram_lost: NDArray[np.bool_] | None = None
    loss_observable: NDArray[np.bool_] | None = None
    within_s: Array | None = None
    unsure_s: float = 0.0
    drift_s: float = 0.0


@dataclass(frozen=True, slots=True)
class SentClock:
    """How sent times become the PLC's: t_plc = t_pc - offset. `offset_given`: not estimated from the data."""

    offset_s: float
    offset_given: bool


def sent_clock(tables: Tables, findings: list[Finding]) -> SentClock | None:
    """The offset between the PC's and the PLC's clock; estimated from sequence numbers where not given.

    Model: without an offset the fastest datagram is taken to arrive with no delay: delays are known but for a constant.
           So it is with one by which datagrams arrive a little before they were sent.
    """
    if tables.sent is None:
        return None
    given = tables.run_info.plc_to_pc_offset_s
    delays = _apparent_delays(tables)
    if given is not None:
        if not _is_sent_during_log(tables, given):
            text = f"clocks.plc_to_pc_offset_s = {given:g} puts sent and plc rows at times that never meet"
            text += ": the link is not judged; give t_pc - t_plc"
            findings.append(Finding("clock_offset_wrong", "problem", "run.toml", text))
            return None
        early_s = -(float(delays.min()) + given) if len(delays) else 0.0
        if not EARLY_ARRIVAL_MIN_S < early_s < EARLY_ARRIVAL_MAX_S:
            return SentClock(given, True)
        text = (
            f"clocks.plc_to_pc_offset_s = {given:g}: datagrams arrive up to {1e3 * early_s:.2g} ms before they were "
            "sent; the link's delay is known but for a constant (the fastest datagram counts as 0): measure it again"
        )
        findings.append(Finding("clock_offset_wrong", "note", "run.toml", text))
        return SentClock(-float(delays.min()), False)
    if len(delays) == 0:
        text = "no clocks.plc_to_pc_offset_s and no sequence numbers: sent and received reference cannot be compared"
        findings.append(Finding("clock_offset_unknown", "problem", "run.toml", text))
        return None
    text = (
        "no clocks.plc_to_pc_offset_s: the link's delay is known but for a constant (the fastest datagram counts as 0)"
    )
    findings.append(Finding("clock_offset_unknown", "note", "run.toml", text))
    return SentClock(-float(delays.min()), False)


def _is_sent_during_log(tables: Tables, offset_s: float) -> bool:
    """Whether datagrams were sent, by this offset, while the PLC logged, or shortly before."""
    if tables.sent is None or tables.plc is None:
        return True
    sent, rows = (t_s[np.isfinite(t_s)] for t_s in (tables.sent.t_s - offset_s, tables.plc.t_s))
    if not len(sent) or not len(rows):
        return True
    return bool(sent.min() <= rows.max() and sent.max() >= rows.min() - EARLY_ARRIVAL_MAX_S)


def arrivals_of(tables: Tables, plant: Actuators | None, findings: list[Finding]) -> Arrivals | None:
    """When each datagram took effect; None where sent and received cannot be compared."""
    clock = sent_clock(tables, findings)
    if clock is None or tables.sent is None or tables.plc is None:
        return None
    sent, rows = (tables.sent.t_s - clock.offset_s, tables.sent.seq), (tables.plc.t_s, tables.plc.seq)
    if (rows[1] < 0).all() and tables.plc.ref is not None:
        number = by_value((rows[0], tables.plc.ref), (sent[0], tables.sent.q))
        sent, rows = (sent[0], np.arange(len(sent[0]))), (rows[0], number)
    if plant is None:
        return on_schedule(sent, rows)
    came = arrival_times(sent, rows, plant.cycle_s, plant.transport_delay_s, clock.offset_given)
    if came.jitter_s > REPORTED_JITTER_MIN_S or abs(came.clock_drift_rate) > REPORTED_DRIFT_RATE_MIN:
        drift = (
            f", and the clocks drift by {1e6 * came.clock_drift_rate:.0f} ppm"
            if abs(came.clock_drift_rate) > REPORTED_DRIFT_RATE_MIN
            else ""
        )
        text = (
            f"datagrams reach the PLC {1e3 * came.jitter_s:.2g} ms (RMS) off a steady delay{drift}: each is "
            "replayed as the rows show it; delays and lags that short cannot be measured"
        )
        findings.append(Finding("uneven_arrivals", "note", "plc.csv", text))
    return came


def sent_within(tables: Tables, came: Arrivals | None, t_plc_s: Array) -> SentReference | None:
    """References from the last one before the stretch with log rows at t_plc_s (or 2 s before it) to its end."""
    if came is None or tables.sent is None:
        return None
    t = came.t_s
    good = np.isfinite(t) & np.isfinite(tables.sent.q).all(axis=1) & (t >= t_plc_s[0] - 2.0) & (t <= t_plc_s[-1])
    if int(good.sum()) < LOG_ROWS_MIN:
        return None
    order = np.argsort(t[good], kind="stable")
    return SentReference(
        t[good][order],
        np.ascontiguousarray(tables.sent.q[good][order]),
        None if came.datagram_lost is None else came.datagram_lost[good][order],
        None if came.loss_observable is None else came.loss_observable[good][order],
        np.stack([came.earliest_s, came.latest_s])[:, good][:, order],
        came.unsure_s,
        abs(came.clock_drift_rate) * float(np.ptp(t[np.isfinite(t)])),
    )


def _apparent_delays(tables: Tables) -> Array:
    """t_plc - t_pc of each datagram at the first log row that has it."""
    sent, plc = tables.sent, tables.plc
    if sent is None or plc is None or (plc.seq < 0).all():
        return np.zeros(0)
    number, first = np.unique(plc.seq, return_index=True)
    both, at_plc, at_pc = np.intersect1d(number, sent.seq, return_indices=True)
    keep = both >= 0
    return plc.t_s[first[at_plc[keep]]] - sent.t_s[at_pc[keep]]
