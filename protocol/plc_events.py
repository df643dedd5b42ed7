"""Events that the PLC's end of the link passes to the PLC logic."""

from collections.abc import Hashable
from dataclasses import dataclass
from enum import Enum

from protocol.codes import PlcState, RejectCode
from protocol.messages import Command
from protocol.plc_states import PlcEvent


class PlcAction(Enum):
    """What an accepted command asks the PLC logic to do."""

    KEEPALIVE = "keepalive"
    ARM = "arm"
    LOAD = "load"
    STOP = "stop"
    QUICK_STOP = "quick_stop"
    RESET = "reset"
    DISARM = "disarm"
    SERVO = "servo"


@dataclass(frozen=True, slots=True)
class CommandAccepted:
    """A command passed every rule and fed the watchdog."""

    command: Command
    effect: PlcAction


@dataclass(frozen=True, slots=True)
class CommandRejected:
    """A datagram was refused; it fed nothing and changed nothing."""

    code: RejectCode
    seq: int
    sender: Hashable
    text: str
    field_offset: int = 0  # of the field that is to blame, in the payload


@dataclass(frozen=True, slots=True)
class StateChanged:
    """The state machine moved."""

    old: PlcState
    new: PlcState
    event: PlcEvent


@dataclass(frozen=True, slots=True)
class SessionOpened:
    """A valid HELLO opened a session; states go to `sender` from now on."""

    session: int
    sender: Hashable


@dataclass(frozen=True, slots=True)
class SessionVoid:
    """The session is over; a new HELLO is needed."""

    session: int
    reason: str


PlcLinkEvent = CommandAccepted | CommandRejected | StateChanged | SessionOpened | SessionVoid
