"""Checks of the tables before anything is computed from them. Each gives findings, none changes a number."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from diagnosis.log.findings import Finding
from diagnosis.log.frozen import frozen_findings
from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import JOINT_SIGNAL_COLUMNS, PlcTable, Tables, fill_gaps, largest_finite
from machine.rotations import Array
from recording.run import Segment

GAP_MIN_MEDIAN_STEPS = 1.5  # a step in time above this many median steps: rows are missing
CLOCK_JUMP_MOTION_MAX_ROWS = 3.0  # rows' motion, at most, from before a jump of the clock to after it
# Median steps that the three steps about it are too long together: else it is a late stamp
GAP_EXCESS_MIN_MEDIAN_STEPS = 0.6
LOG_ROWS_MIN = 50
SEGMENT_EDGE_TOLERANCE_S = 1e-6  # rounding of a segment's ends
DURATION_MIN_S = 2.0
ROW_STEP_MAX_CYCLES = 500.0  # cycles between two rows: beyond it the unit of time is wrong (units.py)
MOVING_REFERENCE_RANGE_MIN = 0.1  # rad or m: a reference that goes this far moves any joint
MOVING_COMMAND_MIN = 0.2  # a command above it moves any joint


def plc_findings(tables: Tables, nominal: Nominal | None) -> list[Finding]:
    """All checks of the PLC's log."""
    plc = tables.plc
    if plc is None:
        return []
    findings = time_findings("plc.csv", plc.t_s, plc.enc, tables.run_info.segments)
    findings += _short_log_findings("plc.csv", plc.t_s) + _duplicate_row_findings(plc.t_s)
    for short, _, pattern in JOINT_SIGNAL_COLUMNS:
        values = getattr(plc, short)
        if values is not None:
            findings += _non_finite_findings("plc.csv", pattern, values)
    findings += _constant_encoder_findings(plc) + frozen_findings(plc.enc)
    findings += _sample_rate_findings(plc, nominal)
    return findings


def time_findings(
    subject: str, t_s: Array, signals: Array | None = None, segments: Sequence[Segment] = ()
) -> list[Finding]:
    """Gaps, jumps of the clock, time that runs backwards.

    Model: a forward step above 1.5 median steps, which its neighbours do not make up for, is a jump of the clock
           where the signals moved on by a few rows' motion only, though they were moving (below 0.3 of speed times
           step); else rows are missing. Where there are segments, nothing is asked of the time between them.
    """
    if not np.isfinite(t_s).all():
        bad = int((~np.isfinite(t_s)).sum())
        return [Finding("not_a_number", "fatal", subject, f"{bad} rows have no time; remove them", bad)]
    steps = np.diff(t_s)
    rising = steps[steps > 0.0]
    back = np.nonzero(steps < 0.0)[0]
    if len(rising) == 0:
        text = f"time runs backwards from {t_s[0]:.10g} to {t_s[-1]:.10g} s in every row: sort the rows"
        return [Finding("time_backwards", "fatal", subject, text, len(back))] if len(back) else []
    median = float(np.median(rising))
    findings: list[Finding] = []
    if len(back):
        k = int(back[0])
        text = (
            f"time runs backwards {len(back)} times, first by {-steps[k]:.4g} s at {t_s[k]:.10g} s; "
            "the log is cut there: sort the rows, or fix the clock"
        )
        findings.append(Finding("time_backwards", "problem", subject, text, len(back)))
    jumps, gaps = [], []
    for k in np.nonzero(too_long(steps, median, GAP_MIN_MEDIAN_STEPS) & _is_step_in_segment(t_s, segments))[0]:
        (jumps if _is_jump(signals, int(k), float(steps[k]), median) else gaps).append(int(k))
    if jumps:
        k = jumps[0]
        text = (
            f"the clock jumps {len(jumps)} times, first by {steps[k] - median:.4g} s at {t_s[k]:.3f} s, while the "
            "joints go on without a jump; the log is cut there"
        )
        findings.append(Finding("clock_jump", "problem", subject, text, len(jumps)))
    if gaps:
        lost = sum(round(float(steps[k]) / median) - 1 for k in gaps)
        text = (
            f"{lost} rows are missing in {len(gaps)} gaps, the longest {float(steps[gaps].max()):.3g} s, the first at "
            f"{t_s[gaps[0]]:.3f} s; the log is cut there"
        )
        findings.append(Finding("gap", "problem", subject, text, len(gaps)))
    return findings


def too_long(steps: Array, median: float, most: float) -> NDArray[np.bool_]:
    """Steps (m,) of more than so many median ones that their neighbours do not make up for.

    Why: a row that was stamped late comes after a long step and before a short one, and none is missing.
    """
    padded = np.concatenate([[median], steps, [median]])
    three = padded[:-2] + padded[1:-1] + padded[2:]
    return (steps > most * median) & (three > (3.0 + GAP_EXCESS_MIN_MEDIAN_STEPS) * median)


def _is_step_in_segment(t_s: Array, segments: Sequence[Segment]) -> NDArray[np.bool_]:
    """Whether each step (m - 1,) lies within one segment; all without segments."""
    if not segments:
        return np.ones(len(t_s) - 1, dtype=bool)
    inside = np.zeros(len(t_s) - 1, dtype=bool)
    for segment in segments:
        inside |= (t_s[:-1] >= segment.t_start_plc_s - SEGMENT_EDGE_TOLERANCE_S) & (
            t_s[1:] <= segment.t_end_plc_s + SEGMENT_EDGE_TOLERANCE_S
        )
    return inside


def _is_jump(signals: Array | None, k: int, step: float, median: float) -> bool:
    if signals is None:
        return False
    near = fill_gaps(signals[max(k - 5, 0) : k + 2])
    around = np.diff(near[:-1], axis=0)
    if len(around) == 0:
        return False
    speed = np.linalg.norm(around.mean(axis=0)) / median
    moved = np.linalg.norm(near[-1] - near[-2])
    noise = np.linalg.norm(around.std(axis=0))
    expected = speed * step
    onwards = (
        CLOCK_JUMP_MOTION_MAX_ROWS * speed * median + 10.0 * noise
    )  # far from there, it moved on while nothing was logged
    return bool(expected > max(10.0 * noise, 1e-4) and moved < min(0.3 * expected, onwards))


def _short_log_findings(subject: str, t_s: Array) -> list[Finding]:
    span = float(np.ptp(t_s)) if len(t_s) else 0.0
    if len(t_s) >= LOG_ROWS_MIN and span >= DURATION_MIN_S:
        return []
    text = (
        f"{len(t_s)} rows over {span:.3g} s; the least is {LOG_ROWS_MIN} rows and {DURATION_MIN_S:g} s, a minute per "
        "segment is what a diagnosis needs"
    )
    return [Finding("too_short", "fatal", subject, text)]


def _duplicate_row_findings(t_s: Array) -> list[Finding]:
    again = int((np.diff(t_s) == 0.0).sum())
    if not again:
        return []
    text = f"{again} rows have the time of the row before them; the log is cut there: write each row once"
    return [Finding("duplicate_rows", "problem", "plc.csv", text, again)]


def _non_finite_findings(subject: str, pattern: str, values: Array) -> list[Finding]:
    findings = []
    for j in range(values.shape[1]):
        bad = int((~np.isfinite(values[:, j])).sum())
        if bad:
            share, name = bad / len(values), pattern.replace("{j}", str(j + 1))
            code = "missing_column" if bad == len(values) else "not_a_number"
            text = f"{name}: {bad} of {len(values)} numbers ({100.0 * share:.3g} %) are missing or not finite"
            findings.append(Finding(code, "problem", subject, text, bad))
    return findings


def _constant_encoder_findings(plc: PlcTable) -> list[Finding]:
    """A joint whose encoder stands still to the last digit while its valve works, or its reference goes far."""
    if plc.enc is None:
        return []
    findings = []
    for j in range(plc.enc.shape[1]):
        finite = plc.enc[np.isfinite(plc.enc[:, j]), j]
        why = _motion_request_text(plc, j)
        if len(finite) and np.ptp(finite) == 0.0 and why:
            text = f"q_{j + 1}_rad never changes, though {why}; check the encoder"
            findings.append(Finding("constant", "problem", "plc.csv", text))
    return findings


def _motion_request_text(plc: PlcTable, j: int) -> str:
    """What asked a joint (0-based) to move, in words; empty where nothing did."""
    if plc.u is not None and largest_finite(plc.u[:, j]) > MOVING_COMMAND_MIN:
        return f"u_{j + 1}_frac reaches {largest_finite(plc.u[:, j]):.2g}"
    ref = np.zeros(0) if plc.ref is None else plc.ref[np.isfinite(plc.ref[:, j]), j]
    asked = float(np.ptp(ref)) if len(ref) else 0.0
    return f"q_ref_{j + 1}_rad goes over {asked:.2g}" if asked > MOVING_REFERENCE_RANGE_MIN else ""


def _sample_rate_findings(plc: PlcTable, nominal: Nominal | None) -> list[Finding]:
    steps = np.diff(plc.t_s)
    rising = steps[steps > 0.0]
    if nominal is None or nominal.actuators is None or len(rising) == 0:
        return []
    median, stated = float(np.median(rising)), nominal.actuators.log_cycle_s
    if abs(median / stated - 1.0) < 0.02 or median > ROW_STEP_MAX_CYCLES * stated:
        return []
    text = f"rows come every {1e3 * median:.4g} ms, machine.toml says {1e3 * stated:.4g} ms; correct plc.log_cycle_s"
    return [Finding("uneven_rate", "problem", "plc.csv", text)]
