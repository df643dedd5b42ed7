"""What one cell answers: its search, what was chosen of it, what that leaves, how sure its numbers are."""

from dataclasses import dataclass

from diagnosis.refusal.remainder import Fired
from diagnosis.refusal.shapes import Shape
from diagnosis.search.limits import Limit
from diagnosis.search.score import Score
from diagnosis.search.search import Search
from diagnosis.verdict.shrink import Shrink, Squares
from diagnosis.verdict.weigh import Key, Weighed


@dataclass(frozen=True, slots=True)
class CellAnswer:
    """One cell's answer. `fired`: tests of the remainder; `same`: effects this recording cannot tell apart.

    `squares`, `shrinks`: by part of a joined cell; `shapes`: what the remainder goes with.
    """

    search: Search
    chosen: Score
    weighed: tuple[Weighed, ...]
    fired: tuple[Fired, ...]
    squares: tuple[Squares, ...]
    shrinks: tuple[Shrink, ...]
    limits: tuple[Limit, ...]
    same: tuple[tuple[Key, ...], ...]
    shapes: tuple[Shape, ...]


def joints_asked(answers: tuple[CellAnswer, ...], name: str) -> set[int]:
    """Joints (1-based) that an effect was looked for on: one cause of all of them shows on each."""
    candidates = (one for answer in answers for one in answer.search.cell.candidates)
    return {one.joint for one in candidates if one.name == name and one.joint is not None}
