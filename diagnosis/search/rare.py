"""What happens once: a gap that lies in one block can only be foretold from the rest of that very event.

Why: a drive that saturates in one movement of eight leaves nothing to learn from where that movement is left out, and
one block's gain never is 1.5 standard errors over blocks. Only for link and controller, which repeat to a rounding: in
the oil one odd event may be anything.
"""

from dataclasses import replace

import numpy as np

from diagnosis.search.cell import Cell
from diagnosis.search.fit import costs
from machine.rotations import Array

STAGES = ("link", "controller")
SHARE = 0.6  # of the cell's whole gap, in one block
GAP_NATS = 50.0
PIECE_ROWS = 2
FOLDS = 3


def with_the_event_cut(cell: Cell, residual: Array) -> Cell:
    """The cell with that one block cut into pieces of two rows, left out in three turns; else the cell as it is."""
    if cell.stage not in STAGES:
        return cell
    block = cell.rows.block
    gap = np.bincount(block, weights=costs(residual) - 0.5 * cell.quiet)
    strongest = int(np.argmax(gap))
    if gap[strongest] < max(GAP_NATS, SHARE * float(gap[gap > 0.0].sum())):
        return cell
    event = np.nonzero(block == strongest)[0]
    piece = np.arange(len(event)) // PIECE_ROWS
    cut, fold = block.copy(), cell.rows.fold.copy()
    cut[event] = np.where(piece == 0, strongest, int(block.max()) + piece)
    fold[event] = int(fold.max()) + 1 + piece % FOLDS
    return replace(cell, rows=replace(cell.rows, block=cut, fold=fold, whole=block))
