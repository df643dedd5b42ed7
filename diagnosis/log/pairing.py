"""Whether each joint's columns belong together: reference, encoder and valve command of one joint move alike."""

import numpy as np

from diagnosis.log.findings import Finding
from diagnosis.log.tables import PlcTable, Tables, filled
from machine.rotations import Array

BLOCK_S = 0.1
LAG_MAX_S = 3.0  # a slow position loop trails its reference by a second or two
OWN_MAX, OTHER_MIN = 0.6, 0.9  # correlation with the own column below, with the other one above: exchanged
REVERSED_MAX = -0.9
BLOCKS_MIN = 20  # a correlation over fewer means nothing


def pairing_findings(tables: Tables) -> list[Finding]:
    """Exchanged and reversed columns between reference and encoder, and between command and encoder's speed."""
    plc = tables.plc
    if plc is None or plc.enc is None:
        return []
    findings: list[Finding] = []
    for name, table in (("u_{j}_frac", _speed_by_command(plc)), ("q_ref_{j}_rad", _encoder_by_reference(plc))):
        if table is not None:
            findings += _judge("plc.csv", "q_{j}_rad", name, table)
    return findings


def _judge(subject: str, pattern: str, other: str, table: Array) -> list[Finding]:
    """From correlations (encoder column, other column)."""
    findings, told = [], set()
    for j in range(len(table)):
        k = int(np.argmax(table[j]))
        own = table[j, j]
        if k != j and j not in told and table[j, k] > OTHER_MIN and own < OWN_MAX and table[k, k] < OWN_MAX:
            told |= {j, k}
            mine, theirs = pattern.replace("{j}", str(j + 1)), other.replace("{j}", str(k + 1))
            text = (
                f"{mine} follows {theirs} (correlation {table[j, k]:.2f}) and not its own column ({own:.2f}): joints "
                f"{j + 1} and {k + 1} are exchanged in one of the two"
            )
            findings.append(Finding("swapped_columns", "fatal", subject, text))
        elif own < REVERSED_MAX and table[j].max() < OTHER_MIN:
            mine, theirs = (text.replace("{j}", str(j + 1)) for text in (pattern, other))
            text = f"{mine} runs against {theirs} (correlation {own:.2f}): one of them has the wrong sign"
            findings.append(Finding("reversed_column", "fatal", subject, text))
    return findings


def _blocks(values: Array, size: int) -> Array:
    rows = len(values) // size * size
    return np.asarray(values[:rows].reshape(-1, size, values.shape[1]).mean(axis=1))


def _size(plc: PlcTable) -> int:
    steps = np.diff(plc.t_s)
    rising = steps[steps > 0.0]
    return max(1, round(BLOCK_S / float(np.median(rising)))) if len(rising) else 1


def _speed_by_command(plc: PlcTable) -> Array | None:
    if plc.u is None or plc.enc is None:
        return None
    size = _size(plc)
    speed = np.diff(_blocks(filled(plc.enc), size), axis=0)
    u = _blocks(filled(plc.u), size)
    return _correlations(speed, 0.5 * (u[1:] + u[:-1]), 2)


def _encoder_by_reference(plc: PlcTable) -> Array | None:
    if plc.ref is None or plc.enc is None:
        return None
    size = _size(plc)
    moved = [np.diff(_blocks(filled(values), size), axis=0) for values in (plc.enc, plc.ref)]
    return _correlations(moved[0], moved[1], round(LAG_MAX_S / BLOCK_S))


def _correlations(effects: Array, causes: Array, lag_max: int) -> Array:
    """Correlation of largest size over lags 0..lag_max of cause before effect, (columns of effects, of causes)."""
    best = np.zeros((effects.shape[1], causes.shape[1]))
    for lag in range(min(lag_max, len(effects) - BLOCKS_MIN) + 1):
        y, x = effects[lag:], causes[: len(causes) - lag]
        y, x = y - y.mean(axis=0), x - x.mean(axis=0)
        norms = np.linalg.norm(y, axis=0)[:, None] * np.linalg.norm(x, axis=0)[None, :]
        now = np.where(norms > 1e-9, (y.T @ x) / np.where(norms > 0.0, norms, 1.0), 0.0)
        best = np.where(np.abs(now) > np.abs(best), now, best)
    return best
