"""Recently sent commands, so that a refusal can be shown with the field's name and value."""

from collections import OrderedDict
from dataclasses import dataclass, field

from protocol.codes import RejectCode, reject_text
from protocol.layout import command_field_text
from protocol.messages import State

_KEPT = 128  # two and a half seconds of commands


@dataclass(slots=True)
class SentCommands:
    """Payloads by sequence number, the newest 128."""

    _payloads: OrderedDict[int, bytes] = field(default_factory=OrderedDict)

    def note(self, seq: int, payload: bytes) -> None:
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
