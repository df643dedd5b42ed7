"""The PC's and the camera's clocks against the PLC's, also where nobody gave their offset.

Numbers of datagrams tell it but for the link's delay, and how pictures move with the joints tells the rest; a camera
that stamps late cannot be told from it then.
"""

import numpy as np

from diagnosis.cells import Cell
from diagnosis.fit import costs, evaluated
from diagnosis.sent import sent_clock
from diagnosis.tables import Tables

CLOCK = "clock_offset"
UNTOLD = (CLOCK, "camera_latency")
SPAN_S, STEP_S = 0.3, 0.005
FINER, ROUNDS = 10, 2


def guessed(tables: Tables) -> bool:
    """Whether the offset between PLC and PC is not given, and numbers of datagrams tell it but for a constant."""
    return tables.run.plc_to_pc_offset_s is None and sent_clock(tables, []) is not None


def plc_to_pc_s(tables: Tables) -> float:
    """t_pc = t_plc + this, as well as is known; what nothing tells counts as 0."""
    given = tables.run.plc_to_pc_offset_s
    if given is not None:
        return given
    clock = sent_clock(tables, [])
    return clock.offset_s if clock is not None and np.isfinite(clock.offset_s) else 0.0


def camera_to_plc_s(tables: Tables) -> float:
    """t_plc = t_camera + this, as well as is known; what nothing tells counts as 0."""
    return (tables.run.camera_to_pc_offset_s or 0.0) - plc_to_pc_s(tables)


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
