"""Bytes to messages and back. Non-finite numbers are refused both ways; bad bytes are a MalformedError."""

import math
import struct
import zlib
from itertools import chain
from typing import Any

from protocol import layout
from protocol.authentication import AUTH_TAG_BYTES, is_authentic, tag_of
from protocol.codes import CommandFlag, HeaderFlag, Interp, LinkState, MessageType, Mode, PlcState, RejectCode
from protocol.errors import LocalProtocolError, MalformedError
from protocol.layout import Block
from protocol.messages import Command, Knot, State

_CRC = struct.Struct("<I")
_HEADER_ONLY = {"magic", "ver_major", "msg_type", "hdr_len", "payload_len", "layout_id", "reserved", "crc"}
_STATE_FIELDS = tuple(f.name for f in layout.STATE_BODY_LAYOUT.fields if f.name not in _HEADER_ONLY)
_SIGNED_END = {
    layout.COMMAND_SIZE: layout.COMMAND_TAIL_LAYOUT.offset,
    layout.STATE_SIZE: layout.STATE_BODY_LAYOUT.offset_of("auth_tag"),
}
_HEADER_AT = {field.name: field.offset for field in layout.HEADER_LAYOUT.fields}
_BODY_AT = {field.name: field.offset for field in layout.COMMAND_BODY_LAYOUT.fields}
_STATE_AT = {field.name: field.offset for field in layout.STATE_BODY_LAYOUT.fields}
_FLAGS_AT = struct.Struct("<H")
_EMPTY_KNOT = bytes(layout.KNOT_SIZE)
_COMMAND_BEGIN = struct.pack("<I", layout.COMMAND_MAGIC)


def _pack(block: Block, values: dict[str, Any]) -> bytes:
    flat: list[Any] = []
    for field in block.fields:
        value = values[field.name]
        if field.array_length == 1 or field.iec_type == "USINT":
            flat.append(value)
        elif len(value) == field.array_length:
            flat.extend(value)
        else:
            raise LocalProtocolError(
                f"{block.name}.{field.name}: {len(value)} values, the wire carries {field.array_length}"
            )
    try:
        return block.codec.pack(*flat)
    except (struct.error, OverflowError, TypeError) as error:
        raise LocalProtocolError(f"{block.name}: a value does not fit its field: {error}") from error


def _unpack(block: Block, payload: bytes, offset: int) -> dict[str, Any]:
    flat = block.codec.unpack_from(payload, offset)
    values: dict[str, Any] = {}
    i = 0
    for field in block.fields:
        if field.array_length == 1 or field.iec_type == "USINT":
            values[field.name] = flat[i]
            i += 1
        else:
            values[field.name] = flat[i : i + field.array_length]
            i += field.array_length
    return values


def _pack_message_header(message: Command | State, magic: int, msg_type: MessageType, size: int) -> bytes:
    values = {
        "magic": magic,
        "ver_major": layout.VERSION_MAJOR,
        "ver_minor": message.ver_minor,
        "msg_type": msg_type,
        "hdr_len": layout.HEADER_SIZE,
        "payload_len": size,
        "flags": message.flags,
        "layout_id": layout.LAYOUT_ID,
        "session": message.session,
        "seq": message.seq,
        "t_send_ns": message.t_send_ns,
    }
    return _pack(layout.HEADER_LAYOUT, values)


def _add_tag_and_crc(payload: bytes, key: bytes) -> bytes:
    """The payload with its tag, if there is a key, and the CRC-32 of everything before it in its last 4 bytes."""
    if key:
        flags = _FLAGS_AT.unpack_from(payload, _HEADER_AT["flags"])[0] | HeaderFlag.AUTH
        end = _SIGNED_END[len(payload)]
        signed = payload[: _HEADER_AT["flags"]] + _FLAGS_AT.pack(flags) + payload[_HEADER_AT["flags"] + 2 : end]
        payload = signed + tag_of(key, signed) + payload[end + AUTH_TAG_BYTES :]
    return payload[:-4] + _CRC.pack(zlib.crc32(memoryview(payload)[:-4]))


def _require_finite(values: chain[float], subject: str) -> None:
    if not all(map(math.isfinite, values)):
        raise LocalProtocolError(
            f"{subject}: a number is NaN or infinite, which would stop the PLC; nothing was encoded"
        )


def encode_command(command: Command, key: bytes = b"") -> bytes:
    """The 1304 bytes of a command or HELLO; signed if there is a key.

    Raises: LocalProtocolError: a non-finite number, too many knots, or a value outside its field's range.
    """
    if len(command.knots) > layout.KNOTS_PER_COMMAND:
        raise LocalProtocolError(f"command: {len(command.knots)} knots, at most {layout.KNOTS_PER_COMMAND} fit")
    floats = chain((command.speed_override,), *((*k.q, *k.qd, *k.qdd) for k in command.knots))
    _require_finite(floats, f"command {command.seq}")
    body = {f.name: getattr(command, f.name, 0) for f in layout.COMMAND_BODY_LAYOUT.fields}
    body["knot_count"] = len(command.knots)
    knots = [_pack(layout.KNOT_LAYOUT, {"t_ns": k.t_ns, "q": k.q, "qd": k.qd, "qdd": k.qdd}) for k in command.knots]
    knots += [_EMPTY_KNOT] * (layout.KNOTS_PER_COMMAND - len(knots))
    msg_type = MessageType.HELLO if command.hello else MessageType.COMMAND
    header = _pack_message_header(command, layout.COMMAND_MAGIC, msg_type, layout.COMMAND_SIZE)
    tail = _pack(layout.COMMAND_TAIL_LAYOUT, {"auth_tag": command.auth_tag, "reserved": 0, "crc": 0})
    return _add_tag_and_crc(b"".join((header, _pack(layout.COMMAND_BODY_LAYOUT, body), *knots, tail)), key)


def encode_state(state: State, key: bytes = b"") -> bytes:
    """The 568 bytes of a state; signed if there is a key.

    Raises: LocalProtocolError: a non-finite number or a value outside its field's range.
    """
    arrays = (state.q, state.qd, state.q_ref, state.qd_ref, state.valve_cmd, state.p_a, state.p_b)
    scalars = (state.p_supply, state.p_tank, state.t_oil, state.speed_scale)
    _require_finite(chain(scalars, *arrays), f"state {state.seq}")
    body = {name: getattr(state, name) for name in _STATE_FIELDS} | {"reserved": 0, "crc": 0}
    header = _pack_message_header(state, layout.STATE_MAGIC, MessageType.STATE, layout.STATE_SIZE)
    return _add_tag_and_crc(header + _pack(layout.STATE_BODY_LAYOUT, body), key)


def _checked_header(
    payload: bytes, magic: int, size: int, types: tuple[MessageType, ...], key: bytes
) -> dict[str, Any]:
    """Receive rule 2 up to the message type, in this order: the first failure counts."""
    if len(payload) != size:
        raise MalformedError(RejectCode.LENGTH, f"payload of {len(payload)} bytes, must be {size}")
    header = _unpack(layout.HEADER_LAYOUT, payload, 0)
    expected = (
        ("magic", magic, RejectCode.MAGIC),
        ("ver_major", layout.VERSION_MAJOR, RejectCode.VERSION),
        ("layout_id", layout.LAYOUT_ID, RejectCode.LAYOUT),
        ("payload_len", size, RejectCode.LENGTH),
        ("hdr_len", layout.HEADER_SIZE, RejectCode.LENGTH),
    )
    for name, value, code in expected:
        if header[name] != value:
            raise MalformedError(code, f"{name} = {header[name]:#x}, must be {value:#x}", _HEADER_AT[name])
    if _CRC.unpack_from(payload, size - 4)[0] != zlib.crc32(memoryview(payload)[:-4]):
        raise MalformedError(RejectCode.CRC, f"CRC-32 does not match its {size - 4} bytes", size - 4)
    if key:
        _check_tag(payload, header["flags"], key)
    if header["msg_type"] not in types:
        text = f"msg_type = {header['msg_type']}, expected {[int(t) for t in types]}"
        raise MalformedError(RejectCode.MSG_TYPE, text, _HEADER_AT["msg_type"])
    return header


def _check_tag(payload: bytes, flags: int, key: bytes) -> None:
    end = _SIGNED_END[len(payload)]
    if not flags & HeaderFlag.AUTH or not is_authentic(key, payload[:end], payload[end : end + AUTH_TAG_BYTES]):
        raise MalformedError(RejectCode.AUTH, "not signed with our key", end)


def _refuse_not_finite(payload: bytes, block: Block, offset: int) -> None:
    """Find the number that is not finite, and refuse with its place."""
    for field in block.fields:
        if field.iec_type not in ("LREAL", "REAL"):
            continue
        size = field.size // field.array_length
        for i, value in enumerate(
            struct.unpack_from(f"<{field.format}", payload, offset - block.offset + field.offset)
        ):
            if not math.isfinite(value):
                where = offset - block.offset + field.offset + i * size
                raise MalformedError(RejectCode.NOT_FINITE, f"{block.name} {field.name}[{i}] is NaN or infinite", where)


def _decode_enum_value(kind: type[Any], value: int, name: str, at: dict[str, int]) -> Any:
    try:
        return kind(value)
    except ValueError:
        raise MalformedError(RejectCode.VALUE, f"{name} = {value} is not a {kind.__name__}", at[name]) from None


def decode_command(payload: bytes, key: bytes = b"") -> Command:
    """The command or HELLO in 1304 bytes; unused knots are dropped. With a key only what is signed with it is taken.

    Raises: MalformedError (a RemoteProtocolError) with code and place of the first rule that fails; nothing else.
    """
    types = (MessageType.COMMAND, MessageType.HELLO)
    header = _checked_header(payload, layout.COMMAND_MAGIC, layout.COMMAND_SIZE, types, key)
    body = _unpack(layout.COMMAND_BODY_LAYOUT, payload, layout.COMMAND_BODY_LAYOUT.offset)
    starts = range(layout.KNOTS_OFFSET, layout.COMMAND_TAIL_LAYOUT.offset, layout.KNOT_SIZE)
    knots = [_unpack(layout.KNOT_LAYOUT, payload, start) for start in starts]
    floats = chain((body["speed_override"],), *(chain(k["q"], k["qd"], k["qdd"]) for k in knots))
    if not all(map(math.isfinite, floats)):
        _refuse_not_finite(payload, layout.COMMAND_BODY_LAYOUT, layout.COMMAND_BODY_LAYOUT.offset)
        for start in starts:
            _refuse_not_finite(payload, layout.KNOT_LAYOUT, start)
    count = body.pop("knot_count")
    if count > layout.KNOTS_PER_COMMAND:
        text = f"knot_count = {count}, at most {layout.KNOTS_PER_COMMAND}"
        raise MalformedError(RejectCode.VALUE, text, _BODY_AT["knot_count"])
    body["mode"] = _decode_enum_value(Mode, body["mode"], "mode", _BODY_AT)
    body["interp"] = _decode_enum_value(Interp, body["interp"], "interp", _BODY_AT)
    body["cmd_flags"] = CommandFlag(body["cmd_flags"])
    return Command(
        session=header["session"],
        seq=header["seq"],
        t_send_ns=header["t_send_ns"],
        ver_minor=header["ver_minor"],
        flags=HeaderFlag(header["flags"]),
        hello=header["msg_type"] == MessageType.HELLO,
        knots=tuple(Knot(**knot) for knot in knots[:count]),
        auth_tag=_unpack(layout.COMMAND_TAIL_LAYOUT, payload, layout.COMMAND_TAIL_LAYOUT.offset)["auth_tag"],
        **body,
    )


def may_be_answered(payload: bytes) -> bool:
    """Whether a refused payload is worth a state: it begins as a command, and is not shorter than the answer.

    So two PLCs never answer each other, and no forged sender is sent more bytes than it took.
    """
    return len(payload) >= layout.STATE_SIZE and payload.startswith(_COMMAND_BEGIN)


def decode_state(payload: bytes, key: bytes = b"") -> State:
    """The state in 568 bytes. With a key only what is signed with it is taken.

    Raises: MalformedError (a RemoteProtocolError) with code and place of the first rule that fails; nothing else.
    """
    header = _checked_header(payload, layout.STATE_MAGIC, layout.STATE_SIZE, (MessageType.STATE,), key)
    body = _unpack(layout.STATE_BODY_LAYOUT, payload, layout.STATE_BODY_LAYOUT.offset)
    values = {name: body[name] for name in _STATE_FIELDS}
    arrays = (body[name] for name in ("q", "qd", "q_ref", "qd_ref", "valve_cmd", "p_a", "p_b"))
    if not all(
        map(math.isfinite, chain((body["p_supply"], body["p_tank"], body["t_oil"], body["speed_scale"]), *arrays))
    ):
        _refuse_not_finite(payload, layout.STATE_BODY_LAYOUT, layout.STATE_BODY_LAYOUT.offset)
    values["plc_state"] = _decode_enum_value(PlcState, body["plc_state"], "plc_state", _STATE_AT)
    values["link_state"] = _decode_enum_value(LinkState, body["link_state"], "link_state", _STATE_AT)
    values["mode_active"] = _decode_enum_value(Mode, body["mode_active"], "mode_active", _STATE_AT)
    return State(
        session=header["session"],
        seq=header["seq"],
        t_send_ns=header["t_send_ns"],
        ver_minor=header["ver_minor"],
        flags=HeaderFlag(header["flags"]),
        **values,
    )
