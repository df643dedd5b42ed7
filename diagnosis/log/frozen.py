"""Encoders that stand still in the log while the machine moves on: samples were dropped, and old ones written again."""

import numpy as np
from numpy.typing import NDArray

from diagnosis.log.findings import Finding
from diagnosis.log.tables import fill_gaps
from diagnosis.noise.floor import encoder_step
from machine.rotations import Array

SPEED_WINDOW_ROWS = 5  # rows from which the speed is taken
CATCH_UP_STEP_RATIO_MIN = 1.6  # times the usual step: the first row after a stop makes up for it
# Of all moving rows: a log that is faster than the PLC repeats most of them, and is not faulty
REPEATED_ROWS_MAX_FRAC = 0.4
REPORTED_RUNS_MIN = 10
# Of the encoders' own resolution a row: a slow joint repeats its reading without any fault
ENCODER_STEPS_PER_ROW_MIN = 5.0


def frozen_findings(enc: Array | None) -> list[Finding]:
    """Runs of rows in which every encoder repeats its last value to the last digit, with a jump after each."""
    if enc is None:
        return []
    runs = frozen_runs(fill_gaps(enc))
    if len(runs) < REPORTED_RUNS_MIN:
        return []
    rows = sum(end - start for start, end in runs)
    text = f"all encoders stand still for {rows} rows in {len(runs)} runs while the joints move on, and jump after each"
    return [Finding("frozen", "problem", "plc.csv", f"{text}: samples were dropped; look at the logger", len(runs))]


def frozen_runs(enc: Array) -> list[tuple[int, int]]:
    """First row and the one after the last of each run of encoders (m, n) that a moving machine left behind."""
    steps = np.diff(enc, axis=0)
    same: NDArray[np.bool_] = (steps == 0.0).all(axis=1)
    moving = ~same
    if not moving.any() or same.sum() > REPEATED_ROWS_MAX_FRAC * len(same):
        return []
    least = ENCODER_STEPS_PER_ROW_MIN * float(np.linalg.norm([encoder_step(column) for column in enc.T]))
    edges = np.diff(np.concatenate([[0], same.astype(int), [0]]))
    found = []
    for start, end in zip(np.nonzero(edges > 0)[0], np.nonzero(edges < 0)[0], strict=True):
        if start < SPEED_WINDOW_ROWS or end >= len(steps) or not moving[start - SPEED_WINDOW_ROWS : start].all():
            continue
        speed = float(np.linalg.norm(steps[start - SPEED_WINDOW_ROWS : start].mean(axis=0)))
        noise = float(np.linalg.norm(steps[start - SPEED_WINDOW_ROWS : start].std(axis=0)))
        if speed > max(noise, least) and float(np.linalg.norm(steps[end])) > CATCH_UP_STEP_RATIO_MIN * speed:
            found.append((int(start) + 1, int(end) + 1))
    return found
