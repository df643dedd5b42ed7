"""Which presses of STOP get a line of the audit: all that stop something, and one in ten seconds of those that do not.

A stop itself is never folded. Anybody may send one, without a key and as often as he likes: a line for each would fill
the disk, and the queue that jobs and control need.
"""

EVERY_S = 10.0
ADDRESSES_MAX = 256


class FoldedStops:
    """By address; bounded, the ones that were silent for longest go first."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[float, int]] = {}  # when a line was written, and presses since

    def to_write(self, address: str, now_s: float, matters: bool) -> int | None:
        """How many presses before this one have no line, if this one is to have one; None: it is counted only."""
        at_s, folded = self._last.pop(address, (-EVERY_S, 0))
        if not matters and now_s - at_s < EVERY_S:
            self._last[address] = at_s, folded + 1
            return None
        self._last[address] = now_s, 0
        if len(self._last) > ADDRESSES_MAX:
            del self._last[next(iter(self._last))]
        return folded
