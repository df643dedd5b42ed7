"""How much of its gap a cell's names close, and how much they have to."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from diagnosis.known.days import RECORDINGS_ENOUGH
from diagnosis.search.cell import DRIVEN_STAGES, Cell
from diagnosis.verdict.shrink import closing, together
from machine.remainder import USUAL_ENERGY

if TYPE_CHECKING:
    from diagnosis.verdict.cell_answer import CellAnswer

LEAST = 0.5  # of a gap; the same beside a baseline of enough days:
LEAST_KNOWN = 0.05  # of 1290 recordings ten right answers closed 8 to 45 %, three wrong ones 44 to 49 %


def closes_little(one: CellAnswer) -> bool:
    """Whether a cell's names close too little of its gap to be told as its cause."""
    return _closed(one) < _least_closed(one.search.cell)


def _closed(one: CellAnswer) -> float:
    """The share of the gap that a cell's names close; 1 where nothing was named. Where none can be told, since nothing
    stands out of the noise: 0 without a baseline if what drives the cell is a guess between logged rows, else 1.

    Its upper limit, for what is left would have refused the names otherwise. The share itself beside a baseline, where
    what is usually left is allowed for, and where the gap is what the catalogue foretells, whose limit is 1: a name
    could close next to nothing there, and nothing else would refuse it.
    """
    if not one.chosen.fit.hypothesis:
        return 1.0
    told, _ = _share_asked(one)
    if told is None:
        return 0.0 if one.search.cell.coarse and not one.search.cell.usual_known else 1.0
    return told


def _share_asked(one: CellAnswer) -> tuple[float | None, bool]:
    """The share closed that counts, and whether it is an upper limit."""
    _, _, _, (share, _, high), by = closing(together(one.squares))
    at_most = by == "noise" and not one.search.cell.usual_known
    return (high if at_most else share), at_most


def closing_little(one: CellAnswer) -> str:
    """Why names that close little of a cell's gap are not told as its cause."""
    label, (share, at_most) = one.search.cell.label, _share_asked(one)
    if share is None:
        text = f"{label}: nothing stands out of what repeats differ by, and names gain there all the same"
        return f"{text}; log every PLC cycle, or repeat more, to tell whether they are a fault"
    text = f"{label}: the best names close {100.0 * share:.3g} % of the gap"
    if _known_by_few(one.search.cell):
        return (
            f"{text}, and the machine's usual state is known of too few days to say whether the rest is usual; "
            f"fit it on {RECORDINGS_ENOUGH} recordings or more"
        )
    return f"{text}{' at the most' if at_most else ''}: more of it is something else"


def _least_closed(cell: Cell) -> float:
    """The share of a cell's gap that its names have to close. Less beside a baseline of enough days: what fault is left
    there is found by what it goes with, and the rest of a small gap is the day's. None behind the joints where booms
    were set swinging as on no undisturbed recording.
    """
    if cell.moved_unlike and cell.stage not in DRIVEN_STAGES:
        return -np.inf
    return LEAST_KNOWN if cell.known_well and not _known_by_few(cell) else LEAST


def _known_by_few(cell: Cell) -> bool:
    """Whether a baseline was judged on too few recordings to say how much is ever left."""
    return any(part.usual and USUAL_ENERGY not in dict(part.usual) for part in cell.parts or (cell,))
