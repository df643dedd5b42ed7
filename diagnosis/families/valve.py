"""Families of a few numbers of an actuator: by what a valve may err, whatever its fault is called.

Why beside the wide ones: a hysteresis of four times its limit that has no name leaves 30 nats of the six numbers of a
changing command, of which undisturbed days leave 40, and 80 of these two, of which they leave 12.
"""

import numpy as np

from diagnosis.families.driven import Course, families_white
from diagnosis.families.ways import last_way
from diagnosis.replay.stage_replay import Replay
from diagnosis.search.cell import Cell
from machine.rotations import Array

WAY_OF_COMMAND = "which way the valve command last went"
SMALL = "small valve commands"
SIZE = "the size of the valve command"
LOADED = "the load that is moved"
VALVE = (WAY_OF_COMMAND, SMALL, SIZE, LOADED)
WIDTHS = (0.003, 0.012)  # of full command: the play of good and of worn spools
SMALLEST = (0.03, 0.1)  # of full command: what is beyond it counts as it


def valve_columns(cell: Cell) -> dict[str, Array]:
    """(N, k) by what they are functions of, white as the cell's residual. Empty for other cells."""
    if cell.stage != "actuator" or not isinstance(cell.whitened, Replay):
        return {}
    return families_white(cell, cell.whitened, lambda courses: [valve_families(one) for one in courses])


def valve_families(c: Course) -> dict[str, Array]:
    """Of one joint through a stretch (m, k), in the unit of its angle."""
    u, v = c.drive, c.smooth(c.rate(c.q))
    speeds = {
        WAY_OF_COMMAND: [last_way(u, width) for width in WIDTHS],
        SMALL: [np.clip(u, -most, most) for most in SMALLEST],
        SIZE: [u, np.abs(u)],
        LOADED: [v * c.load, np.abs(v) * c.load],
    }
    return {name: c.whole(np.stack(columns, axis=1)) for name, columns in speeds.items()}
