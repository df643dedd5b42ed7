"""EAP frames: foreign variables passed over, every wrong field refused, never another exception."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.codes import RejectCode
from protocol.errors import FramingError, LocalProtocolError
from protocol.framing import EapFraming, parse_net_id, wrap_eap

PC, PLC = "10.0.0.1.1.1", "10.0.0.2.1.1"
CLIENT, SERVER = EapFraming.for_client(PC, PLC), EapFraming.for_plc(PC, PLC)


def test_each_end_takes_what_the_other_sends() -> None:
    assert SERVER.unwrap(CLIENT.wrap(b"command", 70000)) == b"command"
    assert CLIENT.unwrap(SERVER.wrap(b"state", 1)) == b"state"
    assert CLIENT.wrap(b"x", 70000)[10:12] == (70000 & 0xFFFF).to_bytes(2, "little")  # cycle index


def test_a_second_variable_in_the_frame_is_passed_over() -> None:
    ours = CLIENT.wrap(b"command", 1)
    foreign = bytes.fromhex("6400 0100 0300 0000") + b"abc"
    both = bytearray(ours[:14] + foreign + ours[14:])
    both[8] = 2  # count
    both[:2] = (len(both) - 2 | 4 << 12).to_bytes(2, "little")
    assert SERVER.unwrap(bytes(both)) == b"command"


@pytest.mark.parametrize(
    ("offset", "value"),
    [
        (0, b"\x00\x40"),  # length
        (1, b"\x50"),  # type mailbox
        (2, b"\x0b"),  # publisher
        (8, b"\x00"),  # no variables
        (14, b"\x02"),  # variable id
        (16, b"\xff\xff"),  # version
        (18, b"\xff\x03"),  # length of the variable
    ],
)
def test_every_wrong_header_field_is_refused(offset: int, value: bytes) -> None:
    frame = bytearray(CLIENT.wrap(bytes(100), 1))
    frame[offset : offset + len(value)] = value
    with pytest.raises(FramingError) as caught:
        SERVER.unwrap(bytes(frame))
    assert caught.value.code is RejectCode.EAP_HEADER


def test_reserved_sm_and_quality_are_ignored() -> None:
    frame = bytearray(CLIENT.wrap(b"command", 1))
    frame[12:14] = b"\xaa\x55"
    frame[20:22] = b"\x07\x00"
    assert SERVER.unwrap(bytes(frame)) == b"command"


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=80), st.booleans())
def test_random_bytes_give_framing_errors_or_a_payload(data: bytes, plausible: bool) -> None:
    if plausible:
        data = (len(data) + 6 | 4 << 12).to_bytes(2, "little") + SERVER.peer_publisher + data
    try:
        payload = SERVER.unwrap(data)
    except FramingError:
        return
    assert payload in data


def test_an_oversized_variable_is_our_own_mistake() -> None:
    with pytest.raises(LocalProtocolError, match="1450"):
        wrap_eap(bytes(1451), bytes(6), 1, 1, 1)


@pytest.mark.parametrize(
    "text", ["", "1.2.3.4", "1.2.3.4.5.256", "1.2.3.4.5.x", "1.2.3.4.5.-6", "1.2.3.4.5.6.7", "1.2.3.4.5.٣"]
)
def test_a_bad_net_id_is_told(text: str) -> None:
    with pytest.raises(LocalProtocolError, match="AMS NetId"):
        parse_net_id(text)
