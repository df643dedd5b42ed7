"""Protocol errors: the type states the side (Local, Remote), the code the cause."""

from protocol.codes import RejectCode


class ProtocolError(Exception):
    """Base of all errors of this package."""


class LocalProtocolError(ProtocolError):
    """We were asked to do what the protocol forbids: nothing was sent and nothing changed."""


class IllegalTransitionError(LocalProtocolError):
    """An event that has no place in the present state; the state is unchanged."""


class RemoteProtocolError(ProtocolError):
    """The other side's bytes break a rule; `code` and `offset` (byte of the payload, 0: not known) answer them."""

    def __init__(self, code: RejectCode, text: str, offset: int = 0) -> None:
        super().__init__(f"{code.name}: {text}")
        self.code = code
        self.text = text
        self.offset = offset


class FramingError(RemoteProtocolError):
    """The transport's frame around the payload is wrong (EAP header, publisher, variable)."""


class MalformedError(RemoteProtocolError):
    """The payload is not a message of this layout: length, magic, version, CRC, non-finite or impossible values."""


class SessionError(RemoteProtocolError):
    """A sound message that does not belong here: source, session, sequence or echo."""


class RefusedError(RemoteProtocolError):
    """A sound message of this session that asks for what is not allowed now."""
