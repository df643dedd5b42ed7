"""Datagrams made wrong on purpose: a field changed, CRC and tag made right again, so that the rule meant is met."""

import hashlib
import hmac
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from protocol import layout
from protocol.codes import HeaderFlag

COMMAND_TAG = 1280
STATE_TAG = 544
NOT_FINITE = (float("nan"), float("inf"), float("-inf"))
_PATCH = {"UINT": "<H", "UDINT": "<I", "ULINT": "<Q", "USINT": "<B", "LREAL": "<d"}
_FIELDS = {
    f.name: f
    for block in (layout.HEADER_LAYOUT, layout.COMMAND_BODY_LAYOUT, layout.COMMAND_TAIL_LAYOUT)
    for f in block.fields
}
_KNOT_FIELDS = {f.name: f for f in layout.KNOT_LAYOUT.fields}


def sealed(payload: bytes, key: bytes = b"") -> bytes:
    """Tag (with a key) and CRC of a command of the right size made right; written apart from the codec."""
    body = bytearray(payload)
    if key:
        body[10] |= HeaderFlag.AUTH
        body[COMMAND_TAG : COMMAND_TAG + 16] = hmac.new(key, bytes(body[:COMMAND_TAG]), hashlib.sha256).digest()[:16]
    body[-4:] = struct.pack("<I", zlib.crc32(bytes(body[:-4])))
    return bytes(body)


def patched(payload: bytes, field: str, value: float) -> bytes:
    """One field of header, body or tail set; nothing made right."""
    found = _FIELDS[field]
    body = bytearray(payload)
    struct.pack_into(_PATCH[found.iec_type], body, found.offset, value)
    return bytes(body)


def knot_patched(payload: bytes, k: int, field: str, value: float, axis: int = 0) -> bytes:
    """One number of the k-th knot set."""
    found = _KNOT_FIELDS[field]
    body = bytearray(payload)
    at = layout.KNOTS_OFFSET + k * layout.KNOT_SIZE + found.offset + 8 * axis
    struct.pack_into(_PATCH[found.iec_type], body, at, value)
    return bytes(body)


def field_of(payload: bytes, field: str) -> int | float:
    """One field of header, body or tail."""
    found = _FIELDS[field]
    return struct.unpack_from(_PATCH[found.iec_type], payload, found.offset)[0]


def knot_field_of(payload: bytes, k: int, field: str, axis: int = 0) -> int | float:
    """One number of the k-th knot."""
    found = _KNOT_FIELDS[field]
    at = layout.KNOTS_OFFSET + k * layout.KNOT_SIZE + found.offset + 8 * axis
    return struct.unpack_from(_PATCH[found.iec_type], payload, at)[0]


@dataclass(frozen=True, slots=True)
class Fault:
    """A kind of wrong datagram: `spoil` changes the bytes; `seal`: the CRC (and tag) is then made right."""

    name: str
    spoil: Callable[[bytes, np.random.Generator], bytes]
    seal: bool = True


def _set(field: str, *values: int | float) -> Callable[[bytes, np.random.Generator], bytes]:
    return lambda payload, rng: patched(payload, field, values[int(rng.integers(len(values)))])


def _add(field: str, *steps: int) -> Callable[[bytes, np.random.Generator], bytes]:
    def spoil(payload: bytes, rng: np.random.Generator) -> bytes:
        value = int(field_of(payload, field)) + steps[int(rng.integers(len(steps)))]
        return patched(payload, field, value % 2 ** (8 * _FIELDS[field].size))

    return spoil


def _some_knot(payload: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(max(min(int(field_of(payload, "knot_count")), layout.KNOTS_PER_COMMAND), 1)))


def _set_knot(
    field: str, *values: float, axes: tuple[int, int] = (0, 6)
) -> Callable[[bytes, np.random.Generator], bytes]:
    def spoil(payload: bytes, rng: np.random.Generator) -> bytes:
        value = values[int(rng.integers(len(values)))]
        return knot_patched(payload, _some_knot(payload, rng), field, value, int(rng.integers(*axes)))

    return spoil


def _shift_knot(field: str, *steps: float) -> Callable[[bytes, np.random.Generator], bytes]:
    def spoil(payload: bytes, rng: np.random.Generator) -> bytes:
        k, axis = _some_knot(payload, rng), int(rng.integers(6))
        value = knot_field_of(payload, k, field, axis) + steps[int(rng.integers(len(steps)))]
        return knot_patched(payload, k, field, value, axis)

    return spoil


def _shift_time(payload: bytes, rng: np.random.Generator) -> bytes:
    k = _some_knot(payload, rng)
    value = int(knot_field_of(payload, k, "t_ns")) + int(rng.choice([-60, -46, 1, 151, 400])) * 1_000_000
    return knot_patched(payload, k, "t_ns", value % 2**64)


def _end_moves(payload: bytes, rng: np.random.Generator) -> bytes:
    k = max(min(int(field_of(payload, "knot_count")), layout.KNOTS_PER_COMMAND), 1) - 1
    spoilt = knot_patched(payload, k, str(rng.choice(["qd", "qdd"])), 1e-5, int(rng.integers(6)))
    return patched(spoilt, "cmd_flags", 3)


def _not_finite_knot(payload: bytes, rng: np.random.Generator) -> bytes:
    field = str(rng.choice(["q", "qd", "qdd"]))
    return knot_patched(payload, int(rng.integers(6)), field, NOT_FINITE[int(rng.integers(3))], int(rng.integers(8)))


def _flip(payload: bytes, rng: np.random.Generator) -> bytes:
    body = bytearray(payload)
    for _ in range(int(rng.integers(1, 4))):
        body[int(rng.integers(len(body)))] ^= 1 << int(rng.integers(8))
    return bytes(body)


def _wrong_tag(payload: bytes, rng: np.random.Generator) -> bytes:
    return sealed(patched(payload, "flags", HeaderFlag.AUTH)[:1290] + rng.bytes(6) + payload[1296:])


def _random_words(payload: bytes, rng: np.random.Generator) -> bytes:
    """Sound up to the CRC, then anything: the fields that a rule looks at are as likely as the others."""
    body = bytearray(payload)
    for _ in range(int(rng.integers(1, 5))):
        at = int(rng.choice([16, 20, 24, 32, 36, 40, 48, 52, 56, 60, 64, 68, 72, 80 + 4 * int(rng.integers(300))]))
        body[at : at + 4] = rng.bytes(4)
    return bytes(body)


FAULTS = (
    Fault("bit flip", _flip, seal=False),
    Fault("truncated", lambda payload, rng: payload[: int(rng.integers(len(payload)))], seal=False),
    Fault("over-long", lambda payload, rng: payload + rng.bytes(int(rng.integers(1, 90))), seal=False),
    Fault("noise", lambda payload, rng: rng.bytes(int(rng.choice([0, 1, 31, 568, 1304, 1400]))), seal=False),
    Fault("wrong tag", _wrong_tag, seal=False),
    Fault("not signed", lambda payload, rng: sealed(patched(payload, "flags", 0)), seal=False),
    Fault("magic", _set("magic", 0, 0x31534D48, 0x31434D49)),
    Fault("other major", _set("ver_major", 0, 2, 255)),
    Fault("newer minor", _set("ver_minor", 2, 200)),
    Fault("older minor", _set("ver_minor", 0)),
    Fault("layout", _add("layout_id", 1, -1)),
    Fault("payload_len", _set("payload_len", 0, 568, 1303)),
    Fault("hdr_len", _set("hdr_len", 0, 31, 33)),
    Fault("msg_type", _set("msg_type", 0, 2, 4, 255)),
    Fault("NaN override", _set("speed_override", *NOT_FINITE)),
    Fault("NaN in a knot", _not_finite_knot),
    Fault("mode number", _set("mode", 9, 256, 65535)),
    Fault("interp number", _set("interp", 4, 255)),
    Fault("too many knots", _set("knot_count", 7, 255)),
    Fault("other session", _add("session", 1, -1)),
    Fault("session 0", _set("session", 0)),
    Fault("sequence jump", _add("seq", 1001, -1001, 2**31)),
    Fault("sequence gap", _add("seq", 1, 7, 999)),
    Fault("old sequence", _add("seq", -1, -2, -1000)),
    Fault("frozen echo", _add("t_plc_echo_ns", -251_000_000)),
    Fault("echo of the future", _add("t_plc_echo_ns", 1_000_000_000)),
    Fault("never saw a state", _set("ack_plc_seq", 0)),
    Fault("cfg", _add("cfg_id", 1)),
    Fault("nonce", _add("arm_nonce", 1)),
    Fault("other mode", _set("mode", *range(9))),
    Fault("traj_id", _set("traj_id", 0, 1)),
    Fault("next traj_id", _add("traj_id", 1)),
    Fault("axis_mask", _set("axis_mask", 0, 0x1F, 0xFF, 0xFFFF)),
    Fault("override", _set("speed_override", -1e-9, 1.0000001, 5.0)),
    Fault("slower", _set("speed_override", 0.0, 0.3, 0.7)),
    Fault("interp", _set("interp", 0, 1, 2, 3)),
    Fault("knot_count", _set("knot_count", 0, 1, 2, 3)),
    Fault("knot_first", _add("knot_first", 1, -1, 6, 70, 2**31)),
    Fault("flags", _set("cmd_flags", 0, 1, 2, 3, 4, 5, 6, 7, 0xFFFF)),
    Fault("timeout", _set("timeout_us", 1, 120_000, 2**32 - 1)),
    Fault("knot q far", _set_knot("q", -9.0, 9.0, 1e300)),
    Fault("knot q off", _shift_knot("q", -1e-3, 2e-5, 0.3)),
    Fault("knot qd", _set_knot("qd", 5.0, -5.0, 1e-3)),
    Fault("knot qdd", _set_knot("qdd", 90.0, -90.0, 1e-3)),
    Fault("knot unused axis", _set_knot("q", 1e-12, axes=(6, 8))),
    Fault("knot qd off", _shift_knot("qd", -0.05, 0.05)),
    Fault("knot time", _shift_time),
    Fault("end moves", _end_moves),
    Fault("random words", _random_words),
)
