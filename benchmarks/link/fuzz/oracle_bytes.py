"""Receive rules 1 and 2 judged on the bytes: offsets and values as docs/plc-link.md lists them, no codec of ours."""

import hashlib
import hmac
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.link.fuzz.verdict import Breach
from protocol.codes import RejectCode

_LAYOUT_ID = 0xAE60A802
_EAP_TYPE = 4
_EXPONENT = 0x7FF0_0000_0000_0000
_EXPONENT_REAL = 0x7F80_0000
_COMMAND_WORDS = struct.Struct("<151Q")  # speed_override, then six knots of one ULINT and 24 LREAL
_COMMAND_FLOATS = tuple(i for i in range(151) if i == 0 or (i - 1) % 25)
_STATE_WORDS = struct.Struct("<32Q24I")  # q, qd, q_ref, qd_ref; then valve_cmd, p_a, p_b
_STATE_LAST = struct.Struct("<4I")  # p_supply, p_tank, t_oil, speed_scale


@dataclass(frozen=True, slots=True)
class Subscription:
    """What an EAP receiver listens to."""

    publisher: bytes
    variable: int
    version: int = _LAYOUT_ID & 0xFFFF


def number(data: bytes, offset: int, size: int) -> int:
    """An unsigned number, little endian."""
    return int.from_bytes(data[offset : offset + size], "little")


def unframed(datagram: bytes, eap: Subscription | None) -> bytes | Breach:
    """The payload, or what is wrong with the frame around it."""
    if eap is None:
        return datagram
    wrong = Breach(RejectCode.EAP_HEADER, 0)
    if len(datagram) < 14:
        return wrong
    word = number(datagram, 0, 2)
    if word >> 12 != _EAP_TYPE or word & 0x7FF != len(datagram) - 2 or datagram[2:8] != eap.publisher:
        return wrong
    at = 14
    for _ in range(number(datagram, 8, 2)):
        if at + 8 > len(datagram):
            return wrong
        size = number(datagram, at + 4, 2)
        if number(datagram, at, 2) == eap.variable:
            fits = at + 8 + size <= len(datagram)
            return datagram[at + 8 : at + 8 + size] if fits and number(datagram, at + 2, 2) == eap.version else wrong
        at += 8 + size
    return wrong


def _envelope(payload: bytes, size: int, magic: int, types: Sequence[int], tag_at: int, key: bytes) -> Breach | None:
    if len(payload) != size:
        return Breach(RejectCode.LENGTH, 0)
    expected = (
        (0, 4, magic, RejectCode.MAGIC),
        (4, 1, 1, RejectCode.VERSION),
        (12, 4, _LAYOUT_ID, RejectCode.LAYOUT),
        (8, 2, size, RejectCode.LENGTH),
        (7, 1, 32, RejectCode.LENGTH),
        (size - 4, 4, zlib.crc32(payload[: size - 4]), RejectCode.CRC),
    )
    for offset, width, value, code in expected:
        if number(payload, offset, width) != value:
            return Breach(code, offset)
    if key:
        tag = hmac.new(key, payload[:tag_at], hashlib.sha256).digest()[:16]
        if not number(payload, 10, 2) & 1 or payload[tag_at : tag_at + 16] != tag:
            return Breach(RejectCode.AUTH, tag_at)
    return None if payload[6] in types else Breach(RejectCode.MSG_TYPE, 6)


def command_breach(payload: bytes, key: bytes) -> Breach | None:
    """The first thing wrong with a command or HELLO by itself."""
    breach = _envelope(payload, 1304, 0x31434D48, (1, 3), 1280, key)
    if breach is not None:
        return breach
    words = _COMMAND_WORDS.unpack_from(payload, 72)
    for i in _COMMAND_FLOATS:
        if words[i] & _EXPONENT == _EXPONENT:
            return Breach(RejectCode.NOT_FINITE, 72 + 8 * i)
    for offset, width, most in ((64, 1, 6), (48, 2, 8), (65, 1, 3)):
        if number(payload, offset, width) > most:
            return Breach(RejectCode.VALUE, offset)
    return None


def state_breach(payload: bytes, key: bytes) -> Breach | None:
    """The first thing wrong with a state by itself."""
    breach = _envelope(payload, 568, 0x31534D48, (2,), 544, key)
    if breach is not None:
        return breach
    words = _STATE_WORDS.unpack_from(payload, 144)
    for i, word in enumerate(words):
        mask = _EXPONENT if i < 32 else _EXPONENT_REAL
        if word & mask == mask:
            return Breach(RejectCode.NOT_FINITE, 144 + 8 * i if i < 32 else 400 + 4 * (i - 32))
    for i, word in enumerate(_STATE_LAST.unpack_from(payload, 528)):
        if word & _EXPONENT_REAL == _EXPONENT_REAL:
            return Breach(RejectCode.NOT_FINITE, 528 + 4 * i)
    for offset, width, most in ((58, 1, 7), (59, 1, 3), (60, 2, 8)):
        if number(payload, offset, width) > most:
            return Breach(RejectCode.VALUE, offset)
    return None
