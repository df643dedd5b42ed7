"""Progress of a diagnosis with the remaining time: a bar on a terminal, a line every few seconds elsewhere."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

USUAL_S = 2.0  # of work that is taken to have gone as fast as usual before this computer's own speed counts
SOONER, LATER = 0.6, 2.0  # of what the speed so far predicts
KNOWN_FROM = 0.1  # of the work: before that the speed is a guess
EVERY_S = 2.0  # between two lines where there is no terminal
STEPS_S = (5, 10, 15, 20, 30, 45, 60, 90, 120, 180, 240, 300, 420, 600, 900, 1200, 1800, 3600)


def left_s(done: float, total: float, elapsed_s: float) -> float:
    """Seconds that are left, by the speed so far; `done` and `total` in seconds of a usual computer."""
    return max(total - done, 0.0) * (elapsed_s + USUAL_S) / (max(done, 0.0) + USUAL_S)


def in_words(seconds: float) -> str:
    """Remaining time as a range: how many effects will be found, and so searched, is not known in advance."""
    low, high = (_near(factor * seconds) for factor in (SOONER, LATER))
    if high <= STEPS_S[0]:
        return "a few seconds left"
    if high < 120:
        return f"{low} to {high} s left"
    return f"{low} s to {high // 60} min left" if low < 120 else f"{low // 60} to {high // 60} min left"


def _near(seconds: float) -> int:
    return min(STEPS_S, key=lambda step: abs(step - seconds) / step)


Say = Callable[[str, float, float], None]  # words, share that is done, seconds since the begin


@dataclass(slots=True)
class Outlook:
    """Shows the progress of a diagnosis with the estimated remaining time."""

    say: Say
    now_s: Callable[[], float] = time.monotonic
    _begun_s: float = field(init=False)
    _furthest: float = 0.0

    def __post_init__(self) -> None:
        self._begun_s = self.now_s()

    def heard(self, text: str, done: float, total: float) -> None:
        """Progress callback of the diagnosis. The share never decreases, although found effects slow the rest down."""
        elapsed_s = self.now_s() - self._begun_s
        share = self._furthest = min(max(self._furthest, done / max(total, 1e-9)), 0.99)
        rest = in_words(left_s(done, total, elapsed_s)) if share >= KNOWN_FROM else "remaining time unknown"
        self.say(f"{text}: {100.0 * share:.0f} % done, {rest}", share, elapsed_s)

    def also(self, text: str) -> None:
        """What comes when all searches are done."""
        self.say(f"{text}: {100.0 * self._furthest:.0f} % done", self._furthest, self.now_s() - self._begun_s)


@contextmanager
def outlook(screen: Console, now_s: Callable[[], float] = time.monotonic) -> Iterator[Outlook]:
    """On this console."""
    if not screen.is_terminal:
        yield Outlook(_lines(screen), now_s)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=screen, transient=True) as shown:
        task = shown.add_task("preparing", total=None)
        yield Outlook(lambda words, share, _s: shown.update(task, description=words, completed=share, total=1.0), now_s)


def _lines(screen: Console) -> Say:
    """For a log, or for the server that follows: at most one line in EVERY_S, and none at the start."""
    last_s = EVERY_S

    def say(words: str, _share: float, elapsed_s: float) -> None:
        nonlocal last_s
        if elapsed_s - last_s >= EVERY_S:
            last_s = elapsed_s
            screen.print(words, soft_wrap=True, highlight=False)

    return say
