"""The ring of knots: what the PLC holds of a trajectory, keyed by absolute index, and what it refuses to take."""

from dataclasses import dataclass, field

from protocol.codes import CommandFlag, Interp, RejectCode
from protocol.limits import LimitTable
from protocol.messages import Axes, Command, Knot
from protocol.timeouts import RING_KNOTS

ROUNDING = 1e-9  # relative slack on limits: a planner that plans to the limit is not refused for its last bit
REST = 1e-6  # [rad/s, rad/s^2]: at rest, up to rounding


@dataclass(slots=True)
class KnotRing:
    """Knots of one trajectory. `last` is the highest index up to which there is no gap; -1 = empty."""

    table: LimitTable
    traj_id: int = 0
    last: int = -1
    end: int | None = None
    knots: dict[int, Knot] = field(default_factory=dict)

    def check(self, command: Command, q_ref: Axes, playing: int) -> RejectCode:
        """Why this command's knots may not be taken; NONE if they may. Changes nothing."""
        if command.interp is not Interp.QUINTIC or not command.knots:
            return RejectCode.INTERP
        if CommandFlag.TAIL_REPLACES in command.cmd_flags:
            return RejectCode.KNOT_CHANGED  # replacing a tail is not supported by this program
        fresh = command.traj_id != self.traj_id
        known_last = -1 if fresh else self.last
        if command.knot_first > known_last + 1:
            return RejectCode.KNOT_GAP
        first_kept = 0 if fresh else max(playing - 1, 0)
        if command.knot_first + len(command.knots) - first_kept > RING_KNOTS:
            return RejectCode.RING_FULL
        if fresh and not self._starts_at(command.knots[0], q_ref):
            return RejectCode.START
        if not fresh and not self._repeats(command):
            return RejectCode.KNOT_CHANGED
        return self._check_numbers(command, None if fresh else self.knots.get(command.knot_first - 1))

    def load(self, command: Command) -> None:
        """Take the knots of a checked command."""
        if command.traj_id != self.traj_id:
            self.traj_id, self.last, self.end = command.traj_id, -1, None
            self.knots.clear()
        for index, knot in enumerate(command.knots, start=command.knot_first):
            if index > self.last:
                self.knots[index] = knot
                self.last = index
        if CommandFlag.LAST_IS_END in command.cmd_flags:
            self.end = command.knot_first + len(command.knots) - 1

    def forget_before(self, index: int) -> None:
        """Drop knots that have been played."""
        for old in [known for known in self.knots if known < index]:
            del self.knots[old]

    def _starts_at(self, knot: Knot, q_ref: Axes) -> bool:
        n, tolerance = len(self.table.axes), self.table.start_tolerance_rad
        at_rest = all(abs(value) <= REST for value in (*knot.qd[:n], *knot.qdd[:n]))
        return at_rest and knot.t_ns == 0 and all(abs(knot.q[i] - q_ref[i]) <= tolerance for i in range(n))

    def _repeats(self, command: Command) -> bool:
        """Whether every knot that is here already comes again bit by bit."""
        pairs = enumerate(command.knots, start=command.knot_first)
        return all(index not in self.knots or self.knots[index] == knot for index, knot in pairs)

    def _check_numbers(self, command: Command, before: Knot | None) -> RejectCode:
        for knot in command.knots:
            code = self._check_limits(knot)
            if code is RejectCode.NONE and before is not None:
                code = self._check_step(before, knot)
            if code is not RejectCode.NONE:
                return code
            before = knot
        if CommandFlag.LAST_IS_END in command.cmd_flags:
            n, final = len(self.table.axes), command.knots[-1]
            if any(abs(value) > REST for value in (*final.qd[:n], *final.qdd[:n])):
                return RejectCode.END_NOT_AT_REST
        return RejectCode.NONE

    def _check_limits(self, knot: Knot) -> RejectCode:
        for i, axis in enumerate(self.table.axes):
            slack = 1.0 + ROUNDING
            if not axis.q_min - ROUNDING <= knot.q[i] <= axis.q_max + ROUNDING:
                return RejectCode.LIMIT_Q
            if abs(knot.qd[i]) > axis.qd_max * slack:
                return RejectCode.LIMIT_QD
            if abs(knot.qdd[i]) > axis.qdd_max * slack:
                return RejectCode.LIMIT_QDD
        return RejectCode.NONE

    def _check_step(self, before: Knot, knot: Knot) -> RejectCode:
        step_ns = knot.t_ns - before.t_ns
        if not self.table.spacing_min_ns <= step_ns <= self.table.spacing_max_ns:
            return RejectCode.KNOT_SPACING
        for i, axis in enumerate(self.table.axes):
            if abs(knot.q[i] - before.q[i]) > axis.qd_max * (1.0 + ROUNDING) * step_ns * 1e-9:
                return RejectCode.IMPLIED_SPEED
        return RejectCode.NONE
