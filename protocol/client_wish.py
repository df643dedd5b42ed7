"""Standing requests of the PC to arm, reset or disarm, repeated until a state confirms them."""

from dataclasses import dataclass
from enum import Enum

from protocol.client_run import MOVING
from protocol.codes import Mode, PlcState
from protocol.messages import State
from protocol.timeouts import ARM_PERIOD, GOOD_COMMANDS_TO_ARM


class Wish(Enum):
    """One at a time; the newest counts."""

    NONE = "none"
    ARM = "arm"
    RESET = "reset"
    DISARM = "disarm"


@dataclass(slots=True)
class StandingWish:
    """The wish of one session; it ends with it."""

    wish: Wish = Wish.NONE
    _t_asked_ns: int | None = None  # for arm or reset

    @property
    def is_disarm(self) -> bool:
        """Whether disarming was requested, which nothing but its end takes back."""
        return self.wish is Wish.DISARM

    def cancel(self) -> None:
        """Stop asking for arm or reset; a disarm that was requested goes on until it is done."""
        if not self.is_disarm:
            self.wish = Wish.NONE

    def look(self, state: State) -> None:
        """Forget what a state shows fulfilled."""
        armed = state.plc_state in (PlcState.HOLD, *MOVING)
        reset = state.plc_state is not PlcState.FAULT
        if (self.wish is Wish.ARM and armed) or (self.wish is Wish.RESET and reset):
            self.wish = Wish.NONE

    def mode(self, state: State, t_mono_ns: int) -> Mode:
        """RESET or ARM when the PLC is ready for it and it is time to ask, else HEARTBEAT."""
        proven = state.rx_ok >= GOOD_COMMANDS_TO_ARM
        if self.wish is Wish.RESET and state.plc_state is PlcState.FAULT:
            mode = Mode.RESET
        elif self.wish is Wish.ARM and state.plc_state is PlcState.LINKED and proven:
            mode = Mode.ARM
        else:
            return Mode.HEARTBEAT
        return mode if self._is_due(t_mono_ns) else Mode.HEARTBEAT

    def _is_due(self, t_mono_ns: int) -> bool:
        """Heartbeats in between: a refused ARM or RESET feeds no watchdog, and the session must outlive it."""
        due = self._t_asked_ns is None or t_mono_ns - self._t_asked_ns >= ARM_PERIOD.ns
        self._t_asked_ns = t_mono_ns if due else self._t_asked_ns
        return due
