"""Every number of a message as a target for mutation, from the schema, with the values at which code tends to break."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from random import Random

from protocol.layout import (
    COMMAND_BODY_LAYOUT,
    COMMAND_TAIL_LAYOUT,
    HEADER_LAYOUT,
    KNOT_LAYOUT,
    KNOT_SIZE,
    KNOTS_OFFSET,
    KNOTS_PER_COMMAND,
    STATE_BODY_LAYOUT,
    Field,
)

Near = Mapping[str, Sequence[int]]  # values that mean something now, by field: the session, the newest sequence, ...
_SIZES = {"USINT": 1, "UINT": 2, "UDINT": 4, "ULINT": 8, "REAL": 4, "LREAL": 8}
_SMALL = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9)
_LREALS = (
    0x7FF8_0000_0000_0000, 0x7FF0_0000_0000_0001, 0xFFF8_DEAD_BEEF_0001, 0x7FFF_FFFF_FFFF_FFFF,  # NaN with payloads
    0x7FF0_0000_0000_0000, 0xFFF0_0000_0000_0000,  # infinities
    0x7FEF_FFFF_FFFF_FFFF, 0xFFEF_FFFF_FFFF_FFFF,  # largest finite
    0x0000_0000_0000_0001, 0x800F_FFFF_FFFF_FFFF, 0x0010_0000_0000_0000,  # denormals, smallest normal
    0x0000_0000_0000_0000, 0x8000_0000_0000_0000, 0x3FF0_0000_0000_0000, 0x3FF0_0000_0000_0001,  # 0, -0, 1, 1 + eps
)  # fmt: skip
_REALS = (0x7FC0_0000, 0x7F80_0001, 0xFFFF_FFFF, 0x7F80_0000, 0xFF80_0000, 0x7F7F_FFFF, 1, 0x8000_0000, 0x3F80_0000)
_FACTORS = (-1.0, 0.0, 0.5, 0.99, 1.0 - 1e-9, 1.0 + 1e-9, 1.000001, 1.01, 1.02, 1.05, 1.06, 1.1, 1.11, 2.0, 1e6)


@dataclass(frozen=True, slots=True)
class Element:
    """One number: a field, or one place of an array."""

    name: str
    offset: int
    iec: str

    @property
    def size(self) -> int:
        """Bytes on the wire."""
        return _SIZES[self.iec]


def _elements(fields: Sequence[Field], base: int = 0) -> tuple[Element, ...]:
    return tuple(
        Element(field.name, base + field.offset + i * (field.size // field.array_length), field.iec_type)
        for field in fields
        for i in range(field.array_length)
    )


HEADER_ELEMENTS = _elements(HEADER_LAYOUT.fields)
COMMAND_ELEMENTS = _elements(COMMAND_BODY_LAYOUT.fields)
TAIL_ELEMENTS = _elements(COMMAND_TAIL_LAYOUT.fields)
KNOT_ELEMENTS = tuple(_elements(KNOT_LAYOUT.fields, KNOTS_OFFSET + k * KNOT_SIZE) for k in range(KNOTS_PER_COMMAND))
STATE_ELEMENTS = _elements(STATE_BODY_LAYOUT.fields)


def mutated_number(payload: bytes, element: Element, near: Near, rng: Random) -> int:
    """Another value for an element, as the unsigned number of its bytes."""
    old = int.from_bytes(payload[element.offset : element.offset + element.size], "little")
    bits = 8 * element.size
    if element.iec in ("LREAL", "REAL"):
        return _mutated_float(old, element, rng)
    at_hand = near.get(element.name)
    if at_hand and rng.random() < 0.6:
        return rng.choice(at_hand) % (1 << bits)
    top = (1 << bits) - 1
    choice = rng.randrange(5)
    if choice == 0:
        return rng.choice(_SMALL)
    if choice == 1:
        return rng.choice((top, top - 1, top >> 1, (top >> 1) + 1))
    if choice == 2:
        return (old + rng.choice((-1001, -1000, -2, -1, 1, 2, 999, 1000, 1001))) % (1 << bits)
    return old ^ (1 << rng.randrange(bits)) if choice == 3 else rng.getrandbits(bits)


def _mutated_float(old: int, element: Element, rng: Random) -> int:
    wide = element.iec == "LREAL"
    choice = rng.random()
    if choice < 0.25:
        return rng.choice(_LREALS if wide else _REALS)
    if choice < 0.35:
        return rng.getrandbits(8 * element.size)
    if choice < 0.5:
        return (old + rng.choice((-1, 1))) % (1 << 8 * element.size)  # the next number up or down
    format_ = "<d" if wide else "<f"
    value = struct.unpack(format_, old.to_bytes(element.size, "little"))[0]
    value = value * rng.choice(_FACTORS) if choice < 0.8 else value + rng.choice((-1, 1)) * 10.0 ** rng.randint(-9, 2)
    try:
        return int.from_bytes(struct.pack(format_, value), "little")
    except OverflowError:  # past the largest REAL
        return rng.choice(_REALS)
