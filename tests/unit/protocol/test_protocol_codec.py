"""Round trips, and every kind of broken bytes: only RemoteProtocolError may come out."""

import math
import struct
import zlib
from dataclasses import fields, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol import layout
from protocol.codec import decode_command, decode_state, encode_command, encode_state
from protocol.codes import CommandFlag, HeaderFlag, Interp, LinkState, Mode, PlcState, RejectCode
from protocol.errors import LocalProtocolError, MalformedError, RemoteProtocolError
from protocol.messages import ZEROS, Command, Knot, State

U8, U16, U32, U64 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32, 64))
F64 = st.floats(allow_nan=False, allow_infinity=False)
F32 = st.floats(allow_nan=False, allow_infinity=False, width=32)
AXES64, AXES32 = (st.tuples(*(kind,) * 8) for kind in (F64, F32))
KNOTS = st.builds(Knot, U64, AXES64, AXES64, AXES64)
COMMANDS = st.builds(
    Command,
    U32,
    U32,
    U64,
    mode=st.sampled_from(Mode),
    hello=st.booleans(),
    flags=st.integers(0, 7).map(HeaderFlag),
    arm_nonce=U32,
    ack_plc_seq=U32,
    t_plc_echo_ns=U64,
    axis_mask=U16,
    cfg_id=U32,
    traj_id=U32,
    knot_first=U32,
    interp=st.sampled_from(Interp),
    cmd_flags=st.integers(0, 7).map(CommandFlag),
    timeout_us=U32,
    speed_override=F64,
    knots=st.lists(KNOTS, max_size=6).map(tuple),
    auth_tag=st.binary(min_size=16, max_size=16),
    ver_minor=U8,
)
_SPECIAL = {
    "plc_state": st.sampled_from(PlcState),
    "link_state": st.sampled_from(LinkState),
    "mode_active": st.sampled_from(Mode),
    "flags": st.integers(0, 7).map(HeaderFlag),
    "auth_tag": st.binary(min_size=16, max_size=16),
    "axis_status": st.tuples(*(U32,) * 8),
    "ver_minor": U8,
}
_WIRE = {f.name: f for block in (layout.HEADER_LAYOUT, layout.STATE_BODY_LAYOUT) for f in block.fields}
_KINDS = {"UINT": U16, "UDINT": U32, "ULINT": U64}


def _state_field(name: str) -> st.SearchStrategy:
    if name in _SPECIAL:
        return _SPECIAL[name]
    field = _WIRE[name]
    if field.iec_type in _KINDS:
        return _KINDS[field.iec_type]
    return {("LREAL", 8): AXES64, ("REAL", 8): AXES32, ("REAL", 1): F32}[field.iec_type, field.array_length]


STATES = st.builds(State, **{f.name: _state_field(f.name) for f in fields(State)})


def resealed(payload: bytes | bytearray) -> bytes:
    return bytes(payload[:-4]) + struct.pack("<I", zlib.crc32(payload[:-4]))


def code_of(decode, payload: bytes) -> RejectCode:  # type: ignore[no-untyped-def]
    with pytest.raises(MalformedError) as caught:
        decode(payload)
    return caught.value.code


@settings(max_examples=100, deadline=None)
@given(COMMANDS)
def test_command_round_trip(command: Command) -> None:
    payload = encode_command(command)
    assert len(payload) == layout.COMMAND_SIZE
    assert decode_command(payload) == command


@settings(max_examples=100, deadline=None)
@given(STATES)
def test_state_round_trip(state: State) -> None:
    payload = encode_state(state)
    assert len(payload) == layout.STATE_SIZE
    assert decode_state(payload) == state


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=1400))
def test_random_bytes_give_protocol_errors_only(data: bytes) -> None:
    for decode in (decode_command, decode_state):
        with pytest.raises(RemoteProtocolError):
            decode(data)


PAYLOADS = {
    decode_command: encode_command(Command(1, 2, 3, knots=(Knot(5),))),
    decode_state: encode_state(State(1, 2, 3, PlcState.RUN)),
}


@settings(max_examples=500, deadline=None)
@given(st.sampled_from([decode_command, decode_state]), st.data())
def test_mutated_bytes_with_a_right_crc_give_messages_or_protocol_errors(decode, data) -> None:  # type: ignore[no-untyped-def]
    payload = bytearray(PAYLOADS[decode])
    for _ in range(data.draw(st.integers(1, 8))):
        payload[data.draw(st.integers(0, len(payload) - 5))] = data.draw(st.integers(0, 255))
    try:
        message = decode(resealed(payload))
    except RemoteProtocolError:
        return
    assert message.session >= 0


@pytest.mark.parametrize("decode", [decode_command, decode_state])
def test_every_truncation_is_refused(decode) -> None:  # type: ignore[no-untyped-def]
    payload = PAYLOADS[decode]
    for n in range(len(payload)):
        assert code_of(decode, payload[:n]) is RejectCode.LENGTH
    assert code_of(decode, payload + b"\0") is RejectCode.LENGTH


@pytest.mark.parametrize("decode", [decode_command, decode_state])
def test_every_single_bit_flip_is_refused(decode) -> None:  # type: ignore[no-untyped-def]
    payload = PAYLOADS[decode]
    for bit in range(0, len(payload) * 8, 7):
        broken = bytearray(payload)
        broken[bit // 8] ^= 1 << bit % 8
        with pytest.raises(RemoteProtocolError):
            decode(bytes(broken))


@pytest.mark.parametrize(
    ("offset", "value", "code"),
    [
        (0, b"XXXX", RejectCode.MAGIC),
        (4, b"\x02", RejectCode.VERSION),
        (12, b"\0\0\0\0", RejectCode.LAYOUT),
        (8, b"\0\0", RejectCode.LENGTH),
        (7, b"\x10", RejectCode.LENGTH),
        (6, b"\x02", RejectCode.MSG_TYPE),
        (6, b"\x04", RejectCode.MSG_TYPE),
        (48, b"\x09\x00", RejectCode.VALUE),
        (64, b"\x07", RejectCode.VALUE),
        (65, b"\x04", RejectCode.VALUE),
        (72, struct.pack("<d", math.nan), RejectCode.NOT_FINITE),
        (88, struct.pack("<d", math.inf), RejectCode.NOT_FINITE),
        (1272, struct.pack("<d", -math.inf), RejectCode.NOT_FINITE),
    ],
)
def test_each_rule_of_a_command_has_its_code(offset: int, value: bytes, code: RejectCode) -> None:
    payload = bytearray(PAYLOADS[decode_command])
    payload[offset : offset + len(value)] = value
    assert code_of(decode_command, resealed(payload)) is code
    if code not in (RejectCode.MAGIC, RejectCode.VERSION, RejectCode.LAYOUT, RejectCode.LENGTH):
        assert code_of(decode_command, bytes(payload)) is RejectCode.CRC  # the CRC comes before the content


@pytest.mark.parametrize(
    ("offset", "value", "code"),
    [
        (6, b"\x01", RejectCode.MSG_TYPE),
        (58, b"\x08", RejectCode.VALUE),
        (59, b"\x04", RejectCode.VALUE),
        (60, b"\x09\x00", RejectCode.VALUE),
        (144, struct.pack("<d", math.nan), RejectCode.NOT_FINITE),
        (392, struct.pack("<d", math.inf), RejectCode.NOT_FINITE),
        (400, struct.pack("<f", math.nan), RejectCode.NOT_FINITE),
        (540, struct.pack("<f", math.inf), RejectCode.NOT_FINITE),
    ],
)
def test_each_rule_of_a_state_has_its_code(offset: int, value: bytes, code: RejectCode) -> None:
    payload = bytearray(PAYLOADS[decode_state])
    payload[offset : offset + len(value)] = value
    assert code_of(decode_state, resealed(payload)) is code


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_non_finite_numbers_are_not_encoded(bad: float) -> None:
    array = (*ZEROS[:7], bad)
    command, state = Command(1, 1, 1), State(1, 1, 1, PlcState.RUN)
    for knot in (Knot(0, q=array), Knot(0, qd=array), Knot(0, qdd=array)):
        with pytest.raises(LocalProtocolError, match="NaN or infinite"):
            encode_command(replace(command, knots=(knot,)))
    with pytest.raises(LocalProtocolError, match="NaN or infinite"):
        encode_command(replace(command, speed_override=bad))
    for name in ("q", "qd", "q_ref", "qd_ref", "valve_cmd", "p_a", "p_b"):
        with pytest.raises(LocalProtocolError, match="NaN or infinite"):
            encode_state(replace(state, **{name: array}))
    for name in ("p_supply", "p_tank", "t_oil", "speed_scale"):
        with pytest.raises(LocalProtocolError, match="NaN or infinite"):
            encode_state(replace(state, **{name: bad}))


@pytest.mark.parametrize(
    "broken",
    [
        Command(2**32, 1, 1),
        Command(1, -1, 1),
        Command(1, 1, 2**64),
        Command(1, 1, 1, axis_mask=2**16),
        Command(1, 1, 1, knots=(Knot(0),) * 7),
        Command(1, 1, 1, knots=(Knot(0, q=(0.0,) * 6),)),
        Command(1, 1, 1, knots=(Knot(-1),)),
    ],
)
def test_values_that_do_not_fit_are_our_own_mistake(broken: Command) -> None:
    with pytest.raises(LocalProtocolError):
        encode_command(broken)


def test_a_pressure_beyond_a_real_is_our_own_mistake() -> None:
    with pytest.raises(LocalProtocolError):
        encode_state(State(1, 1, 1, PlcState.RUN, p_supply=1e39))


def test_an_unknown_reject_code_of_a_newer_plc_is_passed_on() -> None:
    assert decode_state(encode_state(State(1, 1, 1, PlcState.RUN, reject_code=999))).reject_code == 999
