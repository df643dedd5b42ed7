"""The motion that the PC has running, and its progress by the PLC's states."""

from dataclasses import dataclass, field

from protocol.codes import PlcState, RejectCode, reject_text
from protocol.messages import State
from protocol.playback import Playback, Window
from protocol.sequence import is_at_or_after
from protocol.servo_target import ServoTarget

MOVING_STATES = (PlcState.RUN, PlcState.STOPPING)
_OF_KNOTS = range(RejectCode.LIMIT_Q, RejectCode.OVERRIDE + 1)  # refusals that blame what a command carries
_OF_OTHERS = (RejectCode.SOURCE, RejectCode.SESSION)  # refusals of another client's datagrams, with their numbers


@dataclass(frozen=True, slots=True)
class StopReference:
    """A stop under way: wanted since command `first_seq`."""

    reason: str
    first_seq: int
    quick: bool = False


@dataclass(slots=True)
class Run:
    """A trajectory or a servo motion, requested at command `first_seq`."""

    motion: Playback | ServoTarget
    first_seq: int
    t_asked_ns: int
    started: bool = False
    _before_tail: Playback | None = None
    _tail_seqs: set[int] = field(default_factory=set)  # commands that carried the splice of the new tail

    @property
    def traj_id(self) -> int:
        """The number it goes by on the wire."""
        return self.motion.traj_id

    @property
    def tail_pending(self) -> bool:
        """Whether a new tail has not been taken yet."""
        return self._before_tail is not None

    def replace_tail(self, playback: Playback) -> None:
        """Send a new tail from now on."""
        if isinstance(self.motion, Playback):
            self._before_tail, self.motion = self.motion, playback
            self._tail_seqs.clear()

    def note_sent(self, seq: int, window: Window) -> None:
        """A command with this window goes out."""
        splice = self.motion.splice_knot_index if isinstance(self.motion, Playback) else None
        if splice is not None and window.holds_knot(splice):
            self._tail_seqs.add(seq)

    def look(self, state: State) -> bool:
        """Take the state in; whether a pending tail has just been taken by the PLC."""
        if state.traj_id == self.traj_id and state.plc_state in MOVING_STATES:
            self.started = True
        carried = self.tail_pending and state.ack_seq in self._tail_seqs
        taken = carried and state.plc_state is PlcState.RUN  # while stopping knots are acknowledged, but not taken
        if taken and isinstance(self.motion, Playback):
            self.motion, self._before_tail = self.motion.with_splice_accepted(), None
        return taken

    def drop_refused_tail(self, code: int, seq: int) -> bool:
        """Whether this refusal was of the new tail; then the old one goes on."""
        if self._before_tail is None or code not in _OF_KNOTS or seq not in self._tail_seqs:
            return False
        self.motion, self._before_tail = self._before_tail, None
        return True

    def holds_at_end(self, state: State) -> bool:
        """Whether the PLC holds at its end."""
        if state.plc_state is not PlcState.HOLD:
            return False
        if isinstance(self.motion, Playback):
            return self.motion.played_to_end(state)
        return self.motion.ending and self.started and state.traj_id == self.traj_id

    def is_over(self, state: State, stop: StopReference | None) -> tuple[bool, str] | None:
        """Whether it is over: (reached, reason); None while it goes on."""
        if state.plc_state in MOVING_STATES:
            return None
        if self.holds_at_end(state):
            return True, "reached"
        if state.plc_state is not PlcState.HOLD:
            return False, f"PLC went to {state.plc_state.name}"
        if stop and is_at_or_after(state.ack_seq, stop.first_seq):
            return False, stop.reason
        refused = self._refused(state)
        if self.started and state.traj_id == self.traj_id:
            return False, self._why_stopped(state, stop, refused)
        return (False, f"the PLC refused the motion: {reject_text(state.reject_code)}") if refused else None

    def _refused(self, state: State) -> bool:
        """Whether the PLC's newest refusal is of a command of this motion."""
        ours = bool(state.reject_count) and state.reject_code not in _OF_OTHERS
        return ours and is_at_or_after(state.reject_seq, self.first_seq)

    def _why_stopped(self, state: State, stop: StopReference | None, refused: bool) -> str:
        if stop:
            return stop.reason
        if refused:
            return f"the PLC stopped: {reject_text(state.reject_code)}"
        return (
            "the PLC stopped by itself (underrun or silence: this computer, its network or the PLC is too busy); "
            "plan again from the present reference"
        )
