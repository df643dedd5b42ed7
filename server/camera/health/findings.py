"""What can be wrong with a stereo pair, and one finding of it."""

from dataclasses import dataclass
from enum import Enum


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
