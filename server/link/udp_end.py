"""The link's socket: non-blocking, drained in one go, received datagrams stamped by the kernel where it does that."""

import socket
import struct
import threading
import time
from collections.abc import Sequence

from recording.clock import mono_ns

_SO_TIMESTAMPNS = 35  # Linux; Python 3.11 does not export it
_TIMESPEC = struct.Struct("@qq")
_MAX_DATAGRAM = 2048
_DRAIN = 32  # datagrams a turn, so that a flood cannot keep the sender from its deadlines
_READINGS = 3
_READ_NS = 1_000_000  # what a reading of both clocks may be off by
_SLEW = 5e-4  # 500 ppm: the most that the kernel lets NTP drive the wall clock away from the monotonic one

Address = tuple[str, int]


# Name resolution that never makes the link wait: a thread asks, the loop looks at the newest answer.


class Resolver:
    """The PLC's address; `refresh` while no session is open, since a container's address may change."""

    def __init__(self, host: str, port: int) -> None:
        self._host, self._port = host, port
        self._wanted = threading.Event()
        self.address: Address | None = None
        self.error = ""
        threading.Thread(target=self._work, name="link-resolver", daemon=True).start()
        self.refresh()

    def refresh(self) -> None:
        """Ask again; returns immediately."""
        self._wanted.set()

    def _work(self) -> None:
        while True:
            self._wanted.wait()
            self._wanted.clear()
            try:
                found = socket.getaddrinfo(self._host, self._port, socket.AF_INET, socket.SOCK_DGRAM)
            except (OSError, UnicodeError) as error:
                self.error = f"PLC host '{self._host}' cannot be resolved: {error}; check [plc] host in the settings"
                continue
            host, port = found[0][4][:2]
            self.address, self.error = (str(host), int(port)), ""


class UdpEnd:
    """One bound UDP socket. Times are of the monotonic clock."""

    def __init__(self, local: Address) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self.kernel_stamps = self._ask_for_stamps()
        self._clock = StampClock(*_both_clocks())
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
        begun_ns = mono_ns()
        arrived: list[tuple[bytes, int | None, Address]] = []
        emptied = False
        while len(arrived) < _DRAIN and not emptied:
            try:
                datagram, ancillary, _, source = self._socket.recvmsg(_MAX_DATAGRAM, 64)
            except OSError:  # nothing more, or an ICMP answer to something we sent
                emptied = True
            else:
                arrived.append((datagram, _stamp_ns(ancillary), source))
        times = self._clock.received_ns([stamp_ns for _, stamp_ns, _ in arrived], *_both_clocks()) if arrived else []
        if emptied:
            self._clock.empty_ns = begun_ns
        return [(datagram, t_ns, source) for (datagram, _, source), t_ns in zip(arrived, times, strict=True)]

    def close(self) -> None:
        """Release the port."""
        self._socket.close()


class StampClock:
    """From the kernel's stamps, on the wall clock, to receive times on the monotonic clock. Pure: clocks are arguments.

    A datagram came after the queue was last empty and before now. That distinguishes a stamp that is old because this
    process was frozen from one under which the wall clock was set. Where the clocks' differences of then and of now
    both fit, the earlier time counts: older than it is stops the machine, fresher than it is would move it.
    """

    def __init__(self, wall_ns: int, now_ns: int) -> None:
        self.empty_ns = now_ns  # since before then everything in the queue has come
        self._mono_minus_wall_ns = now_ns - wall_ns
        self._last_ns = now_ns

    def received_ns(self, stamps_ns: Sequence[int | None], wall_ns: int, now_ns: int) -> list[int]:
        """When they came; now for one without a stamp, or with one that fits nowhere. None lies before the last."""
        before_ns, self._mono_minus_wall_ns = self._mono_minus_wall_ns, now_ns - wall_ns
        offsets_ns = (before_ns, self._mono_minus_wall_ns)
        earliest_ns = self.empty_ns - _READ_NS - round(_SLEW * (now_ns - self.empty_ns))
        times: list[int] = []
        for stamp_ns in stamps_ns:
            found = [] if stamp_ns is None else [stamp_ns + offset_ns for offset_ns in offsets_ns]
            fitting = [t_ns for t_ns in found if earliest_ns <= t_ns <= now_ns + _READ_NS]
            self._last_ns = max(self._last_ns, min(fitting, default=now_ns))
            times.append(min(self._last_ns, now_ns))
        return times


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
