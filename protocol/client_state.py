"""Standing requests of the PC to arm, reset or disarm, repeated until a state confirms them."""

from collections import OrderedDict, deque
from dataclasses import dataclass, field
from enum import Enum

from protocol.client_run import MOVING_STATES
from protocol.codes import Mode, PlcState, RejectCode, reject_text
from protocol.layout import command_field_text
from protocol.messages import State
from protocol.timeouts import ARM_PERIOD, GOOD_COMMANDS_TO_ARM

# What the PC's end of the link has counted.


@dataclass(slots=True)
class ClientCounters:
    """What this end has seen."""

    sent: int = 0
    received: int = 0
    lost: int = 0
    duplicate_or_late: int = 0  # duplicates and late ones
    malformed: int = 0
    rejected: int = 0


# What the PC has sent lately, so that a refusal can be shown with the field's name and value.

_KEPT = 128  # two and a half seconds of commands


@dataclass(slots=True)
class SentCommands:
    """Payloads by sequence number, the newest 128."""

    _payloads: OrderedDict[int, bytes] = field(default_factory=OrderedDict)

    def note_sent(self, seq: int, payload: bytes) -> None:
        """Remember what was sent."""
        self._payloads[seq] = payload
        if len(self._payloads) > _KEPT:
            self._payloads.popitem(last=False)

    def explain(self, code: int, seq: int, offset: int) -> str:
        """A refusal in words: code, remedy, and the field of that command, as far as it is still known."""
        payload = self._payloads.get(seq)
        found = command_field_text(payload, offset) if payload else ""
        return f"{reject_text(code)} [{found}]" if found else reject_text(code)


def other_pc_text(state: State, session: int, linked: bool) -> str:
    """That another PC has or wants the PLC, by the session's number: no address is on the wire. Empty: none shows.

    What we send carries the open session's number, so a refusal for its session is of another PC's command.
    """
    if state.session not in (0, session):
        holds = f"another PC holds the PLC's session {state.session:#010x}"
        return f"{holds}; end the server there, or wait 1 s after it has ended"
    if linked and state.reject_code == RejectCode.SESSION:
        return f"another PC asks for the PLC's session, which this one holds ({session:#010x}); end one of both servers"
    return ""


# How far the PLC's clock is from the PC's, from the echo's four stamps; the fastest round trips weigh most.

_BUCKET_NS = 1_000_000_000
_BUCKETS = 30  # half a minute: at 50 ppm the clocks drift apart by 1.5 ms in it


@dataclass(frozen=True, slots=True)
class _BestClockOffset:
    second: int
    delay_ns: int
    offset_ns: int


@dataclass(slots=True)
class ClockOffset:
    """Minimum-delay filter: the best exchange of every second, the best of half a minute counts."""

    delay_ns: int = 0  # newest round trip without the time spent in the PLC
    _best: deque[_BestClockOffset] = field(default_factory=lambda: deque(maxlen=_BUCKETS))

    def add(self, t_pc_send_ns: int, t_plc_receive_ns: int, t_plc_send_ns: int, t_pc_receive_ns: int) -> None:
        """One exchange: command sent, command accepted, state sent, state received; each on its own end's clock.

        Model: delay = (t4 - t1) - (t3 - t2), offset = ((t1 - t2) + (t4 - t3)) / 2 with t_pc = t_plc + offset.
        Source: RFC 5905, section 8.
        """
        self.delay_ns = (t_pc_receive_ns - t_pc_send_ns) - (t_plc_send_ns - t_plc_receive_ns)
        offset_ns = ((t_pc_send_ns - t_plc_receive_ns) + (t_pc_receive_ns - t_plc_send_ns)) // 2
        second = t_pc_receive_ns // _BUCKET_NS
        if not self._best or self._best[-1].second != second:
            self._best.append(_BestClockOffset(second, self.delay_ns, offset_ns))
        elif self.delay_ns < self._best[-1].delay_ns:
            self._best[-1] = _BestClockOffset(second, self.delay_ns, offset_ns)

    @property
    def delay_min_ns(self) -> int:
        """The quickest round trip of the last half minute; 0 before the first exchange."""
        return min((best.delay_ns for best in self._best), default=0)

    @property
    def offset_ns(self) -> int | None:
        """t_pc = t_plc + offset; None before the first exchange."""
        return min(self._best, key=lambda best: best.delay_ns).offset_ns if self._best else None


class RequestKind(Enum):
    """What the PC requests of the PLC: one thing at a time, the newest counts."""

    NONE = "none"
    ARM = "arm"
    RESET = "reset"
    DISARM = "disarm"


@dataclass(slots=True)
class PendingRequest:
    """The request of one session, which ends with it."""

    request_kind: RequestKind = RequestKind.NONE
    _t_asked_ns: int | None = None  # for arm or reset

    @property
    def is_disarm(self) -> bool:
        """Whether disarming was requested, which nothing but its end takes back."""
        return self.request_kind is RequestKind.DISARM

    def cancel(self) -> None:
        """Stop asking for arm or reset; a disarm that was requested goes on until it is done."""
        if not self.is_disarm:
            self.request_kind = RequestKind.NONE

    def look(self, state: State) -> None:
        """Forget what a state shows fulfilled."""
        armed = state.plc_state in (PlcState.HOLD, *MOVING_STATES)
        reset = state.plc_state is not PlcState.FAULT
        if (self.request_kind is RequestKind.ARM and armed) or (self.request_kind is RequestKind.RESET and reset):
            self.request_kind = RequestKind.NONE

    def mode(self, state: State, t_mono_ns: int) -> Mode:
        """RESET or ARM when the PLC is ready for it and it is time to ask, else HEARTBEAT."""
        proven = state.rx_ok >= GOOD_COMMANDS_TO_ARM
        if self.request_kind is RequestKind.RESET and state.plc_state is PlcState.FAULT:
            mode = Mode.RESET
        elif self.request_kind is RequestKind.ARM and state.plc_state is PlcState.LINKED and proven:
            mode = Mode.ARM
        else:
            return Mode.HEARTBEAT
        return mode if self._is_due(t_mono_ns) else Mode.HEARTBEAT

    def _is_due(self, t_mono_ns: int) -> bool:
        """Heartbeats in between: a refused ARM or RESET feeds no watchdog, and the session must outlive it."""
        due = self._t_asked_ns is None or t_mono_ns - self._t_asked_ns >= ARM_PERIOD.duration_ns
        self._t_asked_ns = t_mono_ns if due else self._t_asked_ns
        return due
