"""Wireshark's own EAP dissector reads our frames: an independent judge of header and offsets."""

import shutil
import struct
import subprocess
from pathlib import Path

import pytest

from protocol.codec import encode_command, encode_state
from protocol.codes import CommandFlag, Interp, Mode, PlcState
from protocol.framing import EAP_PORT, EapFraming
from protocol.messages import ZEROS, Command, Knot, State

TSHARK = shutil.which("tshark")
pytestmark = pytest.mark.skipif(TSHARK is None, reason="tshark is not installed (Debian: apt-get install tshark)")
IDS = ("10.0.0.1.1.1", "10.0.0.2.1.1")


def ip_packet(payload: bytes, source_port: int, target_port: int) -> bytes:
    udp = struct.pack(">HHHH", source_port, target_port, 8 + len(payload), 0)
    ends = bytes([10, 0, 0, 1, 10, 0, 0, 2])
    header = struct.pack(">BBHHHBBH8s", 0x45, 0, 28 + len(payload), 0, 0, 64, 17, 0, ends)
    return header + udp + payload


def write_pcap(path: Path, packets: list[bytes]) -> None:
    """Classic pcap with link type 101 (raw IP)."""
    data = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 101)
    for i, packet in enumerate(packets):
        data += struct.pack("<IIII", i, 0, len(packet), len(packet)) + packet
    path.write_bytes(data)


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    client, plc = EapFraming.for_client(*IDS), EapFraming.for_plc(*IDS)
    knot = Knot(50_000_000, (1.0, *ZEROS[1:]))
    command = Command(
        9, 1, 5, Mode.TRAJECTORY, traj_id=1, interp=Interp.QUINTIC, cmd_flags=CommandFlag.START, knots=(knot,)
    )
    state = State(9, 2, 6, PlcState.RUN, q=(1.0, *ZEROS[1:]))
    packets = [
        ip_packet(client.wrap(encode_command(command), 1), 50000, EAP_PORT),
        ip_packet(plc.wrap(encode_state(state), 2), EAP_PORT, 50000),
    ]
    path = tmp_path_factory.mktemp("eap") / "eap.pcap"
    write_pcap(path, packets)
    return path


def tshark(capture: Path, *options: str) -> list[str]:
    assert TSHARK is not None
    done = subprocess.run(
        [TSHARK, "-r", str(capture), *options], capture_output=True, text=True, check=True, timeout=60
    )
    return done.stdout.splitlines()


def test_header_fields_without_any_option(capture: Path) -> None:
    names = (
        "ecatf.type",
        "ecatf.length",
        "tc_nv.publisher",
        "tc_nv.count",
        "tc_nv.cycleindex",
        "tc_nv.id",
        "tc_nv.length",
    )
    fields = [option for name in names for option in ("-e", name)]
    rows = [row.split("\t") for row in tshark(capture, "-T", "fields", *fields)]
    numbers = [[int(value, 0) for i, value in enumerate(row) if i != 2] for row in rows]
    assert numbers == [[4, 1324, 1, 1, 0x4801, 1304], [4, 588, 1, 2, 0x4802, 568]]
    assert [row[2] for row in rows] == ["0a0000010101", "0a0000020101"]


def test_nothing_is_malformed(capture: Path) -> None:
    text = "\n".join(tshark(capture, "-V"))
    assert text.count("TwinCAT NV: Network Vars") == 2
    assert "Malformed" not in text


@pytest.mark.parametrize(
    ("where", "frames"),
    [
        ("tc_nv.id == 0x4801 && tc_nv.data[20:4] == 01:00:00:00", ["1"]),  # seq
        ("tc_nv.id == 0x4801 && tc_nv.data[48:2] == 03:00", ["1"]),  # mode trajectory
        ("tc_nv.data[80:16] == 80:f0:fa:02:00:00:00:00:00:00:00:00:00:00:f0:3f", ["1"]),  # first knot: t and q[0]
        ("tc_nv.id == 0x4802 && tc_nv.data[58:1] == 04", ["2"]),  # plc_state RUN
        ("tc_nv.id == 0x4802 && tc_nv.data[144:8] == 00:00:00:00:00:00:f0:3f", ["2"]),  # q[0]
    ],
)
def test_byte_slices_find_our_fields(capture: Path, where: str, frames: list[str]) -> None:
    assert tshark(capture, "-Y", where, "-T", "fields", "-e", "frame.number") == frames
