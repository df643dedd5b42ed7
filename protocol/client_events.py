"""Events that the PC's end of the link reports to its shell."""

from dataclasses import dataclass
from enum import Enum

from protocol.codes import RejectCode
from protocol.messages import State


class ClientPhase(Enum):
    """How far the connection has come, as the PC sees it."""

    OFFLINE = "offline"
    DISARMED = "disarmed"
    LINKED = "linked"
    ARMED = "armed"
    RUNNING = "running"
    STOPPING = "stopping"
    FAULT = "fault"
    LOCAL = "local"


@dataclass(frozen=True, slots=True)
class StateReceived:
    """A new state of the PLC."""

    state: State
    t_mono_ns: int


@dataclass(frozen=True, slots=True)
class DatagramDropped:
    """A datagram was not used."""

    code: RejectCode
    text: str


@dataclass(frozen=True, slots=True)
class RejectSeen:
    """The PLC says that it refused one of our datagrams."""

    code: int
    seq: int
    text: str


@dataclass(frozen=True, slots=True)
class GateRefused:
    """Our own motion gate kept a command back; a STOP was sent instead."""

    text: str


@dataclass(frozen=True, slots=True)
class TailAnswered:
    """A correction of the running trajectory was taken by the PLC, or refused: then the old tail goes on."""

    traj_id: int
    taken: bool
    text: str


@dataclass(frozen=True, slots=True)
class TrajectoryEnded:
    """The end of a trajectory, for whatever reason; exactly one per accepted request."""

    traj_id: int
    reached: bool
    reason: str
    t_plc_ns: int


@dataclass(frozen=True, slots=True)
class LinkClosed:
    """This link object is over; connect with a new one and a new session."""

    reason: str


ClientEvent = StateReceived | DatagramDropped | RejectSeen | GateRefused | TailAnswered | TrajectoryEnded | LinkClosed
