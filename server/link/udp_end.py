"""The link's socket: non-blocking, drained in one go, received datagrams stamped by the kernel where it does that."""

import socket
import struct
import time

from recording.clock import mono_ns

_SO_TIMESTAMPNS = 35  # Linux; Python 3.11 does not export it
_TIMESPEC = struct.Struct("@qq")
_MAX_DATAGRAM = 2048
_DRAIN = 32  # datagrams a turn, so that a flood cannot keep the sender from its deadlines
_READINGS = 3
_STAMP_TRUST_NS = 1_000_000_000  # a stamp further away than this means that the wall clock was set

Address = tuple[str, int]


class UdpEnd:
    """One bound UDP socket. Times are of the monotonic clock."""

    def __init__(self, local: Address) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self.kernel_stamps = self._ask_for_stamps()
        self._socket.bind(local)

    def _ask_for_stamps(self) -> bool:
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        except OSError:
            return False
        return True

    def fileno(self) -> int:
        """For select."""
        return self._socket.fileno()

    @property
    def local_address(self) -> Address:
        """Where we are bound."""
        return self._socket.getsockname()

    def send(self, datagram: bytes, address: Address) -> bool:
        """Whether the datagram left; a full queue or an unreachable net is loss, which the protocol bears."""
        try:
            self._socket.sendto(datagram, address)
        except OSError:
            return False
        return True

    def drain(self) -> list[tuple[bytes, int, Address]]:
        """What has arrived, oldest first, at most 32: datagram, receive time, source. No time lies before the last."""
        arrived: list[tuple[bytes, int | None, Address]] = []
        while len(arrived) < _DRAIN:
            try:
                datagram, ancillary, _, source = self._socket.recvmsg(_MAX_DATAGRAM, 64)
            except OSError:  # nothing more, or an ICMP answer to something we sent
                break
            arrived.append((datagram, _stamp_ns(ancillary), source))
        if not arrived:
            return []
        clocks = _both_clocks()
        return [(datagram, _received_ns(stamp_ns, *clocks), source) for datagram, stamp_ns, source in arrived]

    def close(self) -> None:
        """Release the port."""
        self._socket.close()


def _stamp_ns(ancillary: list[tuple[int, int, bytes]]) -> int | None:
    """The kernel's stamp, on the wall clock; None where it gave none."""
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(data) == _TIMESPEC.size:
            seconds, nanoseconds = _TIMESPEC.unpack(data)
            return seconds * 1_000_000_000 + nanoseconds
    return None


def _both_clocks() -> tuple[int, int]:
    """Wall and monotonic clock at one moment: of some readings the one that was held up least in between.

    Why once a turn: held up for 30 us between the two, one datagram was stamped later than five that followed it.
    """
    readings = [(mono_ns(), time.time_ns(), mono_ns()) for _ in range(_READINGS)]
    before_ns, wall_ns, after_ns = min(readings, key=lambda one: one[2] - one[0])
    return wall_ns, (before_ns + after_ns) // 2


def _received_ns(stamp_ns: int | None, wall_ns: int, now_ns: int) -> int:
    age_ns = -1 if stamp_ns is None else wall_ns - stamp_ns
    return now_ns - age_ns if 0 <= age_ns <= _STAMP_TRUST_NS else now_ns
