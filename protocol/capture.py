"""Datagrams as a pcap file, written by hand: so that a golden capture needs neither a network nor root."""

import struct
from collections.abc import Iterable
from dataclasses import dataclass

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
    return _GLOBAL + b"".join(_record(datagram) for datagram in datagrams)


def _record(datagram: Datagram) -> bytes:
    packet = _ip_packet(datagram)
    seconds, micros = divmod(datagram.t_us, 1_000_000)
    return _RECORD.pack(seconds, micros, len(packet), len(packet)) + packet


def _ip_packet(datagram: Datagram) -> bytes:
    length = len(datagram.payload)
    udp = struct.pack(">HHHH", datagram.source[1], datagram.target[1], 8 + length, 0)
    ends = _address(datagram.source[0]) + _address(datagram.target[0])
    blank = struct.pack(">BBHHHBBH8s", 0x45, 0, _UDP_OVERHEAD + length, 0, 0, 64, 17, 0, ends)
    header = blank[:10] + struct.pack(">H", _checksum(blank)) + blank[12:]
    return header + udp + datagram.payload


def _checksum(header: bytes) -> int:
    """RFC 1071: the complement of the one's complement sum."""
    total = sum(struct.unpack(f">{len(header) // 2}H", header))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF


def _address(text: str) -> bytes:
    return bytes(int(part) for part in text.split("."))
