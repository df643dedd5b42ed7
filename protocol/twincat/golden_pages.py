"""The golden conversation for people (markdown) and for other programs' tests (JSON)."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from enum import IntEnum, IntFlag

from protocol import layout
from protocol.layout import Block
from protocol.messages import Command
from protocol.twincat.golden import GoldenMessage, framed_datagram, golden_messages
from protocol.twincat.parameters import PlcParameters

_HEX = {"session", "nonce", "arm_nonce", "cfg_id"}
Wire = int | float | str | list[int] | list[float]


def golden_page(parameters: PlcParameters) -> str:
    """Every message: what it is for, its values, and its bytes."""
    head = (
        f"# Golden vectors, HMLINK {layout.VERSION_MAJOR}.{layout.VERSION_MINOR}\n\n"
        "The same messages as in `raw.pcap`, `eap.pcap` and `conversation.json`. Left out are fields that are 0,\n"
        "rows of 16 bytes that are all 0, and the 24 heartbeats between `hello` and `arm`.\n"
    )
    return "\n".join((head, *(_message_section(golden) for golden in golden_messages(parameters))))


def golden_json(parameters: PlcParameters) -> str:
    """Every message: payload and EAP datagram in hexadecimal, and each field by its wire name."""
    messages = [
        {
            "name": golden.name,
            "purpose": golden.purpose,
            "key_hex": golden.auth_key.hex(),
            "payload_hex": golden.payload.hex(),
            "eap_datagram_hex": framed_datagram(golden, parameters, eap=True).hex(),
            "fields": wire_fields(golden.payload),
        }
        for golden in golden_messages(parameters)
    ]
    return json.dumps({"layout_id": layout.LAYOUT_ID, "messages": messages}, indent=1) + "\n"


def wire_fields(payload: bytes) -> dict[str, object]:
    """What lies in a payload of the right size, by wire name: all six knots, byte arrays in hexadecimal."""
    fields: dict[str, object] = {**_unpack_block_values(layout.HEADER_LAYOUT, payload, 0)}
    if len(payload) == layout.STATE_SIZE:
        return fields | _unpack_block_values(layout.STATE_BODY_LAYOUT, payload, layout.STATE_BODY_LAYOUT.offset)
    starts = range(layout.KNOTS_OFFSET, layout.COMMAND_TAIL_LAYOUT.offset, layout.KNOT_SIZE)
    fields |= _unpack_block_values(layout.COMMAND_BODY_LAYOUT, payload, layout.COMMAND_BODY_LAYOUT.offset)
    fields["knots"] = [_unpack_block_values(layout.KNOT_LAYOUT, payload, start) for start in starts]
    return fields | _unpack_block_values(layout.COMMAND_TAIL_LAYOUT, payload, layout.COMMAND_TAIL_LAYOUT.offset)


def _unpack_block_values(block: Block, payload: bytes, offset: int) -> dict[str, Wire]:
    flat = iter(block.codec.unpack_from(payload, offset))
    values: dict[str, Wire] = {}
    for field in block.fields:
        if field.array_length == 1:
            values[field.name] = next(flat)
        elif field.iec_type == "USINT":
            values[field.name] = next(flat).hex()
        else:
            values[field.name] = [next(flat) for _ in range(field.array_length)]
    return values


def _message_section(golden: GoldenMessage) -> str:
    kind = "command" if isinstance(golden.message, Command) else "state"
    values = "\n".join(f"- {name}: {_value_text(name, value)}" for name, value in _informative_fields(golden).items())
    payload = golden.payload
    starts = [at for at in range(0, len(payload), 16) if any(payload[at : at + 16])]
    dump = "\n".join(f"{at:5d}: {payload[at : at + 16].hex(' ')}" for at in starts)
    return f"## {golden.name} ({kind}): {golden.purpose}\n\n{values}\n\n```\n{dump}\n```\n"


def _informative_fields(golden: GoldenMessage) -> Mapping[str, object]:
    return {name: value for name, value in asdict(golden.message).items() if _says_something(value)}


def _says_something(value: object) -> bool:
    return any(value) if isinstance(value, tuple | bytes) else bool(value)


def _value_text(name: str, value: object) -> object:
    if isinstance(value, IntFlag):
        return f"{int(value)} ({', '.join(str(bit.name) for bit in type(value) if bit in value)})"
    if isinstance(value, IntEnum):
        return f"{int(value)} ({value.name})"
    if isinstance(value, bytes):
        return value.hex(" ")
    return f"{value:#x}" if name in _HEX and isinstance(value, int) else value
