"""By how much a camera's stamps are late where nobody gave its clock's offset: pictures move with the joints.

A camera that stamps late cannot be told from a clock that is off then.
"""

import numpy as np

from diagnosis.search.cell import Cell
from diagnosis.search.fit import costs, evaluated

CLOCK = "clock_offset"
UNTOLD = (CLOCK, "camera_latency")
SPAN_S, STEP_S = 0.3, 0.005
FINER, ROUNDS = 10, 2


def late_by_motion_s(cell: Cell) -> float:
    """By how much the camera's stamps are late by what is seen while the arm moves; 0 where nothing tells."""
    clock = next((one for one in cell.candidates if one.name == CLOCK), None)
    if clock is None:
        return 0.0
    best, step = 0.0, STEP_S
    tried = np.arange(-SPAN_S, SPAN_S + 0.5 * STEP_S, STEP_S)
    for _ in range(1 + ROUNDS):
        total = costs(evaluated(cell, (clock,), tried[:, None])).sum(axis=1)
        best = float(tried[int(np.argmin(total))])
        tried, step = best + step * np.linspace(-1.0, 1.0, 2 * FINER + 1), step / FINER
    return best
