"""Evenly sampled pieces of a recording: each segment, cut where the log is broken."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.datagrams.sent import SentReference, arrivals_of, sent_within
from diagnosis.log.findings import Finding
from diagnosis.log.quality import DURATION_MIN_S, GAP_MIN_MEDIAN_STEPS, LOG_ROWS_MIN, SEGMENT_EDGE_TOLERANCE_S, too_long
from diagnosis.log.stamps import even_grid, taken_evenly
from diagnosis.log.tables import PlcTable, Tables
from diagnosis.noise.floor import encoder_step
from machine.effects.dynamics import Actuators
from machine.rotations import Array
from recording.run import Segment

INTERPOLATED_ROWS_MAX = 3  # a longer run of missing numbers cuts the log
STANDSTILL_RANGE_MAX_RAD = 2e-3  # no joint went further than this from where it was: one posture
SEGMENT_OVERLAP_ROWS_MAX = 2  # one segment may end where the next begins
# Of a step: rows whose stamps are closer to the even grid than this are taken as even
STAMP_JITTER_MAX_STEP_FRAC = 0.02


@dataclass(frozen=True, slots=True)
class Stretch:
    """One unbroken piece of one segment, evenly sampled on the PLC's clock.

    `t_s`: (m,), a step of `dt_s`; `t_segment_s`: of the segment's start, so that repeats can be laid over each other.
    Signals (m, n); None where not recorded. `sent_reference`: None where the link cannot be judged. `enc_step`:
    (n,) resolution of the encoders as they were logged, 0 where they show none. `ref_logged`: False where `ref` is what
    was sent.
    """

    name: str
    segment_kind: str
    repeat_of: str
    t_segment_s: float
    dt_s: float
    t_s: Array
    ref: Array | None
    enc: Array | None
    u: Array | None
    sent_reference: SentReference | None = None
    enc_step: Array | None = None
    ref_logged: bool = True

    @property
    def row_count(self) -> int:
        """Number of samples."""
        return len(self.t_s)

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return float(self.t_s[-1] - self.t_s[0])


def stood_still(stretches: tuple[Stretch, ...]) -> bool:
    """Whether every joint was asked and seen to stay at one place; False where its encoders were not logged."""
    for name in ("enc", "ref"):
        rows = [values for stretch in stretches if (values := getattr(stretch, name)) is not None]
        if not rows:
            if name == "enc":
                return False
            continue
        known = np.concatenate(rows)
        known = known[np.isfinite(known).all(axis=1)]
        if len(known) == 0 or np.ptp(known, axis=0).max() > STANDSTILL_RANGE_MAX_RAD:
            return False
    return bool(stretches)


def stretches_of(tables: Tables, plant: Actuators | None = None) -> tuple[tuple[Stretch, ...], list[Finding]]:
    """All usable stretches in the order of time, and what had to be left out.

    Args: plant: the machine file's, for the PLC's cycle; without it datagrams are taken to come on schedule.
    """
    plc = tables.plc
    if plc is None or (plc.enc is None and plc.ref is None):
        return (), []
    findings: list[Finding] = []
    segments = tables.run_info.segments or _whole_log_segment(plc, findings)
    came = arrivals_of(tables, plant, findings)
    enc_step = None if plc.enc is None else np.array([encoder_step(column) for column in plc.enc.T])
    broken = _unfillable_rows(plc)
    own, others = own_rows(plc.t_s, segments, findings)
    cut = [list(_gap_free_pieces(plc, broken, rows, GAP_MIN_MEDIAN_STEPS)) for rows in own]
    if not any(cut):
        cut = [list(_gap_free_pieces(plc, broken, rows, INTERPOLATED_ROWS_MAX + GAP_MIN_MEDIAN_STEPS)) for rows in own]
        findings += _bridged_rows_findings(cut)
    found: list[Stretch] = []
    named: Counter[str] = Counter()
    for number, (segment, pieces) in enumerate(zip(segments, cut, strict=True), start=1):
        if not pieces and number - 1 not in others:
            text = f"segment {number} ({segment.name or segment.kind}) holds no usable stretch of {DURATION_MIN_S:g} s"
            findings.append(Finding("empty_segment", "problem", "run.toml", text))
        label = segment.name or f"{segment.kind}{number}"
        named[label] += 1
        if named[label] > 1:  # what is known of a stretch is kept by its name
            label = f"{label} ({named[label]})"
        for part, rows in enumerate(pieces, start=1):
            name = f"{label}/{part}" if len(pieces) > 1 else label
            stretch = _build_stretch(plc, segment, name, rows, sent_within(tables, came, plc.t_s[rows]))
            found.append(replace(stretch, enc_step=enc_step))
    findings += [*_filled_number_findings(plc, broken), *_uneven_stamps(plc, cut, found)]
    return tuple(found), findings


def _whole_log_segment(plc: PlcTable, findings: list[Finding]) -> tuple[Segment, ...]:
    text = "there are no segments: the whole recording is taken as one, of unknown kind; name them to use repeats"
    findings.append(Finding("no_segments", "note", "run.toml", text))
    return (Segment("whole", "workcycle", float(np.nanmin(plc.t_s)), float(np.nanmax(plc.t_s))),)


def _uneven_stamps(plc: PlcTable, cut: list[list[NDArray[np.int64]]], found: list[Stretch]) -> list[Finding]:
    """Where the rows are taken as even although their stamps are not."""
    pieces = [rows for pieces in cut for rows in pieces]
    off = [
        float(np.abs(plc.t_s[rows] - stretch.t_s).max())
        for rows, stretch in zip(pieces, found, strict=True)
        if stretch.t_s[0] != plc.t_s[rows[0]]
    ]
    if not off:
        return []
    text = f"stamps are up to {1e3 * max(off):.2g} ms off an even rate, and the encoders moved at an even one"
    return [Finding("uneven_stamps", "note", "plc.csv", f"{text}: rows are taken as even", len(off))]


def _bridged_rows_findings(cut: list[list[NDArray[np.int64]]]) -> list[Finding]:
    if not any(cut):
        return []
    text = (
        f"rows are missing so often that no stretch is whole; up to {INTERPOLATED_ROWS_MAX} at a time are filled by "
        "lines"
    )
    return [Finding("bridged", "problem", "plc.csv", f"{text}: look at the logger")]


def own_rows(
    t_s: Array, segments: tuple[Segment, ...], findings: list[Finding]
) -> tuple[list[NDArray[np.int64]], set[int]]:
    """Row numbers of each segment; those that several share belong to one: a repeat's, else the shortest's.

    Returns: the rows, and which segments (from 0) have none since others' leave them too few.

    Why: a row that counts twice is not a second measurement. A sound recording whose every row lay in seven segments
         was said to have a cause outside the catalogue. Repeats that share rows are refused elsewhere.
    """
    inside = [
        np.nonzero(
            (t_s >= segment.t_start_plc_s - SEGMENT_EDGE_TOLERANCE_S)
            & (t_s <= segment.t_end_plc_s + SEGMENT_EDGE_TOLERANCE_S)
        )[0]
        for segment in segments
    ]
    repeated = {segment.repeat_of for segment in segments if segment.repeat_of}
    first = [bool(segment.repeat_of) or segment.name in repeated for segment in segments]
    taken, shared, left_out = np.zeros(len(t_s), dtype=bool), 0, set[int]()
    for k in sorted(range(len(segments)), key=lambda k: (not first[k], len(inside[k]))):
        again = taken[inside[k]]
        if not first[k] and again.sum() > SEGMENT_OVERLAP_ROWS_MAX:
            shared += int(again.sum())
            inside[k] = inside[k][~again]
            if len(inside[k]) < LOG_ROWS_MIN or np.ptp(t_s[inside[k]]) < DURATION_MIN_S:
                left_out.add(k)
                continue
        taken[inside[k]] = True
    if shared:
        text = f"{shared} rows lie in more than one segment; they count once, as a repeat's or else as the shortest's"
        text += f"; {len(left_out)} segments have no {DURATION_MIN_S:g} s of their own" if left_out else ""
        findings.append(Finding("segments_overlap", "note", "run.toml", text, shared))
    return [rows[:0] if k in left_out else rows for k, rows in enumerate(inside)], left_out


def _gap_free_pieces(
    plc: PlcTable, broken: NDArray[np.bool_], rows: NDArray[np.int64], longest: float
) -> Iterator[NDArray[np.int64]]:
    """The pieces of a segment's rows that are long enough, without a step of more than so many usual ones."""
    if len(rows) < 2:
        return
    steps = np.diff(plc.t_s[rows])
    median = float(np.median(np.abs(steps)))
    cut = too_long(steps, median, longest) | (steps <= 0.0) | (np.diff(rows) > 1)
    for piece in np.split(rows, np.nonzero(cut)[0] + 1):
        for part in np.split(piece, np.nonzero(np.diff(broken[piece].astype(int)))[0] + 1):
            if len(part) >= LOG_ROWS_MIN and not broken[part[0]] and np.ptp(plc.t_s[part]) >= DURATION_MIN_S:
                yield part


def _unfillable_rows(plc: PlcTable) -> NDArray[np.bool_]:
    """Rows inside a run of missing numbers too long to be filled (columns that are missing throughout do not count)."""
    broken = np.zeros(len(plc.t_s), dtype=bool)
    for values in (plc.ref, plc.enc, plc.u):
        for column in [] if values is None else values.T:
            missing = ~np.isfinite(column)
            if missing.all():
                continue
            edges = np.diff(np.concatenate([[0], missing.astype(int), [0]]))
            for start, end in zip(np.nonzero(edges > 0)[0], np.nonzero(edges < 0)[0], strict=True):
                if end - start > INTERPOLATED_ROWS_MAX or start == 0 or end == len(column):
                    broken[start:end] = True
    return broken


def _filled_number_findings(plc: PlcTable, broken: NDArray[np.bool_]) -> list[Finding]:
    count = 0
    for values in (plc.ref, plc.enc, plc.u):
        if values is not None:
            count += int((~np.isfinite(values) & ~broken[:, None] & ~np.isnan(values).all(axis=0)).sum())
    if not count:
        return []
    text = (
        f"{count} single missing numbers (runs of {INTERPOLATED_ROWS_MAX} rows or fewer) are filled by straight lines"
    )
    return [Finding("not_a_number", "note", "plc.csv", text, count)]


def _build_stretch(
    plc: PlcTable, segment: Segment, name: str, rows: NDArray[np.int64], sent: SentReference | None
) -> Stretch:
    t = plc.t_s[rows]
    dt = float((t[-1] - t[0]) / (len(t) - 1))
    grid = t[0] + dt * np.arange(len(t))
    when = t
    if np.abs(t - grid).max() <= STAMP_JITTER_MAX_STEP_FRAC * dt:
        when = grid
    elif taken_evenly(None if plc.enc is None else plc.enc[rows], t, nearest := even_grid(t)):
        when = grid = nearest
        dt = float(nearest[1] - nearest[0])
    signals = {name: _resample_signal(getattr(plc, name), rows, when, grid) for name in ("ref", "enc", "u")}
    repeat = segment.repeat_of
    return Stretch(
        name,
        segment.kind,
        repeat,
        segment.t_start_plc_s,
        dt,
        grid,
        **signals,
        sent_reference=sent,
        ref_logged=plc.ref_logged,
    )


def _resample_signal(values: Array | None, rows: NDArray[np.int64], when: Array, grid: Array) -> Array | None:
    """A signal's rows (m, n), taken at `when` (m,), on the grid."""
    if values is None:
        return None
    table = values[rows]
    if when is not grid or not np.isfinite(table).all():
        table = np.stack([_interpolate_linear(column, when, grid) for column in table.T], axis=1)
    return np.ascontiguousarray(table)


def _interpolate_linear(column: Array, t: Array, grid: Array) -> Array:
    good = np.isfinite(column)
    return np.interp(grid, t[good], column[good]) if good.any() else np.full(len(grid), np.nan)


def repeat_groups(stretches: tuple[Stretch, ...]) -> dict[str, tuple[Stretch, ...]]:
    """Stretches that repeat one command, by the name they share; at least two, and whole segments only.

    The segment that the others repeat belongs to its group, whether or not it names itself.
    """
    groups: dict[str, list[Stretch]] = {}
    for stretch in stretches:
        if stretch.repeat_of and "/" not in stretch.name:
            groups.setdefault(stretch.repeat_of, []).append(stretch)
    for stretch in stretches:
        if not stretch.repeat_of and stretch.name in groups:
            groups[stretch.name].insert(0, stretch)
    return {name: tuple(members) for name, members in groups.items() if len(members) > 1}
