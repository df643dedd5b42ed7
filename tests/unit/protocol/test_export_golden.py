"""The golden conversation: its bytes, its story, and that the simulated PLC takes and refuses what it says."""

import hmac
import json
import struct
import zlib
from itertools import pairwise

import pytest
from export_parts import PARAMETERS, exported

from protocol.codec import decode_command, decode_state
from protocol.codes import HeaderFlag, Mode, PlcState, RejectCode
from protocol.errors import MalformedError
from protocol.framing import EapFraming, RawFraming
from protocol.layout import COMMAND_SIZE, STATE_SIZE
from protocol.messages import Command, State
from protocol.twincat.golden import EXAMPLE_AUTH_KEY, framed_datagram, golden_messages
from sim_plc.plc.knot_ring import KnotRing, PlaybackView

CONVERSATION = {golden.name: golden for golden in golden_messages(PARAMETERS)}
JSON = json.loads(exported()["vectors/conversation.json"])["messages"]


def records(name: str) -> list[tuple[bytes, bytes]]:
    """IPv4 header and UDP datagram of every record of a capture."""
    data = exported()[f"vectors/{name}.pcap"]
    assert struct.unpack_from("<IHHiIII", data) == (0xA1B2C3D4, 2, 4, 0, 0, 65535, 101)
    found, at = [], 24
    while at < len(data):
        _, _, kept, length = struct.unpack_from("<IIII", data, at)
        assert kept == length
        found.append((data[at + 16 : at + 36], data[at + 36 : at + 16 + length]))
        at += 16 + length
    return found


@pytest.mark.parametrize("golden", CONVERSATION.values(), ids=CONVERSATION)
def test_every_payload_decodes_to_its_message(golden):
    payload = golden.payload
    assert zlib.crc32(payload[:-4]) == struct.unpack("<I", payload[-4:])[0]
    if isinstance(golden.message, Command):
        assert len(payload) == COMMAND_SIZE
        decoded = decode_command(payload, golden.auth_key)
        assert (decoded.seq, decoded.mode, decoded.knots) == (
            golden.message.seq, golden.message.mode, golden.message.knots)  # fmt: skip
    else:
        assert len(payload) == STATE_SIZE
        assert decode_state(payload, golden.auth_key) == golden.message


def test_all_kinds_of_messages_are_there():
    commands = [g.message for g in CONVERSATION.values() if isinstance(g.message, Command)]
    states = [g.message for g in CONVERSATION.values() if isinstance(g.message, State)]
    assert commands[0].hello
    assert {Mode.ARM, Mode.TRAJECTORY, Mode.SERVO, Mode.STOP} <= {command.mode for command in commands}
    assert {PlcState.LINKED, PlcState.HOLD, PlcState.RUN} <= {state.plc_state for state in states}
    assert any(state.flags & HeaderFlag.DRY_RUN for state in states)


def test_numbers_echoes_and_acknowledgements_fit_together():
    messages = [golden.message for golden in CONVERSATION.values()]
    for kind in (Command, State):
        seqs = [message.seq for message in messages if isinstance(message, kind)]
        assert all(a < b for a, b in pairwise(seqs))
    sent = {message.seq: message.t_send_ns for message in messages if isinstance(message, Command)}
    refused = {message.reject_seq for message in messages if isinstance(message, State)}
    for state in (message for message in messages if isinstance(message, State)):
        assert state.t_pc_echo_ns == sent[state.ack_seq]
        assert state.ack_seq not in refused
    states = {message.seq: message.t_send_ns for message in messages if isinstance(message, State)}
    for command in (message for message in messages if isinstance(message, Command)):
        assert states.get(command.ack_plc_seq, command.t_plc_echo_ns) == command.t_plc_echo_ns
    arm, linked = CONVERSATION["arm"].message, CONVERSATION["state-linked"].message
    assert isinstance(arm, Command)
    assert isinstance(linked, State)
    assert arm.arm_nonce == linked.nonce != 0


def test_the_simulated_plc_takes_the_trajectory_and_refuses_the_other_as_the_state_says():
    good, bad = CONVERSATION["trajectory"].message, CONVERSATION["trajectory-refused"].message
    told = CONVERSATION["state-refusal"].message
    assert isinstance(good, Command)
    assert isinstance(bad, Command)
    assert isinstance(told, State)
    view = PlaybackView(good.knots[0].q[:6])
    ring = KnotRing(PARAMETERS.limit_table)
    assert ring.check(good, view) is None
    objection = ring.check(bad, view)
    assert objection is not None
    assert (objection.code, objection.field_offset) == (RejectCode.IMPLIED_SPEED, 288)
    assert (told.reject_code, told.reject_offset, told.reject_seq) == (37, 288, bad.seq)


def test_the_servo_command_is_signed_with_the_key_it_names():
    payload = CONVERSATION["servo"].payload
    assert payload[1280:1296] == hmac.digest(EXAMPLE_AUTH_KEY, payload[:1280], "sha256")[:16]
    assert bytes(range(32)) == EXAMPLE_AUTH_KEY
    with pytest.raises(MalformedError) as refused:
        decode_command(payload, bytes(32))
    assert refused.value.code is RejectCode.AUTH
    assert decode_command(payload).mode is Mode.SERVO  # an end without a key ignores tags


def test_json_tells_the_same_bytes_and_fields():
    assert [entry["name"] for entry in JSON] == list(CONVERSATION)
    plc, pc = EapFraming.for_plc("10.1.2.3.1.1", "10.1.2.4.1.1"), EapFraming.for_client("10.1.2.3.1.1", "10.1.2.4.1.1")
    for entry, golden in zip(JSON, CONVERSATION.values(), strict=True):
        payload = bytes.fromhex(entry["payload_hex"])
        assert payload == golden.payload
        receiver = plc if isinstance(golden.message, Command) else pc
        assert receiver.unwrap(bytes.fromhex(entry["eap_datagram_hex"])) == payload
        fields = entry["fields"]
        assert fields["seq"] == struct.unpack_from("<I", payload, 20)[0]
        assert fields["crc"] == struct.unpack_from("<I", payload, len(payload) - 4)[0]
        if isinstance(golden.message, Command):
            assert fields["mode"] == payload[48]
            assert len(fields["knots"]) == 6
            assert fields["knots"][1]["q"] == list(struct.unpack_from("<8d", payload, 288))
            assert fields["auth_tag"] == payload[1280:1296].hex()
        else:
            assert fields["plc_state"] == payload[58]
            assert fields["q_ref"] == list(struct.unpack_from("<8d", payload, 272))


@pytest.mark.parametrize(("name", "eap", "ports"), [("raw", False, (50111, 50110)), ("eap", True, (34980, 34980))])
def test_captures_hold_the_conversation_between_the_right_ends(name, eap, ports):
    pc, plc = bytes([10, 1, 2, 3]), bytes([10, 1, 2, 4])
    found = records(name)
    assert len(found) == len(CONVERSATION)
    for (header, udp), golden in zip(found, CONVERSATION.values(), strict=True):
        ends, udp_ports = (pc + plc, ports) if isinstance(golden.message, Command) else (plc + pc, ports[::-1])
        assert header[12:20] == ends
        assert sum(struct.unpack(">10H", header)) % 0xFFFF == 0  # the header's checksum
        assert struct.unpack_from(">HHH", udp) == (*udp_ports, len(udp))
        assert udp[8:] == framed_datagram(golden, PARAMETERS, eap)
        assert eap or RawFraming().unwrap(udp[8:]) == golden.payload


def test_the_page_shows_every_byte_that_is_not_zero():
    page = exported()["vectors/conversation.md"].decode()
    sections = page.split("\n## ")[1:]
    for section, golden in zip(sections, CONVERSATION.values(), strict=True):
        assert section.startswith(f"{golden.name} (")
        shown = bytearray(len(golden.payload))
        for row in section.split("```")[1].strip().splitlines():
            at, text = row.split(":")
            part = bytes.fromhex(text)
            shown[int(at) : int(at) + len(part)] = part
        assert bytes(shown) == golden.payload
    assert "- mode: 3 (TRAJECTORY)" in page
    assert "- cmd_flags: 3 (LAST_IS_END, START)" in page
    assert "- reject_code: 37 (IMPLIED_SPEED)" in page
