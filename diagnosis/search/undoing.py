"""Names of one cell that undo most of each other: one cause that the catalogue lacks is likelier than both of them."""

from dataclasses import dataclass
from itertools import combinations

from diagnosis.search.candidates import in_words
from diagnosis.search.cell import Cell
from diagnosis.search.fit import Fit, evaluated
from machine.rotations import Array

UNDONE_MIN = 0.35  # of eight wrong pairs on judged machines six undo 0.41 to 0.98, of 16 right ones none above 0.1
CAMERA = "camera"


@dataclass(frozen=True, slots=True)
class Undoing:
    """Two names as they are read, and the share of what they change alone that is gone where both change it."""

    names: tuple[str, str]
    share: float


def undoing(cell: Cell, found: Fit, nothing: Array) -> Undoing | None:
    """The two of a fit's names that undo most of each other, if it is much.

    Model: share = 1 - |f_1 + f_2|^2 / (|f_1|^2 + |f_2|^2) of what each name alone changes of the whitened residual. Two
           causes that know nothing of each other add up as often as not, and few point along one line at all; two names
           that stand in for a third have to, and most of either is there to take back the other's. But two numbers of
           one camera: they come from one calibration, whose errors undo each other in what it was made from.
    Args:  nothing: (N,) the residual without any of them.
    """
    alone = [(one, evaluated(cell, (one,), theta[None])[0] - nothing) for one, theta in found.by_effect]
    pairs = []
    for (one, f_1), (other, f_2) in combinations(alone, 2):
        both = float(f_1 @ f_1 + f_2 @ f_2)
        if both > 0.0 and not one.stage == other.stage == CAMERA:
            pairs.append(Undoing((in_words(*one.key), in_words(*other.key)), -2.0 * float(f_1 @ f_2) / both))
    most = max(pairs, key=lambda pair: pair.share, default=None)
    return most if most is not None and most.share > UNDONE_MIN else None
