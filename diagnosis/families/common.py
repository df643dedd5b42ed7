"""What repeats of one command have in common of a foretold residual, and what only goes with each one's own noise."""

import numpy as np
from numpy.typing import NDArray

from diagnosis.replay.stage_replay import Replay
from diagnosis.replay.stretches import repeat_groups
from diagnosis.search.cell import Cell
from diagnosis.search.fit import costs
from machine.rotations import Array

Numbers = NDArray[np.int64]
COMMON_LEAST = 0.5  # of what is foretold of the repeats: what a fault does to a command is the same in each
TOLD_NATS = 2.0  # of the repeats: with less, they do not say what they have in common


def repeated_rows(cell: Cell) -> list[Numbers]:
    """Row numbers (K, rows) of each group of repeats of one joint's actuator, one under the other.

    None of other cells, which no loop feeds its own noise, nor beside a baseline, which knows what names gain there.
    """
    replay = cell.whitened
    if cell.stage != "actuator" or cell.joint is None or cell.usual or not isinstance(replay, Replay):
        return []
    names = [part.stretch.name for part in replay.parts]
    out = []
    for members in repeat_groups(tuple(part.stretch for part in replay.parts)).values():
        rows = [np.nonzero(cell.rows.series == names.index(one.name))[0] for one in members]
        shortest = min(len(one) for one in rows)
        if shortest:
            out.append(np.stack([one[:shortest] for one in rows]))
    return out


def common_share(before: Array, change: Array, repeats: list[Numbers]) -> float:
    """The share of what a change (N,) gains of a residual (N,) that repeats have in common; 1 where they do not say."""
    share = share_in_common(before, change, repeats)
    return 1.0 if share is None else share


def share_in_common(
    before: Array, change: Array, repeats: list[Numbers], least_nats: float = TOLD_NATS
) -> float | None:
    """The same; None where they do not say, or say it of less than least_nats.

    Model: the change d_k of repeat k is replaced by the mean of all K. Of what they have in common nothing is lost; of
           what goes with each one's own noise a K-th is left, and is taken off.
    Why:   through a fast loop the measured command follows the disturbance that the residual is made of, and all that
           goes with such a command foretells it.
    """
    gained, expected = 0.0, 0.0
    for rows in repeats:
        mean = np.broadcast_to(change[rows].mean(axis=0), rows.shape)
        own, common = (_gain(before[rows], one) for one in (change[rows], mean))
        gained += own
        expected += (common - own / len(rows)) / (1.0 - 1.0 / len(rows))
    return expected / gained if gained > least_nats else None


def share_of(before: Array, change: Array, instead: Array) -> float | None:
    """Of what a change (N,) gains of a residual (N,), the share that another one (N,) in its place gains; None where
    that is next to nothing.
    """
    gained = _gain(before, change)
    return _gain(before, instead) / gained if gained > TOLD_NATS else None


def _gain(before: Array, change: Array) -> float:
    return float((costs(before) - costs(before - change)).sum())
