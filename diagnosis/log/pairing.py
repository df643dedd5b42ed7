"""Whether each joint's columns belong together: reference, encoder and valve command of one joint move alike."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.log.findings import Finding
from diagnosis.log.tables import PlcTable, Tables, fill_gaps
from machine.rotations import Array
from recording.run import Segment

BLOCK_DURATION_S = 0.1
LAG_MAX_S = 3.0  # a slow position loop trails its reference by a second or two
OWN_MAX, OTHER_MIN = 0.6, 0.9  # correlation with the own column below, with the other one above: exchanged
REVERSED_CORRELATION_MAX = -0.9
SIGN_AMBIGUITY_MARGIN = 0.1  # an oscillation is as like its own opposite half a period later: so little shows no sign
FOLLOWED_MOTION_RATIO_MIN = 0.5  # of the reference's motion: a joint that moves less may drift its own way
CORRELATION_BLOCKS_MIN = 20  # a correlation over fewer means nothing
SEGMENT_MOTION_MIN_FRAC = 0.2  # of the whole recording's motion: a segment of less says nothing about signs


def pairing_findings(tables: Tables) -> list[Finding]:
    """Exchanged and reversed columns between reference and encoder, and between command and encoder's speed."""
    plc = tables.plc
    if plc is None or plc.enc is None:
        return []
    findings: list[Finding] = []
    for name, of in (("u_{j}_frac", _speed_and_command), ("q_ref_{j}_rad", _encoder_and_reference)):
        whole = of(plc)
        if whole is None or len(whole[0]) < CORRELATION_BLOCKS_MIN:
            continue
        table = _peak_lag_correlations(*whole)
        own = _swapped_column_findings("plc.csv", "q_{j}_rad", name, table)
        moved = SEGMENT_MOTION_MIN_FRAC * whole[1].std(axis=0)
        findings += own or _reversed_in_segments(plc, tables.run_info.segments, name, of, moved)
    return findings or _copied_encoder_findings(plc) or _reversed_positions(plc) or _command_for_encoder(plc)


def _copied_encoder_findings(plc: PlcTable) -> list[Finding]:
    """Joints whose encoder is their reference to the last digit while it moves: nothing was measured."""
    if plc.enc is None or plc.ref is None or plc.enc.shape != plc.ref.shape:
        return []
    same = (plc.enc == plc.ref).all(axis=0) & (np.ptp(plc.ref, axis=0) > 0.0)
    return [
        Finding(
            "copied_column",
            "fatal",
            "plc.csv",
            f"q_{j}_rad is q_ref_{j}_rad to the last digit in every row, though it moves: one of them was written "
            "twice; record the encoder",
        )
        for j in (np.nonzero(same)[0] + 1).tolist()
    ]


def _reversed_positions(plc: PlcTable) -> list[Finding]:
    """The signs by positions: a loop that hunts drowns what its increments say. A joint that hardly moves may sag."""
    if plc.enc is None or plc.ref is None:
        return []
    size = _rows_per_block(plc)
    enc, ref = _block_means(fill_gaps(plc.enc), size), _block_means(fill_gaps(plc.ref), size)
    if len(enc) < CORRELATION_BLOCKS_MIN:
        return []
    table = _peak_lag_correlations(enc, ref, round(LAG_MAX_S / BLOCK_DURATION_S))
    table[enc.std(axis=0) < FOLLOWED_MOTION_RATIO_MIN * ref.std(axis=0)] = 0.0
    found = _swapped_column_findings("plc.csv", "q_{j}_rad", "q_ref_{j}_rad", table)
    return [finding for finding in found if finding.code == "reversed_column"]


def _command_for_encoder(plc: PlcTable) -> list[Finding]:
    """Joints whose valve command stands in the encoder's column and the other way round."""
    as_written, exchanged = _speed_and_command(plc), _speed_and_command(replace(plc, enc=plc.u, u=plc.enc))
    if as_written is None or exchanged is None or len(as_written[0]) < CORRELATION_BLOCKS_MIN:
        return []
    own, other = (np.diag(_peak_lag_correlations(*both)) for both in (as_written, exchanged))
    return [
        Finding(
            "swapped_columns",
            "fatal",
            "plc.csv",
            f"u_{j}_frac moves as q_{j}_rad says (correlation {other[j - 1]:.2f}), and q_{j}_rad not as u_{j}_frac "
            f"({own[j - 1]:.2f}): the two are exchanged",
        )
        for j in (np.nonzero((other > OTHER_MIN) & (own < OWN_MAX))[0] + 1).tolist()
    ]


Both = tuple[Array, Array, int]  # what moves and what should move it (blocks, n), and the most blocks between the two


def _reversed_in_segments(
    plc: PlcTable, segments: tuple[Segment, ...], other: str, of: Callable[[PlcTable], Both | None], least: Array
) -> list[Finding]:
    """Columns that run against each other in some segments only: a sign that was changed while recording.

    Args: least: of each joint (n,), the motion that a segment has to hold to say anything.
    """
    wrong: dict[int, list[str]] = {}
    for segment in segments:
        inside = (plc.t_s >= segment.t_start_plc_s) & (plc.t_s <= segment.t_end_plc_s)
        here = of(_select_log_rows(plc, inside)) if inside.any() else None
        if here is None or len(here[0]) < CORRELATION_BLOCKS_MIN:
            continue
        own = np.diag(_peak_lag_correlations(*here))
        for j in np.nonzero((own < REVERSED_CORRELATION_MAX) & (here[1].std(axis=0) > least))[0].tolist():
            wrong.setdefault(j, []).append(segment.name)
    findings = []
    for j, names in wrong.items():
        mine, theirs = f"q_{j + 1}_rad", other.replace("{j}", str(j + 1))
        text = f"{mine} runs against {theirs} in {len(names)} of {len(segments)} segments ({', '.join(names[:3])})"
        text += ": one of them has the wrong sign there; fix it, or leave these segments out"
        findings.append(Finding("reversed_column", "fatal", "plc.csv", text, len(names)))
    return findings


def _select_log_rows(plc: PlcTable, which: NDArray[np.bool_]) -> PlcTable:
    """The same log of some rows only, of what is compared here."""
    picked = {name: None if (values := getattr(plc, name)) is None else values[which] for name in ("ref", "enc", "u")}
    return replace(plc, t_s=plc.t_s[which], **picked)


def _swapped_column_findings(subject: str, pattern: str, other: str, table: Array) -> list[Finding]:
    """From correlations (encoder column, other column)."""
    findings, reported = [], set()
    for j in range(len(table)):
        k = int(np.argmax(table[j]))
        own = table[j, j]
        if k != j and j not in reported and table[j, k] > OTHER_MIN and own < OWN_MAX and table[k, k] < OWN_MAX:
            reported |= {j, k}
            mine, theirs = pattern.replace("{j}", str(j + 1)), other.replace("{j}", str(k + 1))
            text = (
                f"{mine} follows {theirs} (correlation {table[j, k]:.2f}) and not its own column ({own:.2f}): joints "
                f"{j + 1} and {k + 1} are exchanged in one of the two"
            )
            findings.append(Finding("swapped_columns", "fatal", subject, text))
        elif own < REVERSED_CORRELATION_MAX and table[j].max() < OTHER_MIN:
            mine, theirs = (text.replace("{j}", str(j + 1)) for text in (pattern, other))
            text = f"{mine} runs against {theirs} (correlation {own:.2f}): one of them has the wrong sign"
            findings.append(Finding("reversed_column", "fatal", subject, text))
    return findings


def _block_means(values: Array, size: int) -> Array:
    rows = len(values) // size * size
    return np.asarray(values[:rows].reshape(-1, size, values.shape[1]).mean(axis=1))


def _rows_per_block(plc: PlcTable) -> int:
    steps = np.diff(plc.t_s)
    rising = steps[steps > 0.0]
    return max(1, round(BLOCK_DURATION_S / float(np.median(rising)))) if len(rising) else 1


def _speed_and_command(plc: PlcTable) -> Both | None:
    if plc.u is None or plc.enc is None:
        return None
    size = _rows_per_block(plc)
    speed = np.diff(_block_means(fill_gaps(plc.enc), size), axis=0)
    u = _block_means(fill_gaps(plc.u), size)
    return speed, 0.5 * (u[1:] + u[:-1]), 2


def _encoder_and_reference(plc: PlcTable) -> Both | None:
    if plc.ref is None or plc.enc is None:
        return None
    size = _rows_per_block(plc)
    moved = [np.diff(_block_means(fill_gaps(values), size), axis=0) for values in (plc.enc, plc.ref)]
    return moved[0], moved[1], round(LAG_MAX_S / BLOCK_DURATION_S)


def _peak_lag_correlations(effects: Array, causes: Array, lag_max: int) -> Array:
    """Correlation of largest size over lags 0..lag_max of cause before effect, (columns of effects, of causes).

    Of two of opposite signs and nearly one size the positive one: an oscillation is like its opposite half a period
    later.
    """
    high, low = (np.zeros((effects.shape[1], causes.shape[1])) for _ in range(2))
    for lag in range(min(lag_max, len(effects) - CORRELATION_BLOCKS_MIN) + 1):
        y, x = effects[lag:], causes[: len(causes) - lag]
        y, x = y - y.mean(axis=0), x - x.mean(axis=0)
        norms = np.linalg.norm(y, axis=0)[:, None] * np.linalg.norm(x, axis=0)[None, :]
        now = np.where(norms > 1e-9, (y.T @ x) / np.where(norms > 0.0, norms, 1.0), 0.0)
        high, low = np.maximum(high, now), np.minimum(low, now)
    return np.where(-low > high + SIGN_AMBIGUITY_MARGIN, low, high)
