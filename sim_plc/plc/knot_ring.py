"""Ring of 64 knots keyed by absolute index, with the checks for accepting a knot."""

from dataclasses import dataclass

import numpy as np

from protocol.codes import CommandFlag, RejectCode
from protocol.limits import LimitTable
from protocol.messages import Axes, Command, Knot
from protocol.objection import Objection, first_of, object_to, object_to_knot
from protocol.timeouts import FROZEN_KNOT_LEAD_NS
from sim_plc.plc.knot_checks import check_knot, check_rest, check_start, check_step
from sim_plc.plc.path import RING_SIZE_KNOTS


@dataclass(frozen=True, slots=True)
class PlaybackView:
    """Where the playback stands, as far as the ring must know it."""

    q_ref: Axes
    knot_playing: int = 0
    t_play_ns: int = 0


class KnotRing:
    """Knots of one trajectory. `last`: highest index held, without a gap below; -1 = empty. `end`: -1 until known."""

    def __init__(self, table: LimitTable) -> None:
        n = len(table.axes)
        self._table = table
        self._kept: list[Knot | None] = [None] * RING_SIZE_KNOTS
        self.times = np.zeros(RING_SIZE_KNOTS)
        self.knots = np.zeros((RING_SIZE_KNOTS, 3, n))
        self.traj_id, self.first, self.last, self.end = 0, 0, -1, -1

    def clear(self) -> None:
        """Forget everything: a new session numbers its trajectories again."""
        self.traj_id, self.first, self.last, self.end = 0, 0, -1, -1

    @property
    def complete(self) -> bool:
        """Whether the trajectory's end is in the ring."""
        return self.end >= 0 and self.end == self.last

    def knot(self, index: int) -> Knot | None:
        """The knot of that index, if the ring holds it."""
        return self._kept[index % RING_SIZE_KNOTS] if self.first <= index <= self.last else None

    def check(self, command: Command, view: PlaybackView) -> Objection | None:
        """Why this command's knots may not be taken; None if they may. Changes nothing."""
        if command.traj_id != self.traj_id or self.last < 0:
            return self._check_new(command, view)
        return self._check_more(command, view)

    def load_knots(self, command: Command, view: PlaybackView) -> None:
        """Take the knots of a command that was checked in the same cycle."""
        if command.traj_id != self.traj_id or self.last < 0:
            self.traj_id, self.first, self.last, self.end = command.traj_id, 0, -1, -1
        replaced = self._first_replaced(command)
        if replaced is not None:
            self.last, self.end = replaced - 1, -1
        for index, knot in enumerate(command.knots, start=command.knot_first):
            if index == self.last + 1:
                self._store_knot(index, knot)
        self.first = max(self.first, view.knot_playing, self.last - RING_SIZE_KNOTS + 1)
        if CommandFlag.LAST_IS_END in command.cmd_flags:
            self.end = command.knot_first + len(command.knots) - 1

    def _store_knot(self, index: int, knot: Knot) -> None:
        slot, n = index % RING_SIZE_KNOTS, len(self._table.axes)
        self._kept[slot] = knot
        self.times[slot] = knot.t_ns * 1e-9
        self.knots[slot] = knot.q[:n], knot.qd[:n], knot.qdd[:n]
        self.last = index

    def _check_new(self, command: Command, view: PlaybackView) -> Objection | None:
        knots = command.knots
        if command.knot_first != 0:
            return object_to(RejectCode.KNOT_GAP, "knot_first")
        if len(knots) < 2:
            return object_to(RejectCode.VALUE, "knot_count")
        return first_of((check_start(knots[0], view.q_ref, self._table), self._check_numbers(command, 0)))

    def _check_more(self, command: Command, view: PlaybackView) -> Objection | None:
        count = len(command.knots)
        if count == 0:
            return object_to(RejectCode.VALUE, "knot_count")
        past_last = command.knot_first + count
        if command.knot_first > self.last + 1:
            return object_to(RejectCode.KNOT_GAP, "knot_first")
        if past_last - max(view.knot_playing, self.first) > RING_SIZE_KNOTS:
            return object_to(RejectCode.RING_FULL, "knot_first")
        replaced = self._first_replaced(command)
        if replaced is not None and not self._may_replace(command, replaced, view):
            return object_to_knot(RejectCode.KNOT_CHANGED, replaced - command.knot_first, "t_ns")
        if replaced is None and not self._same_end(command, past_last - 1):
            return object_to_knot(RejectCode.KNOT_CHANGED, count - 1, "t_ns")
        fresh = self.last + 1 if replaced is None else replaced
        return self._check_numbers(command, min(max(fresh - command.knot_first, 0), count))

    def _same_end(self, command: Command, index: int) -> bool:
        """Whether the command, whose last knot has this index, agrees with what is known of the end.

        Known: nothing after it, the flag there and only there. Not known: it cannot be before the last knot held.
        """
        flagged = CommandFlag.LAST_IS_END in command.cmd_flags
        if self.end < 0:
            return not flagged or index >= self.last
        return index <= self.end and flagged == (index == self.end)

    def _first_replaced(self, command: Command) -> int | None:
        """The lowest index that is held with other values than the command brings."""
        if command.traj_id != self.traj_id:
            return None
        for index, knot in enumerate(command.knots, start=command.knot_first):
            held = self.knot(index)
            if held is not None and held is not knot and held != knot:
                return index
        return None

    def _may_replace(self, command: Command, index: int, view: PlaybackView) -> bool:
        """Only a tail beyond the frozen horizon, and only when the command says so."""
        held = self.knot(index)
        return (
            CommandFlag.TAIL_REPLACES in command.cmd_flags
            and held is not None
            and min(held.t_ns, command.knots[index - command.knot_first].t_ns) >= view.t_play_ns + FROZEN_KNOT_LEAD_NS
            and index > view.knot_playing + 1
        )

    def _check_numbers(self, command: Command, fresh: int) -> Objection | None:
        """The command's knots from position `fresh` on, each and against its neighbour before; then the end."""
        knots = command.knots
        before = knots[fresh - 1] if fresh else self.knot(command.knot_first - 1) if command.knot_first else None
        for k, knot in enumerate(knots[fresh:], start=fresh):
            objection = check_knot(knot, k, self._table)
            if objection is None and before is not None:
                objection = check_step(before, knot, k, self._table)
            if objection is not None:
                return objection
            before = knot
        if CommandFlag.LAST_IS_END not in command.cmd_flags:
            return None
        return check_rest(knots[-1], len(knots) - 1, RejectCode.END_NOT_AT_REST)
