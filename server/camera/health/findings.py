"""What a monitor is given, and what it finds wrong with a stereo pair."""

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from server.camera.contracts import StereoFrame
from server.camera.health.thumbnail import EyeCells
from server.vision.contracts import PairObservation


class FaultCode(Enum):
    """The name of a fault."""

    WRONG_SIZE = "wrong_size"
    GARBAGE = "garbage"
    BLACK = "black"
    SATURATED = "saturated"
    NO_CONTRAST = "no_contrast"
    EYE_GONE = "eye_gone"
    EYE_COPIED = "eye_copied"
    FROZEN = "frozen"
    SILENT = "silent"
    STAMP_STANDS = "stamp_stands"
    STAMP_BACKWARDS = "stamp_backwards"
    STAMP_JUMPED = "stamp_jumped"
    LATE = "late"
    STARTING = "starting"
    FLICKER = "flicker"
    UNEVEN_EXPOSURE = "uneven_exposure"
    BLURRED = "blurred"
    DIRTY_LENS = "dirty_lens"
    EYES_SWAPPED = "eyes_swapped"
    ROWS_DIFFER = "rows_differ"
    NOT_AS_CALIBRATED = "not_as_calibrated"
    MARKER_TWICE = "marker_twice"
    MARKER_MOVED = "marker_moved"
    JUMPED = "jumped"


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault of one pair. `text`: subject, value, limit, unit, remedy.

    `forbids_look`: poses of this pair must not enter a look. `forbids_odometry`: nor the odometry.
    """

    code: FaultCode
    text: str
    forbids_look: bool = True
    forbids_odometry: bool = True


@dataclass(frozen=True, slots=True)
class Pair:
    """One pair. `is_first`: nothing before it to compare with (start, new connection, new size).

    `is_resumed`: the first of a new connection, of the size of the pictures before: it may be the last of those again.
    """

    frame: StereoFrame
    left_cells: EyeCells
    right_cells: EyeCells
    thumbnail_step_px: int
    is_first: bool
    is_resumed: bool = False
    observation: PairObservation | None = None

    @property
    def eyes(self) -> tuple[tuple[str, EyeCells], tuple[str, EyeCells]]:
        """Both eyes by name."""
        return ("left", self.left_cells), ("right", self.right_cells)


class Monitor(Protocol):
    """Watches for one kind of fault; remembers what it needs from pair to pair."""

    def check(self, pair: Pair) -> tuple[Finding, ...]:
        """What is wrong with this pair."""
        ...
