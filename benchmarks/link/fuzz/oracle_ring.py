"""The oracle's own picture of the PLC's knots, and what the PLC must have against more of them."""

from collections.abc import Iterator
from dataclasses import dataclass, field

from benchmarks.link.fuzz.oracle_fields import CommandFields, KnotFields, StateFields
from benchmarks.link.fuzz.oracle_knots import at_rest, one_knot, place, start, step
from benchmarks.link.fuzz.verdict import Breach
from protocol.codes import RejectCode
from protocol.limits import LimitTable

_RING = 64
_FROZEN_NS = 100_000_000
_BETWEEN = 1.10  # how far the quintic between knots, and the stop from a knot, may pass the limits
_LAST_IS_END, _TAIL_REPLACES = 1, 4
_CHANGED = RejectCode.KNOT_CHANGED


@dataclass(slots=True)
class RingShadow:
    """Knots by index, no gap from `first` to `last`; -1: none. `end`: index of the trajectory's end, -1: not known.

    What lies before the segment that was played when knots came last is forgotten: neither compared nor judged again.
    """

    table: LimitTable
    traj_id: int = 0
    first: int = 0
    last: int = -1
    end: int = -1
    knots: dict[int, KnotFields] = field(default_factory=dict)

    def clear(self, traj_id: int = 0) -> None:
        """Begin a trajectory without knots."""
        self.traj_id, self.first, self.last, self.end, self.knots = traj_id, 0, -1, -1, {}

    def is_new(self, command: CommandFields) -> bool:
        """Whether the command begins another trajectory."""
        return command.traj_id != self.traj_id or self.last < 0

    def load(self, command: CommandFields, seen: StateFields) -> None:
        """Take what was accepted."""
        playing = 0 if self.is_new(command) else seen.knot_playing
        if self.is_new(command):
            self.clear(command.traj_id)
        changed = self._changed(command)
        if changed is not None and command.knot_first + changed > 0:
            self.last, self.end = command.knot_first + changed - 1, -1
        for k, knot in enumerate(command.knots):
            if command.knot_first + k == self.last + 1:
                self.last += 1
                self.knots[self.last] = knot
        self.first = max(self.first, playing)
        if command.cmd_flags & _LAST_IS_END:
            self.end = command.knot_first + len(command.knots) - 1

    def breaches(self, command: CommandFields, seen: StateFields) -> Iterator[Breach]:
        """Everything against the command's knots."""
        if self.is_new(command):
            yield from self._against_new(command, seen)
        else:
            yield from self._against_more(command, seen)

    def _against_new(self, command: CommandFields, seen: StateFields) -> Iterator[Breach]:
        if command.knot_first != 0:
            yield Breach(RejectCode.KNOT_GAP, 60)
        if len(command.knots) < 2:
            yield Breach(RejectCode.VALUE, 64)
        if command.knot_first == 0 and command.knots:
            yield from start(command.knots[0], seen.q_ref, self.table.start_tolerance_rad)
            yield from self._numbers(command, 0, None)

    def _against_more(self, command: CommandFields, seen: StateFields) -> Iterator[Breach]:
        count = len(command.knots)
        if count == 0:
            yield Breach(RejectCode.VALUE, 64)
            return
        if command.knot_first > self.last + 1:
            yield Breach(RejectCode.KNOT_GAP, 60)
            return
        if command.knot_first + count - seen.knot_playing > _RING:
            yield Breach(RejectCode.RING_FULL, 60)
        changed = self._changed(command)
        if changed is None:
            yield from self._against_end(command, command.knot_first + count - 1)
        else:
            yield from self._against_change(command, changed, seen)
        fresh = self.last + 1 - command.knot_first if changed is None else changed
        fresh = min(max(fresh, 0), count)
        before = command.knots[fresh - 1] if fresh else self.knots.get(command.knot_first - 1)
        yield from self._numbers(command, fresh, before)

    def _changed(self, command: CommandFields) -> int | None:
        """The place of the first knot that is known with other values."""
        if command.traj_id == self.traj_id:
            for k, knot in enumerate(command.knots):
                index = command.knot_first + k
                if self.first <= index <= self.last and self.knots[index] != knot:
                    return k
        return None

    def _against_change(self, command: CommandFields, k: int, seen: StateFields) -> Iterator[Breach]:
        """A change: only with the flag, beyond the segment being played, and at least 100 ms ahead of the playback."""
        index = command.knot_first + k
        nearest = min(self.knots[index][0], command.knots[k][0])
        if (
            not command.cmd_flags & _TAIL_REPLACES
            or index <= seen.knot_playing + 1
            or nearest < seen.t_play_ns + _FROZEN_NS
        ):
            yield Breach(_CHANGED, place(k))

    def _against_end(self, command: CommandFields, index: int) -> Iterator[Breach]:
        """What is known of the end cannot be told otherwise."""
        flagged = bool(command.cmd_flags & _LAST_IS_END)
        known = self.end >= 0
        if (known and (index > self.end or flagged != (index == self.end))) or (
            not known and flagged and index < self.last
        ):
            yield Breach(_CHANGED, place(len(command.knots) - 1))

    def _numbers(self, command: CommandFields, fresh: int, before: KnotFields | None) -> Iterator[Breach]:
        for k, knot in enumerate(command.knots[fresh:], start=fresh):
            yield from one_knot(knot, k, self.table, _BETWEEN)
            if before is not None:
                yield from step(before, knot, k, self.table, _BETWEEN)
            before = knot
        if command.cmd_flags & _LAST_IS_END and command.knots:
            k = len(command.knots) - 1
            yield from at_rest(command.knots[k], k, RejectCode.END_NOT_AT_REST)
