"""Select the knots of the next command: the sliding window over a trajectory, paced by the PLC's reports. Pure."""

from dataclasses import dataclass, replace

from protocol.codes import CommandFlag
from protocol.layout import KNOTS_PER_COMMAND
from protocol.messages import Knot, State
from protocol.timeouts import KNOT_RING_CAPACITY, PREFILL_NS


@dataclass(frozen=True, slots=True)
class Window:
    """A command's share of the trajectory."""

    knot_first: int
    knots: tuple[Knot, ...]
    knot_before: Knot | None
    command_flags: CommandFlag

    def holds_knot(self, index: int) -> bool:
        """Whether the knot of that index is among them."""
        return self.knot_first <= index < self.knot_first + len(self.knots)


def _first_difference(old: tuple[Knot, ...], new: tuple[Knot, ...]) -> int | None:
    """Index of the first knot that the PLC would see replaced; of the end that stops or starts being the end.

    A command with nothing but knots that the PLC holds already replaces nothing, whatever follows them here.
    """
    common = min(len(old), len(new))
    changed = next((i for i in range(common) if old[i] != new[i]), None)
    return common - 1 if changed is None and len(old) != len(new) else changed


@dataclass(frozen=True, slots=True)
class Playback:
    """One trajectory on its way to the PLC. `splice_knot_index`: first changed knot while the PLC may hold the old
    ones."""

    traj_id: int
    knots: tuple[Knot, ...]
    splice_knot_index: int | None = None

    @property
    def last(self) -> int:
        """Index of the last knot."""
        return len(self.knots) - 1

    def with_tail(self, first: int, knots: tuple[Knot, ...]) -> "Playback":
        """The same trajectory with everything from `first` on replaced; `splice_knot_index` stays None if that changes
        nothing."""
        new = (*self.knots[:first], *knots)
        return replace(self, knots=new, splice_knot_index=_first_difference(self.knots, new))

    def with_splice_accepted(self) -> "Playback":
        """The PLC has taken the new tail."""
        return replace(self, splice_knot_index=None)

    def window(self, state: State) -> Window:
        """The first knots that the PLC is missing, while its ring has room; else the next unplayed ones again."""
        first = self._first(state)
        knots = self.knots[first : first + KNOTS_PER_COMMAND]
        flags = CommandFlag.START if self._may_start(state) else CommandFlag(0)
        if self.splice_knot_index is not None:
            flags |= CommandFlag.TAIL_REPLACES
        if first + len(knots) > self.last:
            flags |= CommandFlag.LAST_IS_END
        return Window(first, knots, self.knots[first - 1] if first else None, flags)

    def _may_start(self, state: State) -> bool:
        """Whether the PLC holds enough: the whole, or 800 ms, or all that its ring takes. It repeats once it runs."""
        if state.traj_id != self.traj_id:
            return False
        held = state.knot_last
        full = held + 1 + KNOTS_PER_COMMAND - state.knot_playing > KNOT_RING_CAPACITY
        return held >= self.last or self.knots[held].t_ns >= PREFILL_NS or full

    def _first(self, state: State) -> int:
        if state.traj_id != self.traj_id:
            return 0
        missing = state.knot_last + 1
        if self.splice_knot_index is not None and missing >= self.splice_knot_index:
            return self.splice_knot_index  # sent until it is taken: what the PLC holds from here on is the old tail
        room = missing + KNOTS_PER_COMMAND - state.knot_playing <= KNOT_RING_CAPACITY
        wanted = missing if missing <= self.last and room else state.knot_playing
        # a command near the end is filled up from before it, so that it always carries as much as it can
        return max(0, min(wanted, self.last + 1 - KNOTS_PER_COMMAND))

    def played_to_end(self, state: State) -> bool:
        """Whether the PLC has played this trajectory to its last knot."""
        return (
            state.traj_id == self.traj_id and self.splice_knot_index is None and state.t_play_ns >= self.knots[-1].t_ns
        )
