"""Every number with a meaning on the wire. Numbers are for ever: new ones are appended, none is reused."""

from enum import IntEnum, IntFlag


class MessageType(IntEnum):
    """Header field msg_type."""

    COMMAND = 1
    STATE = 2
    HELLO = 3
    CONFIG = 4  # reserved: refused by this version


class Mode(IntEnum):
    """Command field mode: what the PC asks for."""

    HEARTBEAT = 0
    ARM = 1
    HOLD = 2
    TRAJECTORY = 3
    SERVO = 4
    STOP = 5
    QUICK_STOP = 6
    RESET = 7
    DISARM = 8


class PlcState(IntEnum):
    """State field plc_state; transitions in protocol.plc_states."""

    BOOT = 0
    DISARMED = 1
    LINKED = 2
    HOLD = 3
    RUN = 4
    STOPPING = 5
    FAULT = 6
    LOCAL = 7


class LinkState(IntEnum):
    """State field link_state: how well the PLC hears the PC."""

    NO_SESSION = 0
    FRESH = 1
    LATE = 2
    LOST = 3


class Interp(IntEnum):
    """How the PLC interpolates between knots (command field interp); NONE only where there are none."""

    NONE = 0
    LINEAR = 1
    CUBIC = 2
    QUINTIC = 3


class CommandFlag(IntFlag):
    """Command field cmd_flags."""

    LAST_IS_END = 1
    START = 2
    TAIL_REPLACES = 4


class HeaderFlag(IntFlag):
    """Header field flags."""

    AUTH = 1
    SIMULATION = 2
    DRY_RUN = 4


class RejectCode(IntEnum):
    """State field reject_code: why the last refused datagram was refused."""

    NONE = 0
    EAP_HEADER = 1
    LENGTH = 2
    MAGIC = 3
    VERSION = 4
    LAYOUT = 5
    CRC = 6
    AUTH = 7
    NOT_FINITE = 8
    MSG_TYPE = 9
    VALUE = 10
    SOURCE = 11
    SESSION = 12
    SEQ_JUMP = 13
    ECHO_STALE = 14
    MODE_ILLEGAL = 15
    NONCE = 16
    CFG = 17
    ENABLE = 18
    LINK_NOT_PROVEN = 19
    FAULT_PRESENT = 20
    LAG = 21
    LIMIT_Q = 30
    LIMIT_QD = 31
    LIMIT_QDD = 32
    KNOT_SPACING = 33
    START = 34
    CONTINUITY = 35
    END_NOT_AT_REST = 36
    IMPLIED_SPEED = 37
    KNOT_CHANGED = 38
    RING_FULL = 39
    KNOT_GAP = 40
    TRAJ_ID = 41
    INTERP = 42
    AXIS_MASK = 43
    OVERRIDE = 44


class FaultBit(IntFlag):
    """State field fault_bits: latched until RESET."""

    ESTOP = 1 << 0
    LOCAL_ENABLE_LOST = 1 << 1
    LAG = 1 << 2
    JOINT_RANGE = 1 << 3
    SENSOR = 1 << 4
    PRESSURE = 1 << 5
    OIL_TEMPERATURE = 1 << 6
    CYCLE_OVERRUN = 1 << 7
    LAYOUT = 1 << 8


class WarnBit(IntFlag):
    """State field warn_bits: not latched."""

    LINK_LATE = 1 << 0
    LINK_LOST = 1 << 1
    UNDERRUN = 1 << 2
    OVERRIDE_CLAMPED = 1 << 3
    NEWER_MINOR = 1 << 4
    PRESSURE = 1 << 5
    OIL_TEMPERATURE = 1 << 6
    LAG = 1 << 7


class AxisBit(IntFlag):
    """State field axis_status, one word per axis."""

    IN_USE = 1 << 0
    AT_Q_MIN = 1 << 1
    AT_Q_MAX = 1 << 2
    VALVE_SATURATED = 1 << 3
    ENCODER_FAULT = 1 << 4
    LAG = 1 << 5


_REJECT_TEXTS = {
    RejectCode.NONE: "nothing refused",
    RejectCode.EAP_HEADER: "EAP frame, publisher, variable id, version or length wrong; check both EAP configurations",
    RejectCode.LENGTH: "payload length wrong; both ends must use the same message version",
    RejectCode.MAGIC: "not a datagram of this link; check the ports",
    RejectCode.VERSION: "major version differs; update the older end",
    RejectCode.LAYOUT: "message layout differs; regenerate the PLC's structures from this version",
    RejectCode.CRC: "checksum wrong: the datagram was damaged or only partly copied",
    RejectCode.AUTH: "authentication tag wrong; check the key on both ends",
    RejectCode.NOT_FINITE: "a number is NaN or infinite",
    RejectCode.MSG_TYPE: "message type not known here",
    RejectCode.VALUE: "a field has a value outside its enumeration",
    RejectCode.SOURCE: "sent from another address than the session was opened from",
    RejectCode.SESSION: "another session is open; wait 1 s after the other PC has stopped sending, or stop it",
    RejectCode.SEQ_JUMP: "sequence number jumped by more than 1000; open a new session",
    RejectCode.ECHO_STALE: "the PC does not see fresh PLC states (older than 250 ms); check the way from PLC to PC",
    RejectCode.MODE_ILLEGAL: "mode not allowed in the present PLC state",
    RejectCode.NONCE: "arm nonce out of date; arm again",
    RejectCode.CFG: "limits or calibration differ between PC and PLC; load the same machine file on both ends",
    RejectCode.ENABLE: "local enable missing; press enable at the machine",
    RejectCode.LINK_NOT_PROVEN: "fewer than 25 good commands so far; wait",
    RejectCode.FAULT_PRESENT: "a fault is present; remove its cause, then reset",
    RejectCode.LAG: "joints are too far from their reference",
    RejectCode.LIMIT_Q: "a knot leaves the joint range",
    RejectCode.LIMIT_QD: "a knot is faster than the joint's limit",
    RejectCode.LIMIT_QDD: "a knot accelerates beyond the joint's limit",
    RejectCode.KNOT_SPACING: "knots are closer than 5 ms or further apart than 200 ms",
    RejectCode.START: "the first knot is not the present reference at rest; plan from q_ref",
    RejectCode.CONTINUITY: "knots do not join those already sent",
    RejectCode.END_NOT_AT_REST: "the last knot is not at rest",
    RejectCode.IMPLIED_SPEED: "the step between two knots needs more speed than the joint's limit",
    RejectCode.KNOT_CHANGED: "a knot was sent again with other values",
    RejectCode.RING_FULL: "knots do not fit into the ring of 64",
    RejectCode.KNOT_GAP: "knots begin beyond the end of those already there",
    RejectCode.TRAJ_ID: "trajectory number is not newer than the last one",
    RejectCode.INTERP: "interpolation kind not supported",
    RejectCode.AXIS_MASK: "axis mask does not match the machine's axes",
    RejectCode.OVERRIDE: "speed override outside 0..1",
}


def reject_text(code: int) -> str:
    """Name, meaning and remedy of a reject code; a number this version does not know is shown as such."""
    try:
        known = RejectCode(code)
    except ValueError:
        return f"reject code {code}: not known to this version; update the PC"
    return f"{known.name}: {_REJECT_TEXTS[known]}"


def rejects_markdown() -> str:
    """All reject codes as a documentation table."""
    rows = [f"| {int(code)} | {code.name} | {text} |" for code, text in _REJECT_TEXTS.items()]
    return "\n".join(["| Code | Name | Meaning and remedy |", "|---|---|---|", *rows])
