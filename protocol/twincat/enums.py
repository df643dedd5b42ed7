"""Enumerations of the wire and of the program's inside, from the code tables."""

from collections.abc import Iterable
from enum import Enum, IntEnum

from protocol import codes
from protocol.plc_events import Effect
from protocol.plc_states import PlcEvent
from protocol.twincat.dut import Dut

_WIRE: tuple[tuple[str, str, type[IntEnum]], ...] = (
    ("E_HmMsgType", "USINT", codes.MessageType),
    ("E_HmMode", "UINT", codes.Mode),
    ("E_HmPlcState", "USINT", codes.PlcState),
    ("E_HmLinkState", "USINT", codes.LinkState),
    ("E_HmInterp", "USINT", codes.Interp),
)
_MOTIONS = ("FOLLOW", "HOLD", "PLAY", "PATH_STOP", "JOINT_STOP", "SERVO")


def enums() -> tuple[Dut, ...]:
    """All enumerations."""
    rejects = [(code.name, int(code), codes.reject_text(code).partition(": ")[2]) for code in codes.RejectCode]
    return (
        *(_enum(name, base, [(member.name, int(member), "") for member in kind]) for name, base, kind in _WIRE),
        _enum("E_HmReject", "UINT", rejects),
        _enum("E_HmEvent", "USINT", _counted(PlcEvent)),
        _enum("E_HmEffect", "USINT", _counted(Effect)),
        _enum("E_HmMotion", "USINT", [(name, i, "") for i, name in enumerate(_MOTIONS)]),
    )


def _counted(kind: Iterable[Enum]) -> list[tuple[str, int, str]]:
    return [(member.name, i, str(member.value)) for i, member in enumerate(kind)]


def _enum(name: str, base: str, members: list[tuple[str, int, str]]) -> Dut:
    rows = []
    for i, (member, number, remark) in enumerate(members):
        comma = "," if i + 1 < len(members) else ""
        rows.append(f"    {member} := {number}{comma}{f' // {remark}' if remark else ''}")
    body = "\n".join(rows)
    text = f"{{attribute 'qualified_only'}}\n{{attribute 'strict'}}\nTYPE {name} :\n(\n{body}\n) {base};\nEND_TYPE\n"
    return Dut(name, text)
