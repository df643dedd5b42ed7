"""Sequence rule of both directions: classify a new number against the last accepted one."""

from dataclasses import dataclass
from enum import Enum

from protocol.timeouts import SEQUENCE_JUMP_MAX


class SequenceKind(Enum):
    """What a sequence number is, seen from the last accepted one."""

    NEXT = "next"
    GAP = "gap"
    DUPLICATE = "duplicate"
    LATE = "late"
    JUMP = "jump"


@dataclass(frozen=True, slots=True)
class SequenceVerdict:
    """The verdict; `n_lost` counts the numbers skipped (GAP only)."""

    kind: SequenceKind
    n_lost: int = 0

    @property
    def is_usable(self) -> bool:
        """Whether the datagram is newer than all before, and near enough to belong to them."""
        return self.kind in (SequenceKind.NEXT, SequenceKind.GAP)


def classify_sequence(last: int, seq: int) -> SequenceVerdict:
    """Compare as signed 32-bit difference, so the wrap at 2^32 is not an event."""
    delta = (seq - last + 0x8000_0000) % 0x1_0000_0000 - 0x8000_0000
    if delta == 1:
        return SequenceVerdict(SequenceKind.NEXT)
    if 2 <= delta <= SEQUENCE_JUMP_MAX:
        return SequenceVerdict(SequenceKind.GAP, n_lost=delta - 1)
    if delta == 0:
        return SequenceVerdict(SequenceKind.DUPLICATE)
    if -SEQUENCE_JUMP_MAX <= delta < 0:
        return SequenceVerdict(SequenceKind.LATE)
    return SequenceVerdict(SequenceKind.JUMP)


def next_sequence(seq: int) -> int:
    """The number after `seq`, wrapping at 2^32."""
    return (seq + 1) % 0x1_0000_0000


def is_at_or_after(seq: int, first: int) -> bool:
    """Whether `seq` is `first` or newer, across the wrap."""
    return (seq - first) % 0x1_0000_0000 < 0x8000_0000
