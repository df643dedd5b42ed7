"""Golden bytes, written by hand from the format, against the codec in both directions and in both framings."""

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest

from protocol import layout
from protocol.codec import decode_command, decode_state, encode_command, encode_state
from protocol.codes import CommandFlag, HeaderFlag, Interp, LinkState, Mode, PlcState, RejectCode
from protocol.errors import MalformedError
from protocol.framing import EapFraming, RawFraming, unwrap_eap, wrap_eap
from protocol.messages import ZEROS, Command, Knot, State

VECTORS = Path(__file__).parents[2] / "vectors"
LAYOUT_BYTES = "02 a8 60 ae"  # first four bytes of SHA-256 of hmlink1_schema.txt


def crc32_bitwise(data: bytes) -> int:
    """IEEE CRC-32, bit by bit: independent of zlib."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xEDB88320 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def read_vector(name: str) -> bytes:
    lines = (VECTORS / name).read_text().splitlines()
    data = bytearray(int(lines[0].split()[-1]))
    for line in lines[1:]:
        offset_text, _, rest = line.partition(":")
        token = rest.split("#")[0].strip()
        offset = int(offset_text)
        if token.startswith("VECTOR"):
            data[int(offset_text) :] = read_vector(token.split()[1])
            continue
        value = bytes.fromhex(LAYOUT_BYTES) if token == "LAYOUT" else b"" if token == "CRC" else bytes.fromhex(token)
        data[offset : offset + len(value)] = value
        if token == "CRC":
            data[offset:] = crc32_bitwise(bytes(data[:offset])).to_bytes(4, "little")
    return bytes(data)


def axes(**values: float) -> tuple[float, ...]:
    filled = list(ZEROS)
    for key, value in values.items():
        filled[int(key[1:])] = value
    return tuple(filled)


COMMAND = Command(
    ver_minor=0,
    session=0xDEADBEEF,
    seq=42,
    t_send_ns=1_000_000_000,
    mode=Mode.TRAJECTORY,
    arm_nonce=0x12345678,
    ack_plc_seq=7,
    t_plc_echo_ns=2_000_000_000,
    axis_mask=0x3F,
    cfg_id=0xCAFEF00D,
    traj_id=5,
    knot_first=12,
    interp=Interp.QUINTIC,
    cmd_flags=CommandFlag.LAST_IS_END | CommandFlag.START,
    timeout_us=250_000,
    speed_override=0.5,
    knots=(
        Knot(50_000_000, axes(a0=1.0, a1=-2.0), axes(a0=0.25), axes(a5=-1.5)),
        Knot(100_000_000, axes(a5=3.0)),
    ),
)
HELLO = Command(1, 1, 255, ver_minor=0, hello=True, flags=HeaderFlag.SIMULATION, axis_mask=1, cfg_id=0x01020304)
STATE = State(
    ver_minor=0,
    session=0xDEADBEEF,
    seq=8,
    t_send_ns=3_000_000_000,
    plc_state=PlcState.RUN,
    flags=HeaderFlag.SIMULATION,
    nonce=0x12345678,
    ack_seq=42,
    t_pc_echo_ns=1_000_000_000,
    rx_age_us=1000,
    plc_cycle=12345,
    plc_cycle_us=1000,
    link_state=LinkState.FRESH,
    mode_active=Mode.TRAJECTORY,
    axis_mask=0x3F,
    fault_bits=3,
    warn_bits=1 << 32,
    cfg_id=0xCAFEF00D,
    reject_code=30,
    reject_count=2,
    reject_seq=41,
    traj_id=5,
    knot_playing=12,
    knot_last=17,
    t_play_ns=50_000_000,
    buffer_us=100_000,
    underruns=1,
    rx_ok=2,
    rx_lost=3,
    rx_dup=4,
    rx_late=5,
    rx_bad=6,
    wd_trips=7,
    q=axes(a0=1.0),
    qd=axes(a7=2.0),
    q_ref=axes(a0=-0.5),
    qd_ref=axes(a7=0.25),
    valve_cmd=axes(a0=-1.0),
    p_a=axes(a7=4e6),
    p_b=axes(a0=2e6),
    axis_status=(0, 9, 0, 0, 0, 0, 0, 0),
    p_supply=2e7,
    p_tank=1e5,
    t_oil=45.0,
    speed_scale=0.75,
)


def test_layout_id_is_the_hash_of_the_kept_schema() -> None:
    text = (VECTORS / "hmlink1_schema.txt").read_bytes()
    assert text.decode() == layout.SCHEMA_TEXT
    assert hashlib.sha256(text).digest()[:4] == bytes.fromhex(LAYOUT_BYTES)
    assert layout.LAYOUT_ID.to_bytes(4, "little") == bytes.fromhex(LAYOUT_BYTES)


@pytest.mark.parametrize(("name", "message"), [("hmlink1_command.txt", COMMAND), ("hmlink1_hello.txt", HELLO)])
def test_command_vectors_both_ways(name: str, message: Command) -> None:
    golden = read_vector(name)
    assert encode_command(message).hex(" ") == golden.hex(" ")
    assert decode_command(golden) == message


def test_state_vector_both_ways() -> None:
    golden = read_vector("hmlink1_state.txt")
    assert encode_state(STATE).hex(" ") == golden.hex(" ")
    assert decode_state(golden) == STATE


def test_raw_framing_is_the_payload() -> None:
    golden = read_vector("hmlink1_command.txt")
    assert RawFraming().wrap(golden, 42) == golden
    assert RawFraming().unwrap(golden) == golden


def test_eap_frames_around_the_vectors() -> None:
    command, state = read_vector("hmlink1_command.txt"), read_vector("hmlink1_state.txt")
    client, plc = (f("10.0.0.1.1.1", "10.0.0.2.1.1") for f in (EapFraming.for_client, EapFraming.for_plc))
    framed = read_vector("hmlink1_eap_command.txt")
    assert client.wrap(command, 42) == framed
    assert plc.unwrap(framed) == command
    framed = read_vector("hmlink1_eap_state.txt")
    assert plc.wrap(state, 8) == framed
    assert client.unwrap(framed) == state


KEY = bytes(range(32))
SERVO = Command(
    session=0xDEADBEEF,
    seq=0xFFFFFFFF,
    t_send_ns=1_000_000_000,
    mode=Mode.SERVO,
    ack_plc_seq=8,
    t_plc_echo_ns=3_000_000_000,
    axis_mask=0x3F,
    cfg_id=0xCAFEF00D,
    traj_id=6,
    interp=Interp.LINEAR,
    cmd_flags=CommandFlag.START,
    timeout_us=250_000,
    knots=(Knot(0, axes(a0=0.5), axes(a0=0.0625)),),
)
REFUSAL = State(
    session=0xDEADBEEF,
    seq=9,
    t_send_ns=5_000_000_000,
    plc_state=PlcState.HOLD,
    flags=HeaderFlag.DRY_RUN,
    plc_cycle_us=1000,
    link_state=LinkState.FRESH,
    mode_active=Mode.HOLD,
    axis_mask=0x3F,
    reject_code=31,
    reject_count=1,
    reject_seq=42,
    reject_offset=360,
)


def test_signed_vectors_both_ways() -> None:
    golden = read_vector("hmlink11_servo_signed.txt")
    assert encode_command(SERVO, KEY).hex(" ") == golden.hex(" ")
    assert decode_command(golden, KEY) == replace(SERVO, flags=HeaderFlag.AUTH, auth_tag=golden[1280:1296])
    golden = read_vector("hmlink11_state_signed.txt")
    assert encode_state(REFUSAL, KEY).hex(" ") == golden.hex(" ")
    flags = HeaderFlag.AUTH | HeaderFlag.DRY_RUN
    assert decode_state(golden, KEY) == replace(REFUSAL, flags=flags, auth_tag=golden[544:560])


@pytest.mark.parametrize("name", ["hmlink11_servo_signed.txt", "hmlink1_command.txt"])
def test_another_key_a_changed_byte_and_no_tag_are_refused(name: str) -> None:
    golden = bytearray(read_vector(name))
    golden[88] ^= 1
    golden[-4:] = crc32_bitwise(bytes(golden[:-4])).to_bytes(4, "little")
    for payload, key in ((bytes(golden), KEY), (read_vector(name), bytes(32))):
        with pytest.raises(MalformedError) as refused:
            decode_command(payload, key)
        assert (refused.value.code, refused.value.offset) == (RejectCode.AUTH, 1280)
    assert decode_command(bytes(golden)).knots  # an end without a key does not look


def test_the_seventy_byte_eap_frame() -> None:
    golden = bytes.fromhex((VECTORS / "eap_frame_70.txt").read_text())
    assert len(golden) == 70
    data = bytes.fromhex("484d554301010000efbeadde2a000000d202964900000000") + bytes.fromhex(
        "9a9999999999b93f9a9999999999c9bf333333333333d33f"
    )
    publisher = bytes([10, 0, 0, 1, 1, 1])
    assert wrap_eap(data, publisher, 100, 1, 7) == golden
    assert unwrap_eap(golden, publisher, 100, 1) == data


def test_a_newer_minor_is_tolerated_and_another_major_is_not() -> None:
    assert decode_command(encode_command(replace(COMMAND, ver_minor=9))) == replace(COMMAND, ver_minor=9)
    other = bytearray(read_vector("hmlink1_command.txt"))
    other[4] = 2
    other[-4:] = crc32_bitwise(bytes(other[:-4])).to_bytes(4, "little")
    with pytest.raises(MalformedError, match="ver_major"):
        decode_command(bytes(other))
