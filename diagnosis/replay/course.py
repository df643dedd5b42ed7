"""The command's course between two logged rows, where no model of a controller gives it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from machine.effects.dynamics import Actuators, at_cycles
from machine.rotations import Array

COMMAND_JUMP_RATIO_MIN = 4.0  # times what the command changes in the neighbouring rows


def smooth_course(plant: Actuators, rows: Array) -> Array:
    """Logged rows (rows, n) at every PLC cycle: a cubic through the four nearest rows, a line next to a jump.

    Why no lines: at 100 Hz they cut a thousandth off a sine of 1.6 Hz, which quiet encoders show as a small gain.
    """
    linear = at_cycles(plant, rows)
    if plant.cycles_per_row == 1 or len(rows) < 4:
        return linear
    bend = np.zeros_like(rows)
    bend[1:-1] = np.diff(rows, n=2, axis=0)
    jumps = jump_rows(rows)
    bend[jumps | np.roll(jumps, 1, axis=0)] = 0.0  # at both ends of a jump
    cycles = np.arange(len(linear))
    row, s = cycles // plant.cycles_per_row, (cycles % plant.cycles_per_row / plant.cycles_per_row)[:, None]
    after = np.minimum(row + 1, len(rows) - 1)
    return np.ascontiguousarray(linear - s * (1.0 - s) / 6.0 * ((2.0 - s) * bend[row] + (1.0 + s) * bend[after]))


def late_jump_course(plant: Actuators, rows: Array) -> Array:
    """The same with every jump at the end of its row, where a line has it in the middle."""
    course = smooth_course(plant, rows)
    found = late_jumps(plant, rows, course)
    return course if found is None else found


def late_jumps(plant: Actuators, rows: Array, course: Array) -> Array | None:
    """A course (cycles, n) of logged rows with every jump at the end of its row; None where nothing jumps."""
    jumps = jump_rows(rows)
    return np.where(held_rows(plant, jumps), held_rows(plant, rows), course) if jumps.any() else None


def held_rows(plant: Actuators, rows: NDArray[Any]) -> NDArray[Any]:
    """Logged rows (rows, n) at every PLC cycle, each until the next one."""
    return np.repeat(rows, plant.cycles_per_row, axis=0)[: (len(rows) - 1) * plant.cycles_per_row + 1]


def jump_rows(rows: Array) -> NDArray[np.bool_]:
    """Rows (rows, n) after which the command changes by much more than in the neighbouring rows."""
    change = np.abs(np.diff(rows, axis=0, append=rows[-1:]))
    neighbours = np.maximum(np.roll(change, 1, axis=0), np.roll(change, -1, axis=0))
    return np.asarray(change > COMMAND_JUMP_RATIO_MIN * neighbours)
