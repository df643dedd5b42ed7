"""What a monitor is given: the pair, its thumbnails, and what vision made of it where that is known already."""

from dataclasses import dataclass
from typing import Protocol

from server.camera.contracts import StereoFrame
from server.camera.health.findings import Finding
from server.camera.health.thumbnail import EyeCells
from server.vision.contracts import PairObservation


@dataclass(frozen=True, slots=True)
class Pair:
    """One pair. `first`: nothing before it to compare with (start, new connection, new size).

    `resumed`: the first of a new connection, of the size of the pictures before: it may be the last of those again.
    """

    frame: StereoFrame
    left: EyeCells
    right: EyeCells
    step: int
    first: bool
    resumed: bool = False
    observation: PairObservation | None = None

    @property
    def eyes(self) -> tuple[tuple[str, EyeCells], tuple[str, EyeCells]]:
        """Both eyes by name."""
        return ("left", self.left), ("right", self.right)


class Monitor(Protocol):
    """Watches for one kind of fault; remembers what it needs from pair to pair."""

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """What is wrong with this pair."""
        ...
