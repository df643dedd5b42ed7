"""Framing of a payload: raw, or a process-data frame of the EtherCAT Automation Protocol (EAP)."""

import struct
from dataclasses import dataclass
from typing import Protocol

from protocol.codes import RejectCode
from protocol.errors import FramingError, LocalProtocolError
from protocol.layout import LAYOUT_ID

EAP_PORT = 34980
EAP_COMMAND_VARIABLE_ID = 0x4801
EAP_STATE_VARIABLE_ID = 0x4802
EAP_OVERHEAD_BYTES = 22
_EAP_MAX_DATA = 1450  # one Ethernet frame
_TYPE_NV = 4
_FRAME = struct.Struct("<H6sHHBB")  # length and type, publisher, count, cycle index, reserved, EAP SM
_VARIABLE = struct.Struct("<HHHH")  # id, hash ("version" in TwinCAT 3), length, quality


class Framing(Protocol):
    """How payloads travel in datagrams."""

    def wrap(self, payload: bytes, seq: int) -> bytes:
        """The datagram around a payload."""
        ...

    def unwrap(self, datagram: bytes) -> bytes:
        """The payload in a datagram; raises FramingError."""
        ...


@dataclass(frozen=True, slots=True)
class RawFraming:
    """The payload is the datagram."""

    def wrap(self, payload: bytes, seq: int) -> bytes:
        """The payload itself; the sequence number is inside it."""
        del seq
        return payload

    def unwrap(self, datagram: bytes) -> bytes:
        """The datagram itself."""
        return datagram


def parse_net_id(text: str) -> bytes:
    """The 6 bytes of an AMS NetId such as '192.168.0.10.1.1', in written order.

    Raises: LocalProtocolError: not six numbers 0..255.
    """
    parts = text.split(".")
    if len(parts) != 6 or not all(p.isascii() and p.isdigit() and int(p) <= 255 for p in parts):
        raise LocalProtocolError(
            f"AMS NetId '{text}': must be six numbers 0..255 joined by dots, such as 192.168.0.10.1.1"
        )
    return bytes(int(p) for p in parts)


def wrap_eap(data: bytes, publisher: bytes, variable_id: int, version: int, cycle_index: int) -> bytes:
    """One variable in one EAP process-data frame (all fields explicit; EAP SM and quality are 0)."""
    if len(data) > _EAP_MAX_DATA:
        raise LocalProtocolError(f"EAP variable of {len(data)} bytes, one Ethernet frame carries {_EAP_MAX_DATA}")
    word = (_FRAME.size - 2 + _VARIABLE.size + len(data)) | _TYPE_NV << 12
    frame = _FRAME.pack(word, publisher, 1, cycle_index & 0xFFFF, 0, 0)
    return frame + _VARIABLE.pack(variable_id, version, len(data), 0) + data


def unwrap_eap(datagram: bytes, publisher: bytes, variable_id: int, version: int) -> bytes:
    """The data of one variable; other variables in the same frame are passed over.

    Raises: FramingError: any field of the frame that is not what it must be.
    """
    if len(datagram) < _FRAME.size:
        raise FramingError(RejectCode.EAP_HEADER, f"{len(datagram)} bytes are no EAP frame (at least {_FRAME.size})")
    word, sender, count, _, _, _ = _FRAME.unpack_from(datagram)
    if word >> 12 != _TYPE_NV or word & 0x07FF != len(datagram) - 2:
        raise FramingError(
            RejectCode.EAP_HEADER, f"frame word {word:#06x} for {len(datagram)} bytes: type 4 and length expected"
        )
    if sender != publisher:
        raise FramingError(RejectCode.EAP_HEADER, f"publisher {'.'.join(map(str, sender))} is not the configured one")
    offset = _FRAME.size
    for _ in range(count):
        if offset + _VARIABLE.size > len(datagram):
            break
        found, its_version, length, _ = _VARIABLE.unpack_from(datagram, offset)
        offset += _VARIABLE.size
        if found == variable_id:
            return _variable_data(datagram, offset, length, its_version, version)
        offset += length
    raise FramingError(RejectCode.EAP_HEADER, f"variable {variable_id:#06x} is not among the frame's {count}")


def _variable_data(datagram: bytes, offset: int, length: int, its_version: int, version: int) -> bytes:
    if its_version != version:
        raise FramingError(RejectCode.EAP_HEADER, f"variable version {its_version:#06x}, must be {version:#06x}")
    if offset + length > len(datagram):
        raise FramingError(RejectCode.EAP_HEADER, f"variable of {length} bytes runs over the end of the frame")
    return datagram[offset : offset + length]


@dataclass(frozen=True, slots=True)
class EapFraming:
    """Beckhoff's own datagram: we publish `own_id`, and subscribe to `peer_id` of one publisher. NetIds are 6 bytes."""

    own_publisher: bytes
    peer_publisher: bytes
    own_id: int
    peer_id: int
    version: int = LAYOUT_ID & 0xFFFF

    @classmethod
    def for_client(cls, pc_net_id: str, plc_net_id: str) -> "EapFraming":
        """The PC's end: publishes commands, takes states."""
        return cls(parse_net_id(pc_net_id), parse_net_id(plc_net_id), EAP_COMMAND_VARIABLE_ID, EAP_STATE_VARIABLE_ID)

    @classmethod
    def for_plc(cls, pc_net_id: str, plc_net_id: str) -> "EapFraming":
        """The PLC's end: publishes states, takes commands."""
        return cls(parse_net_id(plc_net_id), parse_net_id(pc_net_id), EAP_STATE_VARIABLE_ID, EAP_COMMAND_VARIABLE_ID)

    def wrap(self, payload: bytes, seq: int) -> bytes:
        """The frame around a payload; its cycle index is the low 16 bits of the sequence number."""
        return wrap_eap(payload, self.own_publisher, self.own_id, self.version, seq)

    def unwrap(self, datagram: bytes) -> bytes:
        """The payload of the variable we subscribe to; raises FramingError."""
        return unwrap_eap(datagram, self.peer_publisher, self.peer_id, self.version)
