"""The exported captures and dissector in Wireshark: its own TwinCAT NV first, then our fields in both framings."""

import random
import shutil
import struct
import subprocess
import zlib
from functools import cache
from pathlib import Path

import pytest

from longreach.export_command import plc_parameters, st_sources
from protocol import layout
from protocol.framing import EAP_PORT, EapFraming
from protocol.twincat.bundle import build_bundle_files
from protocol.twincat.golden import Datagram, golden_messages, pcap
from server.settings import read_machine

TSHARK = shutil.which("tshark")
PARAMETERS = plc_parameters(read_machine("hiab033"), "192.168.0.10.1.1", "192.168.0.20.1.1")
GOLDENS = {golden.name: golden for golden in golden_messages(PARAMETERS)}
FRAMINGS = ["eap", "raw"]


@cache
def missing() -> str:
    """Why these tests cannot run here; empty if they can."""
    if TSHARK is None:
        return "tshark is not installed (Debian: apt-get install tshark)"
    done = subprocess.run([TSHARK, "--version"], capture_output=True, text=True, timeout=60, check=False)
    return "tshark is built without Lua" if "without Lua" in done.stdout else ""


pytestmark = pytest.mark.skipif(bool(missing()), reason=missing() or "-")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export")
    for path, data in build_bundle_files(PARAMETERS, st_sources()).items():
        if path.startswith(("vectors/", "wireshark/")):
            (folder / Path(path).name).write_bytes(data)
    return folder


def tshark(folder: Path, capture: str, *options: str, lua: bool = True) -> list[str]:
    """Its lines. A script given with -X runs for root too; its errors go to the tree or to stderr."""
    assert TSHARK is not None
    script = ["-X", f"lua_script:{folder / 'hmlink.lua'}"] if lua else []
    command = [TSHARK, *script, "-r", str(folder / f"{capture}.pcap"), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert "Lua" not in done.stderr, done.stderr
    assert "Lua Error" not in done.stdout
    return done.stdout.splitlines()


def columns(folder: Path, capture: str, *names: str, chosen: str = "frame") -> list[list[str]]:
    fields = [option for name in names for option in ("-e", name)]
    return [row.split("\t") for row in tshark(folder, capture, "-Y", chosen, "-T", "fields", *fields)]


def write(folder: Path, name: str, payloads: list[bytes], eap: bool = False) -> None:
    port = EAP_PORT if eap else 50110
    ends = ("192.168.0.10", EAP_PORT if eap else 50111), ("192.168.0.20", port)
    (folder / f"{name}.pcap").write_bytes(pcap(Datagram(i, *ends, payload) for i, payload in enumerate(payloads)))


def framed(payload: bytes, eap: bool) -> bytes:
    return EapFraming.for_client("192.168.0.10.1.1", "192.168.0.20.1.1").wrap(payload, 1) if eap else payload


def changed(payload: bytes, offset: int, data: bytes) -> bytes:
    """Other bytes at one place, and the CRC made right again."""
    new = payload[:offset] + data + payload[offset + len(data) : -4]
    return new + struct.pack("<I", zlib.crc32(new))


def test_eap_is_twincat_nv_without_any_option(folder: Path) -> None:
    text = "\n".join(tshark(folder, "eap", "-V", lua=False))
    assert text.count("TwinCAT NV: Network Vars") == len(GOLDENS)
    assert "Malformed" not in text


def test_byte_slices_find_sequence_mode_and_first_knot(folder: Path) -> None:
    """Wireshark's slices on the variable's data, at offsets counted by hand."""
    first_q = struct.pack("<d", GOLDENS["trajectory"].message.knots[0].q[0]).hex(":")  # type: ignore[union-attr]
    wanted = "tc_nv.id == 0x4801 && tc_nv.data[20:4] == 1b:00:00:00 && tc_nv.data[48:2] == 03:00"
    assert len(tshark(folder, "eap", "-Y", f"{wanted} && tc_nv.data[88:8] == {first_q}", lua=False)) == 1
    assert len(tshark(folder, "eap", "-Y", "tc_nv.id == 0x4802", lua=False)) == 5


@pytest.mark.parametrize("capture", FRAMINGS)
def test_every_number_of_header_and_bodies_is_the_payloads(folder: Path, capture: str) -> None:
    """Each scalar field against struct at the offset of docs/offsets.md."""
    for chosen, size, blocks in (
        ("hmlink.magic == 0x31434d48", 1304, (layout.HEADER_LAYOUT, layout.COMMAND_BODY_LAYOUT)),
        ("hmlink.magic == 0x31534d48", 568, (layout.HEADER_LAYOUT, layout.STATE_BODY_LAYOUT)),
    ):
        fields = [field for block in blocks for field in block.fields if field.array_length == 1]
        rows = columns(folder, capture, *(f"hmlink.{field.name}" for field in fields), chosen=chosen)
        payloads = [golden.payload for golden in GOLDENS.values() if len(golden.payload) == size]
        for row, payload in zip(rows, payloads, strict=True):
            for text, field in zip(row, fields, strict=True):
                value = struct.unpack_from("<" + field.format, payload, field.offset)[0]
                shown = float(text) if isinstance(value, float) else int(text, 0)
                assert shown == pytest.approx(value, rel=1e-6), field.name


@pytest.mark.parametrize("capture", FRAMINGS)
def test_every_knot_and_axis_is_shown(folder: Path, capture: str) -> None:
    names = ("knot", "knot.t_ns", "knot.q", "knot.qd", "knot.qdd")
    chosen = "hmlink.knot_count == 6"
    (row,) = columns(folder, capture, *(f"hmlink.{name}" for name in names), chosen=chosen)
    knots = GOLDENS["trajectory"].message.knots  # type: ignore[union-attr]
    shown = [[float(x) for x in text.split(",")] for text in row]
    assert shown[0] == [0, 1, 2, 3, 4, 5]
    assert shown[1] == [knot.t_ns for knot in knots]
    for name, found in zip(("q", "qd", "qdd"), shown[2:], strict=True):
        assert found == pytest.approx([x for knot in knots for x in getattr(knot, name)], rel=1e-12)
    (row,) = columns(folder, capture, "hmlink.q", "hmlink.q_ref", chosen="hmlink.plc_state == 4")
    state = GOLDENS["state-run"].message
    for text, values in zip(row, (state.q, state.q_ref), strict=True):  # type: ignore[union-attr]
        assert [float(x) for x in text.split(",")] == pytest.approx(values, rel=1e-12)


@pytest.mark.parametrize("capture", FRAMINGS)
def test_the_tree_names_modes_states_flags_and_the_refused_field(folder: Path, capture: str) -> None:
    text = "\n".join(tshark(folder, capture, "-V"))
    assert text.count("HMLINK 1.1\n") == len(GOLDENS)
    assert "Malformed" not in text
    assert (text.count("TwinCAT NV: Network Vars") > 0) == (capture == "eap")
    for line in ("msg_type: HELLO (3)", "mode: TRAJECTORY (3)", "plc_state: RUN (4)", "interp: QUINTIC (3)",
                 "reject_code: IMPLIED_SPEED (37)", "refused field: knot[1].q[0]", "knot: 5 at 250000000 ns",
                 "crc good: True", "..1. = START: True", ".1.. = DRY_RUN: True"):  # fmt: skip
        assert line in text
    assert f"auth_tag: {GOLDENS['servo'].payload[1280:1296].hex()}" in text
    lines = [line.strip() for line in text.splitlines()]
    assert {f"q[{i}]" for i in range(8)} <= {line.partition(":")[0] for line in lines}


@pytest.mark.parametrize("capture", FRAMINGS)
def test_filters_and_the_packet_list(folder: Path, capture: str) -> None:
    names = list(GOLDENS)
    for chosen, wanted in (
        ("hmlink.flags.dry_run == 1", ["state-dry-run"]),
        ("hmlink.flags.auth == 1", ["servo"]),
        ("hmlink.mode == 3 && hmlink.cmd_flags.last_is_end == 1", ["trajectory", "trajectory-refused"]),
        ("hmlink.reject_code == 37", ["state-refusal"]),
        ("hmlink.crc_good == 0 || _ws.expert", []),
    ):
        found = [names[int(row[0]) - 1] for row in columns(folder, capture, "frame.number", chosen=chosen)]
        assert found == wanted, chosen
    info = [row[0] for row in columns(folder, capture, "_ws.col.Info")]
    told = dict(zip(names, info, strict=True))
    assert told["trajectory"] == "HMLINK COMMAND seq 27 TRAJECTORY traj 1 knots 0..5"
    assert told["state-refusal"] == "HMLINK STATE seq 28 HOLD ack 27 refused 28: IMPLIED_SPEED at knot[1].q[0]"
    assert told["hello"] == "HMLINK HELLO seq 1 HEARTBEAT"


@pytest.mark.parametrize("eap", [True, False], ids=FRAMINGS)
def test_every_bit_is_shown_at_its_place(folder: Path, eap: bool) -> None:
    good = GOLDENS["state-hold"].payload
    bits = {"lag": 1 << 2, "oil_temperature": 1 << 6, "layout": 1 << 8}
    payloads = [changed(good, 64, struct.pack("<Q", bit)) for bit in bits.values()]
    payloads.append(changed(good, 496 + 4 * 3, struct.pack("<I", 1 << 4)))  # axis_status of the fourth axis
    write(folder, "bits", [framed(payload, eap) for payload in payloads], eap)
    rows = columns(folder, "bits", *(f"hmlink.fault_bits.{name}" for name in bits), "hmlink.axis_status.encoder_fault")
    yes = [["1" if text in ("1", "True") else "0" for text in ",".join(row).split(",")] for row in rows]
    assert [row[:3] for row in yes] == [["1", "0", "0"], ["0", "1", "0"], ["0", "0", "1"], ["0", "0", "0"]]
    assert yes[3][3:] == ["0", "0", "0", "1", "0", "0", "0", "0"]


@pytest.mark.parametrize("eap", [True, False], ids=FRAMINGS)
def test_what_is_wrong_is_said(folder: Path, eap: bool) -> None:
    good = GOLDENS["trajectory"].payload
    bent = good[:100] + bytes([good[100] ^ 1]) + good[101:]
    payloads = (good, bent, good[:200], good + b"tail", changed(good, 12, b"\1\2\3\4"), changed(good, 4, b"\2"))
    write(folder, "wrong", [framed(payload, eap) for payload in payloads], eap)
    names = ("crc_good", "bad_crc", "bad_size", "other_layout")
    rows = columns(folder, "wrong", *(f"hmlink.{name}" for name in names))
    crc = [row[0] for row in rows]
    assert [text in ("1", "True") for text in crc] == [True, False, False, False, True, True]
    assert [bool(text) for text in crc] == [True, True, False, False, True, True]
    said = [[name for name, text in zip(names[1:], row[1:], strict=True) if text] for row in rows]
    assert said == [[], ["bad_crc"], ["bad_size"], ["bad_size"], ["other_layout"], ["other_layout"]]


def test_ports_are_a_preference_and_other_traffic_on_them_is_left_alone(folder: Path) -> None:
    payload = GOLDENS["hello"].payload
    ends = ("10.0.0.1", 40001), ("10.0.0.2", 40002)
    (folder / "port.pcap").write_bytes(pcap([Datagram(0, *ends, payload)]))
    assert columns(folder, "port", "hmlink.seq") == [[""]]
    moved = tshark(folder, "port", "-o", "hmlink.port_plc:40002", "-T", "fields", "-e", "hmlink.seq")
    assert moved == ["1"]
    write(folder, "other", [b"something else that uses the port of the PLC"])
    assert columns(folder, "other", "_ws.col.Protocol", "hmlink.magic") == [["UDP", ""]]


def broken(seed: int) -> list[bytes]:
    """Random bytes, cut and mutated messages, right and wrong CRC; some with our magic in front of anything."""
    rng = random.Random(seed)
    payloads = [golden.payload for golden in GOLDENS.values()]
    found = [payloads[i % len(payloads)][:length] for i, length in enumerate(range(0, 1304, 7))]
    for _ in range(400):
        payload = bytearray(rng.choice(payloads))
        for _ in range(rng.randrange(1, 40)):
            payload[rng.randrange(4, len(payload))] = rng.randrange(256)
        found.append(bytes(payload) if rng.random() < 0.5 else changed(bytes(payload), 0, b""))
        magic = rng.choice((b"HMC1", b"HMS1", b""))
        found.append(magic + rng.randbytes(rng.randrange(0, 1440)))
    return found


@pytest.mark.parametrize("eap", [True, False], ids=FRAMINGS)
def test_broken_datagrams_are_shown_without_lua_errors(folder: Path, eap: bool) -> None:
    payloads = broken(3)
    write(folder, "broken", [framed(payload, eap) for payload in payloads], eap)
    text = "\n".join(tshark(folder, "broken", "-V"))
    ours = sum(len(p) >= 32 and p[:4] in (b"HMC1", b"HMS1") for p in payloads)
    assert text.count("\nHMLINK 1.1") == ours > 800
    assert "Malformed" not in text


@pytest.mark.parametrize("eap", [True, False], ids=FRAMINGS)
def test_frames_that_were_not_recorded_whole_raise_no_lua_error(folder: Path, eap: bool) -> None:
    """As with a snap length: Wireshark itself says that the packet was cut."""
    write(folder, "whole", [framed(GOLDENS["trajectory"].payload, eap)] * 30, eap)
    data = (folder / "whole.pcap").read_bytes()
    size = (len(data) - 24) // 30
    cut = data[:24]
    for i in range(30):
        record, kept = data[24 + i * size : 24 + (i + 1) * size], 28 + 44 * i
        cut += record[:8] + struct.pack("<II", kept, size - 16) + record[16 : 16 + kept]
    (folder / "cut.pcap").write_bytes(cut)
    assert len(tshark(folder, "cut")) == 30
    tshark(folder, "cut", "-V")
