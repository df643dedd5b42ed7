"""The motion that the PC has under way, and what the PLC's states say of it."""

from dataclasses import dataclass

from protocol.codes import PlcState, RejectCode, reject_text
from protocol.messages import State
from protocol.playback import Playback, Window
from protocol.sequence import is_at_or_after
from protocol.servo_target import ServoTarget

MOVING = (PlcState.RUN, PlcState.STOPPING)
_OF_KNOTS = range(RejectCode.LIMIT_Q, RejectCode.OVERRIDE + 1)  # refusals that blame what a command carries


@dataclass(frozen=True, slots=True)
class Stop:
    """A stop under way: wanted since command `first_seq`."""

    reason: str
    first_seq: int
    quick: bool = False


@dataclass(slots=True)
class Run:
    """A trajectory or a servo motion, asked for at command `first_seq`."""

    motion: Playback | ServoTarget
    first_seq: int
    t_asked_ns: int
    started: bool = False
    _before_tail: Playback | None = None
    _tail_seq: int | None = None  # the first command that carried the new tail

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
            self._before_tail, self._tail_seq, self.motion = self.motion, None, playback

    def note_sent(self, seq: int, window: Window) -> None:
        """A command with this window goes out."""
        if isinstance(self.motion, Playback) and self.motion.splice is not None and self._tail_seq is None:
            self._tail_seq = seq if window.covers(self.motion.splice) else None

    def look(self, state: State) -> bool:
        """Take the state in; whether a pending tail has just been taken by the PLC."""
        if state.traj_id == self.traj_id and state.plc_state in MOVING:
            self.started = True
        carried = self.tail_pending and self._tail_seq is not None and is_at_or_after(state.ack_seq, self._tail_seq)
        taken = carried and state.plc_state is PlcState.RUN  # while stopping knots are acknowledged, but not taken
        if taken and isinstance(self.motion, Playback):
            self.motion, self._before_tail = self.motion.spliced(), None
        return taken

    def drop_refused_tail(self, code: int, seq: int) -> bool:
        """Whether this refusal was of the new tail; then the old one goes on."""
        if self._before_tail is None or self._tail_seq is None or code not in _OF_KNOTS:
            return False
        if not is_at_or_after(seq, self._tail_seq):
            return False
        self.motion, self._before_tail = self._before_tail, None
        return True

    def reached(self, state: State) -> bool:
        """Whether the PLC holds at its end."""
        if state.plc_state is not PlcState.HOLD:
            return False
        if isinstance(self.motion, Playback):
            return self.motion.reached(state)
        return self.motion.ending and self.started and state.traj_id == self.traj_id

    def end(self, state: State, stop: Stop | None) -> tuple[bool, str] | None:
        """Whether it is over: (reached, reason); None while it goes on."""
        if state.plc_state in MOVING:
            return None
        if self.reached(state):
            return True, "reached"
        if state.plc_state is not PlcState.HOLD:
            return False, f"PLC went to {state.plc_state.name}"
        if stop and is_at_or_after(state.ack_seq, stop.first_seq):
            return False, stop.reason
        refused = bool(state.reject_count) and is_at_or_after(state.reject_seq, self.first_seq)
        if self.started and state.traj_id == self.traj_id:
            return False, self._why_stopped(state, stop, refused)
        return (False, f"the PLC refused the motion: {reject_text(state.reject_code)}") if refused else None

    def _why_stopped(self, state: State, stop: Stop | None, refused: bool) -> str:
        if stop:
            return stop.reason
        if refused:
            return f"the PLC stopped: {reject_text(state.reject_code)}"
        return "the PLC stopped by itself (underrun or silence); plan again from the present reference"
