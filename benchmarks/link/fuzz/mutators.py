"""Mutations of payloads: field by field, of knots as a whole, and of bytes that know nothing of fields. Pure."""

import struct
from collections.abc import Callable, Sequence
from random import Random

from benchmarks.link.fuzz.elements import (
    COMMAND_ELEMENTS,
    HEADER_ELEMENTS,
    KNOT_ELEMENTS,
    STATE_ELEMENTS,
    TAIL_ELEMENTS,
    Element,
    Near,
    mutated_number,
)
from protocol.layout import COMMAND_SIZE, KNOT_SIZE, KNOTS_OFFSET

_KNOT_FLOATS = struct.Struct("<24d")
_MOTION_FIELDS = ("axis_mask", "traj_id", "knot_first", "knot_count", "interp", "cmd_flags", "speed_override")
_MOTION_ELEMENTS = tuple(element for element in COMMAND_ELEMENTS if element.name in _MOTION_FIELDS)
_WITH_MEANING = tuple(element for element in (*HEADER_ELEMENTS, *COMMAND_ELEMENTS) if element.iec != "LREAL")
_SCALES = (-1.0, 0.5, 0.9, 0.999999, 1.000001, 1.01, 1.04, 1.06, 1.09, 1.11, 1.5)


def mutated_command(payload: bytes, near: Near, donors: Sequence[bytes], rng: Random) -> bytes:
    """A command with one to four mutations."""
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 4))):
        choice = rng.random()
        if choice < 0.66 and len(payload) == COMMAND_SIZE:
            payload = _with_number(payload, _command_element(payload, rng), near, rng)
        elif choice < 0.88 and len(payload) == COMMAND_SIZE:
            payload = rng.choice(_KNOT_MUTATIONS)(payload, rng)
        else:
            payload = mutated_bytes(payload, donors, rng)
    return payload


def mutated_motion(payload: bytes, near: Near, rng: Random) -> bytes:
    """A motion's command with one mutation of what makes the motion: envelope and frame stay as they are."""
    choice = rng.random()
    if choice < 0.35:
        return rng.choice(_KNOT_MUTATIONS)(payload, rng)
    elements = _MOTION_ELEMENTS if choice < 0.6 else KNOT_ELEMENTS[_any_knot(payload, rng)]
    return _with_number(payload, rng.choice(elements), near, rng)


def mutated_meaning(payload: bytes, near: Near, rng: Random) -> bytes:
    """A command that is right but for one field, which has a value that means something else at this moment."""
    element = rng.choice([e for e in _WITH_MEANING if e.name in near])
    return with_value(payload, element.offset, element.size, rng.choice(near[element.name]) % (1 << 8 * element.size))


def mutated_state(payload: bytes, near: Near, donors: Sequence[bytes], rng: Random) -> bytes:
    """A state with one to four mutations."""
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 4))):
        if rng.random() < 0.75 and len(payload) >= STATE_ELEMENTS[-1].offset + 4:
            elements = HEADER_ELEMENTS if rng.random() < 0.3 else STATE_ELEMENTS
            payload = _with_number(payload, rng.choice(elements), near, rng)
        else:
            payload = mutated_bytes(payload, donors, rng)
    return payload


def _command_element(payload: bytes, rng: Random) -> Element:
    choice = rng.random()
    if choice < 0.25:
        return rng.choice(HEADER_ELEMENTS)
    if choice < 0.65:
        return rng.choice(COMMAND_ELEMENTS)
    if choice < 0.68:
        return rng.choice(TAIL_ELEMENTS)
    return rng.choice(KNOT_ELEMENTS[_any_knot(payload, rng)])


def _any_knot(payload: bytes, rng: Random) -> int:
    """A knot in use, mostly."""
    used = min(payload[64], len(KNOT_ELEMENTS))
    return rng.randrange(used) if used and rng.random() < 0.85 else rng.randrange(len(KNOT_ELEMENTS))


def _with_number(payload: bytes, element: Element, near: Near, rng: Random) -> bytes:
    return with_value(payload, element.offset, element.size, mutated_number(payload, element, near, rng))


def with_value(payload: bytes, offset: int, size: int, value: int) -> bytes:
    """The payload with an unsigned number put in."""
    return payload[:offset] + value.to_bytes(size, "little") + payload[offset + size :]


# --- knots as a whole -------------------------------------------------------------------------------------------------


def _knot_at(k: int) -> int:
    return KNOTS_OFFSET + k * KNOT_SIZE


def _copy_knot(payload: bytes, rng: Random) -> bytes:
    source, target = _knot_at(_any_knot(payload, rng)), _knot_at(_any_knot(payload, rng))
    return payload[:target] + payload[source : source + KNOT_SIZE] + payload[target + KNOT_SIZE :]


def _swap_knots(payload: bytes, rng: Random) -> bytes:
    a, b = sorted((_knot_at(_any_knot(payload, rng)), _knot_at(_any_knot(payload, rng))))
    if a == b:
        return payload
    first, second = payload[a : a + KNOT_SIZE], payload[b : b + KNOT_SIZE]
    return payload[:a] + second + payload[a + KNOT_SIZE : b] + first + payload[b + KNOT_SIZE :]


def _empty_knot(payload: bytes, rng: Random) -> bytes:
    at = _knot_at(_any_knot(payload, rng))
    return payload[:at] + bytes(KNOT_SIZE) + payload[at + KNOT_SIZE :]


def _scale_axis(payload: bytes, rng: Random) -> bytes:
    """One axis' speeds, accelerations or both, in all knots."""
    changed, factor, axis = bytearray(payload), rng.choice(_SCALES), rng.randrange(8)
    parts = rng.choice(((1,), (2,), (1, 2)))
    for k in range(len(KNOT_ELEMENTS)):
        at = _knot_at(k) + 8
        numbers = list(_KNOT_FLOATS.unpack_from(changed, at))
        for part in parts:
            numbers[8 * part + axis] *= factor
        _KNOT_FLOATS.pack_into(changed, at, *numbers)
    return bytes(changed)


def _stretch_time(payload: bytes, rng: Random) -> bytes:
    """All knot times by a factor, or later by a step."""
    factor, step = rng.choice((0.1, 0.5, 0.999, 1.001, 1.05, 2.0, 4.0, 4.001)), rng.choice((0, 0, 1, 1_000_000))
    for k in range(len(KNOT_ELEMENTS)):
        at = _knot_at(k)
        t_ns = int.from_bytes(payload[at : at + 8], "little")
        payload = with_value(payload, at, 8, (int(t_ns * factor) + step) % (1 << 64))
    return payload


def _drop_knots(payload: bytes, rng: Random) -> bytes:
    """Fewer knots, the last of them perhaps called the end."""
    payload = with_value(payload, 64, 1, rng.randrange(7))
    return with_value(payload, 66, 2, rng.randrange(8)) if rng.random() < 0.5 else payload


_KNOT_MUTATIONS: tuple[Callable[[bytes, Random], bytes], ...] = (
    _copy_knot, _swap_knots, _empty_knot, _scale_axis, _scale_axis, _stretch_time, _drop_knots,
)  # fmt: skip


# --- bytes ------------------------------------------------------------------------------------------------------------


def mutated_bytes(data: bytes, donors: Sequence[bytes], rng: Random) -> bytes:
    """Bytes mutated without regard to what they mean: also what is a whole datagram."""
    choice = rng.randrange(7)
    if choice <= 1:
        return _flipped(data, rng)
    if choice == 2:
        at = rng.randrange(len(data) + 1)
        noise = rng.randbytes(rng.choice((1, 2, 4, 8, 32)))
        return data[:at] + noise + data[at + len(noise) :]
    if choice == 3:
        return data[: rng.randrange((len(data) if rng.random() < 0.6 else min(len(data), 30)) + 1)]
    if choice == 4:
        return data + rng.randbytes(rng.choice((1, 2, 4, 22, 200)))
    return _spliced(data, donors, rng)


def _flipped(data: bytes, rng: Random) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _spliced(data: bytes, donors: Sequence[bytes], rng: Random) -> bytes:
    """The head of one with the tail of another; mostly cut at a number's edge."""
    if not donors or not data:
        return data
    donor = rng.choice(donors)
    at = rng.randrange(min(len(data), len(donor)) + 1)
    if rng.random() < 0.7:
        at -= at % 8
    return data[:at] + donor[at:]
