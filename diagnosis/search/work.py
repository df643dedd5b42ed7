"""How much of a diagnosis is done: its parts weighed by what they usually cost, for the caller's progress display."""

from collections.abc import Callable, Sequence

from diagnosis.search.cell import Cell

Progress = Callable[[str, float, float], None]  # what is being done, work done, work in all; a second, more or less

FIT_COST_S_BY_STAGE = {
    "link": 3e-6,
    "controller": 3e-6,
    "actuator": 3e-5,
}  # of a row and a candidate, on one usual core
LINK_SIDE_FIT_COST_S = 2e-5  # the same of points and corners
CONCLUSION_COST_FRAC = 0.35  # of all fits' cost: weighing, held-out data, where it lies, the next experiment


def no_progress(_text: str, _done: float, _all: float) -> None:
    """Report nothing."""


class WorkProgress:
    """Reports to a `Progress` what is done and what is done in all, as far as it is known."""

    def __init__(self, progress: Progress = no_progress) -> None:
        self._progress = progress
        self._text = ""
        self._ended = self._concluded = self._cost = self._done = 0.0
        self._waiting: list[float] = []  # the parts of this stage that have not begun

    def begin_cells(self, cells: Sequence[Cell]) -> None:
        """These cells are next, one after the other."""
        self._waiting = [fit_s(cell) for cell in cells]

    def begin(self, text: str) -> None:
        """The next cell."""
        self._text, self._done = text, 0.0
        self._cost = self._waiting.pop(0) if self._waiting else 0.0
        self._report_progress()

    def repeat_cell(self) -> None:
        """The cell is fitted once more."""
        self._done = self._cost
        self._cost *= 2.0
        self._report_progress()

    def end_cell(self) -> None:
        """The cell is done."""
        self._ended += self._cost
        self._cost = self._done = 0.0

    def report_concluding_progress(self, text: str, share: float) -> None:
        """Every fit is done, and so large a share of what comes after them."""
        self._waiting, self._text = [], text
        self._concluded = share * CONCLUSION_COST_FRAC * self._ended
        self._report_progress()

    def _report_progress(self) -> None:
        fits = self._ended + self._cost + sum(self._waiting)
        self._progress(self._text, self._ended + self._done + self._concluded, (1.0 + CONCLUSION_COST_FRAC) * fits)


def fit_s(cell: Cell) -> float:
    """What fitting a cell usually takes [s]."""
    return FIT_COST_S_BY_STAGE.get(cell.stage, LINK_SIDE_FIT_COST_S) * cell.rows.row_count * len(cell.candidates)
