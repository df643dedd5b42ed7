"""A short golden conversation for building or testing another end: HELLO to STOP, in both framings."""

import struct
from collections.abc import Iterable
from dataclasses import dataclass

from protocol.codec import encode_command, encode_state
from protocol.codes import CommandFlag, HeaderFlag, Interp, LinkState, Mode, PlcState, RejectCode
from protocol.framing import EAP_PORT, EapFraming, Framing, RawFraming
from protocol.limits import axis_mask, cfg_id
from protocol.messages import Axes, Command, Knot, State, pad_to_eight_axes
from protocol.twincat.parameters import RAW_PC_PORT, RAW_PLC_PORT, PlcParameters

MS = 1_000_000
SESSION, NONCE = 0x10203040, 0x0A0B0C0D
EXAMPLE_AUTH_KEY = bytes(range(32))
_KNOT_MS = 50
_STEP = 0.003  # rad on the first axis: gentle for any crane


# Datagrams as a pcap file, written by hand: so that a golden capture needs neither a network nor root.

_GLOBAL = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 101)  # link type 101: raw IP
_RECORD = struct.Struct("<IIII")
_UDP_OVERHEAD = 28


@dataclass(frozen=True, slots=True)
class Datagram:
    """One UDP datagram: time from the start, ends as dotted addresses and ports."""

    t_us: int
    source: tuple[str, int]
    target: tuple[str, int]
    payload: bytes


def pcap(datagrams: Iterable[Datagram]) -> bytes:
    """Classic pcap of UDP over IPv4; UDP checksums are left out, as IPv4 allows."""
    return _GLOBAL + b"".join(_pcap_record(datagram) for datagram in datagrams)


def _pcap_record(datagram: Datagram) -> bytes:
    packet = _ip_packet(datagram)
    seconds, micros = divmod(datagram.t_us, 1_000_000)
    return _RECORD.pack(seconds, micros, len(packet), len(packet)) + packet


def _ip_packet(datagram: Datagram) -> bytes:
    length = len(datagram.payload)
    udp = struct.pack(">HHHH", datagram.source[1], datagram.target[1], 8 + length, 0)
    ends = _ipv4_address_bytes(datagram.source[0]) + _ipv4_address_bytes(datagram.target[0])
    blank = struct.pack(">BBHHHBBH8s", 0x45, 0, _UDP_OVERHEAD + length, 0, 0, 64, 17, 0, ends)
    header = blank[:10] + struct.pack(">H", _ip_header_checksum(blank)) + blank[12:]
    return header + udp + datagram.payload


def _ip_header_checksum(header: bytes) -> int:
    """RFC 1071: the complement of the one's complement sum."""
    total = sum(struct.unpack(f">{len(header) // 2}H", header))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF


def _ipv4_address_bytes(text: str) -> bytes:
    return bytes(int(part) for part in text.split("."))


@dataclass(frozen=True, slots=True)
class GoldenMessage:
    """One message with what it is for."""

    name: str
    purpose: str
    message: Command | State
    auth_key: bytes = b""

    @property
    def payload(self) -> bytes:
        """Its bytes."""
        if isinstance(self.message, Command):
            return encode_command(self.message, self.auth_key)
        return encode_state(self.message, self.auth_key)


def golden_messages(parameters: PlcParameters) -> tuple[GoldenMessage, ...]:
    """The messages in order; numbers, times and the limits' id fit together."""
    common = {
        "session": SESSION,
        "axis_mask": axis_mask(parameters.limit_table),
        "cfg_id": cfg_id(parameters.limit_table),
    }
    here = pad_to_eight_axes(tuple(0.5 * (axis.q_min + axis.q_max) for axis in parameters.limit_table.axes))

    def command(seq: int, mode: Mode, **more: object) -> Command:
        seen = {"ack_plc_seq": seq - 1, "t_plc_echo_ns": (5000 + 20 * (seq - 1)) * MS} if seq > 1 else {}
        fields = {**common, "timeout_us": 250_000, **seen, **more}
        return Command(seq=seq, t_send_ns=(1000 + 20 * seq) * MS, mode=mode, **fields)  # type: ignore[arg-type]

    def state(seq: int, plc_state: PlcState, mode: Mode, **more: object) -> State:
        clocks = {"ack_seq": seq, "t_pc_echo_ns": (1000 + 20 * seq) * MS, "rx_age_us": 1000, "plc_cycle_us": 1000}
        fields = {**common, **clocks, "q": here, "q_ref": here, "nonce": NONCE, "rx_ok": seq, **more}
        return State(
            seq=seq,
            t_send_ns=(5000 + 20 * seq) * MS,
            plc_state=plc_state,
            link_state=LinkState.FRESH,
            mode_active=mode,
            **fields,  # type: ignore[arg-type]
        )

    quintic = {"interp": Interp.QUINTIC, "cmd_flags": CommandFlag.START | CommandFlag.LAST_IS_END}
    target = Knot(0, (here[0] + 0.01, *here[1:]), (0.01, *(0.0,) * 7))
    fast = (*rest_to_rest(here)[:1], Knot(_KNOT_MS * MS, (here[0] + 1.0, *here[1:])))
    refused = {"reject_code": RejectCode.IMPLIED_SPEED, "reject_count": 1, "reject_seq": 28, "reject_offset": 288}
    before = {"ack_seq": 27, "t_pc_echo_ns": (1000 + 20 * 27) * MS, "rx_age_us": 21_000, "rx_ok": 27, "rx_bad": 1}
    return (
        GoldenMessage("hello", "opens the session", command(1, Mode.HEARTBEAT, hello=True)),
        GoldenMessage("state-linked", "it is open; the nonce is for ARM", state(1, PlcState.LINKED, Mode.HEARTBEAT)),
        GoldenMessage("arm", "after 25 good commands", command(26, Mode.ARM, arm_nonce=NONCE)),
        GoldenMessage("state-hold", "armed, at rest", state(26, PlcState.HOLD, Mode.HOLD)),
        GoldenMessage("trajectory", "six knots from rest to rest, START and LAST_IS_END",
               command(27, Mode.TRAJECTORY, traj_id=1, knots=rest_to_rest(here), **quintic)),
        GoldenMessage("state-run", "knot 1 is being played",
               state(27, PlcState.RUN, Mode.TRAJECTORY, traj_id=1, knot_playing=1, knot_last=5, t_play_ns=60 * MS,
                     buffer_us=190_000)),
        GoldenMessage("trajectory-refused", "its second knot implies too much speed: to be refused",
               command(28, Mode.TRAJECTORY, traj_id=2, knots=fast, **quintic)),
        GoldenMessage("state-refusal", "says so: code, number, and byte 288 = knot[1].q[0]",
               state(28, PlcState.HOLD, Mode.HOLD, traj_id=1, **before, **refused)),
        GoldenMessage("servo", "a target 10 mrad away that moves at 10 mrad/s, signed with key 00 01 .. 1f",
               command(29, Mode.SERVO, traj_id=3, knots=(target,), interp=Interp.LINEAR, cmd_flags=CommandFlag.START),
               EXAMPLE_AUTH_KEY),
        GoldenMessage("stop", "ramp down and hold", command(30, Mode.STOP)),
        GoldenMessage("state-dry-run", "flags: DRY_RUN, valves neutral",
               state(30, PlcState.HOLD, Mode.HOLD, flags=HeaderFlag.DRY_RUN)),
    )  # fmt: skip


def rest_to_rest(here: Axes) -> tuple[Knot, ...]:
    """Six knots of a quintic over 250 ms on the first axis."""
    T, knots = 5 * _KNOT_MS * 1e-3, []
    for k in range(6):
        x = k / 5
        s = x * x * x * (10.0 + x * (-15.0 + 6.0 * x))
        sd = x * x * (30.0 + x * (-60.0 + 30.0 * x)) / T
        sdd = x * (60.0 + x * (-180.0 + 120.0 * x)) / (T * T)
        moved = [(here[0] + _STEP * s, *here[1:]), (_STEP * sd, *(0.0,) * 7), (_STEP * sdd, *(0.0,) * 7)]
        knots.append(Knot(k * _KNOT_MS * MS, *moved))
    return tuple(knots)


def framed_datagram(golden: GoldenMessage, parameters: PlcParameters, eap: bool) -> bytes:
    """The datagram of a message in one of the framings."""
    ends = parameters.pc_net_id, parameters.plc_net_id
    from_pc = isinstance(golden.message, Command)
    framing: Framing = RawFraming()
    if eap:
        framing = EapFraming.for_client(*ends) if from_pc else EapFraming.for_plc(*ends)
    return framing.wrap(golden.payload, golden.message.seq)


def golden_pcap(parameters: PlcParameters, eap: bool) -> bytes:
    """The conversation as a capture, every message 20 ms after the one before."""
    pc = (parameters.pc_address, EAP_PORT if eap else RAW_PC_PORT)
    plc = (parameters.plc_address, EAP_PORT if eap else RAW_PLC_PORT)
    datagrams = []
    for i, golden in enumerate(golden_messages(parameters)):
        source, target = (pc, plc) if isinstance(golden.message, Command) else (plc, pc)
        datagrams.append(Datagram(i * 20_000, source, target, framed_datagram(golden, parameters, eap)))
    return pcap(datagrams)
