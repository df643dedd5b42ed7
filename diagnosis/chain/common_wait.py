"""When datagrams came between rows, by all joints at once: one wait, and one drift of the clocks, for the recording.

All joints got the same datagrams. Two clocks that run apart by eighty millionths are five milliseconds apart after a
minute, and rows that come as seldom as datagrams show none of it: each joint had half a percent of flow too much.
"""

from dataclasses import replace

import numpy as np

from diagnosis.cells.dynamic import stage_cells
from diagnosis.chain.own_cycle import left_in
from diagnosis.datagrams.arrivals import RATE_MAX
from diagnosis.replay.replayer import Replayer, within_rows
from diagnosis.replay.stage_replay import Replay
from diagnosis.replay.stretches import Stretch
from diagnosis.search.cell import Cell
from machine.effects import kernel
from machine.effects.layout import ParameterSets
from machine.rotations import Array

ROUNDS = 10
STEP_MAX = 3.0  # cycles at a time: the course a cycle later tells little beyond
SETTLED = 0.05  # cycles
JOINTS_MIN = 3  # of fewer the middle one may be the one with a fault
LINE_MIN = 3  # stretches


def on_their_line(
    stretches: tuple[Stretch, ...], replayer: Replayer, base: ParameterSets, course: ParameterSets
) -> tuple[Stretch, ...]:
    """The stretches with what was sent where the actuators of most joints are left with least by it.

    Model: in each stretch the weighted median over joints of how many cycles later the commands' course had come; over
           the stretches a line; moved by it as far as the log's rows allow, until it stands.
    Why the median: a joint with a fault of its own says nothing of the link. No name comes of it: joints may say when
           a command came, but not why.
    """
    if not any(one.sent is not None and one.sent.unsure_s > 0.0 for one in stretches):
        return stretches
    delay_s = replayer.plant.transport_delay_s + float(course.machine[0, kernel.DELAY])
    best, least, now = stretches, np.inf, stretches
    for _ in range(ROUNDS):
        cells = stage_cells("actuator", replayer, now, base, course)
        if len(cells) < JOINTS_MIN:
            return stretches
        left = left_in(cells)
        if left >= least:
            break
        best, least = now, left
        waits = _waits(cells, now)
        if float(np.abs(waits).max()) < SETTLED:
            break
        by_s = replayer.plant.cycle_s * np.clip(waits, -STEP_MAX, STEP_MAX)
        now = _moved(now, by_s, delay_s)
    return best


def _waits(cells: list[Cell], stretches: tuple[Stretch, ...]) -> Array:
    """By how many cycles (stretches,) commands came later than they are taken to have, 0 where nothing tells."""
    told: dict[int, list[tuple[float, float]]] = {id(one): [] for one in stretches}
    for cell in cells:
        if not isinstance(cell.whitened, Replay):
            continue
        for part, wait in zip(cell.whitened.parts, cell.whitened.waits(cell.base), strict=True):
            told[id(part.stretch)].append(wait)
    return np.array([_median(told[id(one)]) for one in stretches])


def _median(told: list[tuple[float, float]]) -> float:
    """The weighted median of (amount, weight)."""
    some = sorted(one for one in told if one[1] > 0.0)
    if not some:
        return 0.0
    below = np.cumsum([weight for _, weight in some])
    return some[int(np.searchsorted(below, 0.5 * below[-1]))][0]


def _moved(stretches: tuple[Stretch, ...], by_s: Array, delay_s: float) -> tuple[Stretch, ...]:
    """What was sent in each stretch moved by a line through (stretches,) [s]; by their median where they are few."""
    middle = np.array([0.5 * (one.t_s[0] + one.t_s[-1]) for one in stretches])
    rate, start = 0.0, float(np.median(by_s))
    if len(stretches) >= LINE_MIN and np.ptp(middle) > 0.0:
        rate = float(np.clip(np.polyfit(middle - middle.mean(), by_s, 1)[0], -RATE_MAX, RATE_MAX))
        start = float(np.median(by_s - rate * (middle - middle.mean())))
    out = []
    for one in stretches:
        if one.sent is not None:
            line = start + rate * (one.sent.t_s - middle.mean())
            one = replace(one, sent=replace(one.sent, t_s=within_rows(one.sent, line, delay_s)))
        out.append(one)
    return tuple(out)
