"""How much of a diagnosis is done: its parts weighed by what they usually cost, for whoever holds a clock beside it.

What is not known when a part begins is whether a name will be found in it: looking for a second and a third one costs
several times the scan. So the work in all grows where one is found, and the rest that is told grows with it.
"""

from collections.abc import Callable, Sequence

from diagnosis.search.cell import DRIVEN_STAGES, Cell

Progress = Callable[[str, float, float], None]  # what is being done, work done, work in all; a second, more or less

SCAN_S = {"link": 3e-6, "controller": 3e-6, "actuator": 3e-5}  # of a row and a candidate, on one usual core
SCAN_BEHIND_S = 2e-5  # the same of points and corners
ROW_HZ = 20.0
CANDIDATES = {"link": 7, "controller": 3, "actuator": 12}  # usual ones of a joint
MAYBE = 0.6  # of a scan's cost: what a cell takes besides, as long as one does not know whether it will have a name
NAMED = 2.5  # of a scan's cost: singles, pairs and triples, once a single gains
FURTHER = 0.7  # of a scan's cost: each name more
CONCLUDING = 0.35  # of all searches' cost: weighing, limits, where it lies, the next experiment


def silent(_text: str, _done: float, _all: float) -> None:
    """Nobody is told."""


class Work:
    """Tells a `Progress` what is done and what is done in all, as far as it is known."""

    def __init__(self, progress: Progress = silent) -> None:
        self._progress = progress
        self._text = ""
        self._ended = self._concluded = 0.0  # cost of parts that have ended, and of what was made of them
        self._later: dict[str, float] = {}  # what later stages will cost, as far as one can tell
        self._waiting: list[float] = []  # the parts of this stage that have not begun
        self._cost = self._scan = self._done = self._before = 0.0  # of the part under way; done before its scan

    def expect_driven(self, joints: int, seconds: float) -> None:
        """Beside what is being searched, so many joints' replays of a recording of so many seconds are to come."""
        rows = ROW_HZ * seconds * joints
        self._later = {stage: SCAN_S[stage] * rows * CANDIDATES[stage] for stage in DRIVEN_STAGES}

    def stage(self, cells: Sequence[Cell]) -> None:
        """These cells are next, one after the other."""
        for cell in cells:
            self._later.pop(cell.stage, None)
        self._waiting = [scan_s(cell) for cell in cells]

    def begin(self, text: str) -> None:
        """The next cell."""
        self._text, self._done, self._before = text, 0.0, 0.0
        self._scan = self._waiting.pop(0) if self._waiting else 0.0
        self._cost = (1.0 + MAYBE) * self._scan
        self._tell()

    def scanned(self, share: float) -> None:
        """Of its candidates so large a share has been scanned."""
        self._done = self._before + share * self._scan
        self._tell()

    def again(self) -> None:
        """The cell is searched once more."""
        self._grow(1.0)

    def named(self) -> None:
        """A name gains: others are looked for beside it."""
        self._cost -= MAYBE * self._scan
        self._grow(NAMED)

    def one_more(self) -> None:
        """Yet another name is looked for."""
        self._grow(FURTHER)

    def end(self) -> None:
        """The cell is done."""
        self._ended += self._cost
        self._cost = self._scan = self._done = 0.0

    def conclude(self, text: str, share: float) -> None:
        """Every search is done, and so large a share of what comes after them."""
        self._later, self._waiting, self._text = {}, [], text
        self._concluded = share * CONCLUDING * self._ended
        self._tell()

    def _grow(self, by: float) -> None:
        """What was to be done of the part is done, and so much of its scan's cost is to come."""
        self._done = self._before = self._cost
        self._cost += by * self._scan
        self._tell()

    def _tell(self) -> None:
        to_come = (1.0 + MAYBE) * (sum(self._waiting) + sum(self._later.values()))
        searches = self._ended + self._cost + to_come
        self._progress(self._text, self._ended + self._done + self._concluded, (1.0 + CONCLUDING) * searches)


def scan_s(cell: Cell) -> float:
    """What scanning a cell's candidates usually takes."""
    return SCAN_S.get(cell.stage, SCAN_BEHIND_S) * cell.rows.count * len(cell.candidates)
