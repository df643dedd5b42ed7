"""Alarms of the panel, faults over REST by reference, reject codes and fault bits of the PLC."""

from longreach.reference.markdown import code, table
from protocol.codes import FaultBit, RejectCode, reject_text
from server.api.panel_alarm_catalogue import CATALOGUE


def alarms() -> str:
    """Every alarm; each has a page of its own in docs/alarms/."""
    rows = [(code(alarm.code), alarm.level, alarm.title, alarm.remedy) for alarm in CATALOGUE.values()]
    return table(("code", "level", "what", "what to do"), rows)


def rejects() -> str:
    """Every reject code of the protocol."""
    rows = [(str(reject.value), code(reject.name), reject_text(reject).partition(": ")[2]) for reject in RejectCode]
    return table(("number", "code", "why"), rows)


def fault_bits() -> str:
    """Every latched fault of the PLC."""
    return table(("bit", "fault"), [(str(bit.value.bit_length() - 1), code(str(bit.name))) for bit in FaultBit])
