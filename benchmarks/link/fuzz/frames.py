"""From payload to datagram: sealing again with CRC and tag, the EAP frame around it, and mutations of that frame."""

import hashlib
import hmac
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from random import Random

from benchmarks.link.fuzz.mutators import mutated_bytes, with_value

_TAG_AT = {1304: 1280, 568: 544}
_FRAME_FIELDS = ((0, 2), (2, 4), (6, 2), (8, 2), (10, 2), (12, 1), (13, 1), (14, 2), (16, 2), (18, 2), (20, 2))


@dataclass(frozen=True, slots=True)
class Wire:
    """How one end's datagrams travel: its framing's `wrap`, whether that is EAP, and the key."""

    wrap: Callable[[bytes, int], bytes]
    eap: bool
    key: bytes


def sealed(payload: bytes, key: bytes) -> bytes:
    """The payload with tag (where its size has one and there is a key) and CRC made right again."""
    tag_at = _TAG_AT.get(len(payload))
    if key and tag_at is not None:
        flags = int.from_bytes(payload[10:12], "little") | 1
        payload = with_value(payload, 10, 2, flags)
        tag = hmac.new(key, payload[:tag_at], hashlib.sha256).digest()[:16]
        payload = payload[:tag_at] + tag + payload[tag_at + 16 :]
    return payload[:-4] + struct.pack("<I", zlib.crc32(payload[:-4])) if len(payload) >= 4 else payload


def framed(payload: bytes, wire: Wire, rng: Random) -> bytes:
    """The datagram; an EAP frame sometimes with other variables beside ours, or mutated."""
    if not wire.eap:
        return payload
    if len(payload) > 1440:
        payload = payload[:1440]  # one Ethernet frame
    datagram = wire.wrap(payload, rng.getrandbits(16))
    choice = rng.random()
    if choice < 0.80:
        return datagram
    if choice < 0.85:
        return _with_company(datagram, rng)
    if choice < 0.95:
        offset, size = rng.choice(_FRAME_FIELDS)
        value = rng.choice((0, 1, (1 << 8 * size) - 1, rng.getrandbits(8 * size)))
        return with_value(datagram, offset, size, value)
    return mutated_bytes(datagram, (), rng) if choice < 0.98 else payload  # without any frame


def _with_company(datagram: bytes, rng: Random) -> bytes:
    """Another variable before ours, counted and measured rightly: a frame as TwinCAT may send it."""
    data = rng.randbytes(rng.choice((0, 1, 8, 60)))
    other = struct.pack("<HHHH", 0x1234, 1, len(data), 0) + data
    count = int.from_bytes(datagram[8:10], "little") + 1
    word = 4 << 12 | (len(datagram) + len(other) - 2) & 0x7FF
    return with_value(with_value(datagram[:14], 0, 2, word), 8, 2, count) + other + datagram[14:]
