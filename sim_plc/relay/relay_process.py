"""The relay on real sockets: between PCs and a PLC, every datagram through a fault channel of its direction."""

import logging
import random
import select
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from types import FrameType

from recording.clock import mono_ns, mono_s
from sim_plc.relay.faults import FaultChannel, FaultCounts, Faults, FaultSettingsError
from sim_plc.relay.settings import RelaySettings

log = logging.getLogger(__name__)

Address = tuple[str, int]
_IDLE_S = 0.05  # at most this long without a look at the stop flag
_MAX_DATAGRAM = 65535
_DRAIN = 64  # datagrams a socket and round, so that a flood on one side cannot starve the other
_LANES_MAX = 16


@dataclass(frozen=True, slots=True)
class RelayFigures:
    """What a relay has done, by direction."""

    to_plc: FaultCounts
    to_pc: FaultCounts
    n_pcs: int


class _PcConnection:
    """One PC: a socket towards the PLC, so that the PLC sees its PCs apart, and a channel each way."""

    def __init__(self, pc: Address, plc: Address, settings: RelaySettings, number: int) -> None:
        self.pc = pc
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.socket.connect(plc)
        self.to_plc = FaultChannel(settings.to_plc, random.Random(f"{settings.seed} {number} to plc"))
        self.to_pc = FaultChannel(settings.to_pc, random.Random(f"{settings.seed} {number} to pc"))


class UdpRelay:
    """PCs send to `address` instead of to the PLC; the PLC answers to the relay, which passes it on.

    Raises: FaultSettingsError: the port is taken, or the PLC's name is unknown.
    """

    def __init__(self, settings: RelaySettings, clock: Callable[[], int] = mono_ns) -> None:
        self._settings, self._clock = settings, clock
        self._plc = _resolve_address(settings.plc_host, settings.plc_port)
        self._listener = _bind_udp_socket(settings.listen_host, settings.listen_port)
        self._lanes: dict[Address, _PcConnection] = {}
        self._opened = 0
        self._t_first_ns: int | None = None
        self._gone = RelayFigures(FaultCounts(), FaultCounts(), 0)
        self._faults = (settings.to_plc, settings.to_pc)

    @property
    def address(self) -> Address:
        """Where PCs send to."""
        return self._listener.getsockname()

    @property
    def counts(self) -> RelayFigures:
        """What has been done so far."""
        to_plc, to_pc = FaultCounts(), FaultCounts()
        to_plc.add(self._gone.to_plc)
        to_pc.add(self._gone.to_pc)
        for lane in list(self._lanes.values()):
            to_plc.add(lane.to_plc.counts)
            to_pc.add(lane.to_pc.counts)
        return RelayFigures(to_plc, to_pc, self._opened)

    def change(self, to_plc: Faults, to_pc: Faults) -> None:
        """Other faults from now on, for what comes from now on."""
        self._faults = (to_plc, to_pc)
        for lane in list(self._lanes.values()):
            lane.to_plc.faults, lane.to_pc.faults = to_plc, to_pc

    def run(self, stopped: Callable[[], bool]) -> None:
        """Until `stopped`, which is asked at least every 50 ms."""
        while not stopped():
            self.turn(_IDLE_S)

    def turn(self, wait_s: float) -> None:
        """Wait for a datagram or the next due one, at most wait_s; then pass on what is due."""
        sockets = [self._listener, *(lane.socket for lane in self._lanes.values())]
        readable, _, _ = select.select(sockets, [], [], self._sleep_s(wait_s))
        now_ns = self._clock()
        if self._listener in readable:
            self._from_pcs(now_ns)
        for lane in self._lanes.values():
            if lane.socket in readable:
                for datagram in _waiting_datagrams(lane.socket):
                    lane.to_pc.push(datagram[0], self._elapsed_ns(now_ns))
            self._deliver_due_datagrams(lane, self._elapsed_ns(self._clock()))

    def close(self) -> None:
        """Release the ports; what is on its way is lost."""
        for lane in self._lanes.values():
            lane.socket.close()
        self._listener.close()

    def _sleep_s(self, wait_s: float) -> float:
        channels = (channel for lane in self._lanes.values() for channel in (lane.to_plc, lane.to_pc))
        due_ns = min((due for channel in channels if (due := channel.next_due_ns) is not None), default=None)
        if due_ns is None:
            return wait_s
        return min(max(due_ns - self._elapsed_ns(self._clock()), 0) * 1e-9, wait_s)

    def _elapsed_ns(self, now_ns: int) -> int:
        if self._t_first_ns is None:
            self._t_first_ns = now_ns
        return now_ns - self._t_first_ns

    def _from_pcs(self, now_ns: int) -> None:
        for datagram, pc in _waiting_datagrams(self._listener):
            lane = self._lanes.get(pc) or self._open(pc)
            lane.to_plc.push(datagram, self._elapsed_ns(now_ns))

    def _open(self, pc: Address) -> _PcConnection:
        """A lane for a new PC; beyond sixteen the oldest one is given up."""
        if len(self._lanes) >= _LANES_MAX:
            oldest = self._lanes.pop(next(iter(self._lanes)))
            oldest.socket.close()
            self._gone.to_plc.add(oldest.to_plc.counts)
            self._gone.to_pc.add(oldest.to_pc.counts)
        self._opened += 1
        lane = self._lanes[pc] = _PcConnection(pc, self._plc, self._settings, self._opened)
        lane.to_plc.faults, lane.to_pc.faults = self._faults
        log.info("PC %s:%d relayed to %s:%d", *pc, *self._plc)
        return lane

    def _deliver_due_datagrams(self, lane: _PcConnection, elapsed_ns: int) -> None:
        for datagram in lane.to_plc.pop(elapsed_ns):
            with suppress(OSError):  # the PLC is not there: the datagram is lost, as in any network
                lane.socket.send(datagram)
        for datagram in lane.to_pc.pop(elapsed_ns):
            with suppress(OSError):
                self._listener.sendto(datagram, lane.pc)


def run_relay(
    settings: RelaySettings, ready: Callable[[Address], None] | None = None, for_s: float | None = None
) -> RelayFigures:
    """Relay until SIGTERM or SIGINT, or for `for_s`; `ready` gets the address. Returns the figures.

    Raises: FaultSettingsError: the port is taken, or the PLC's name is unknown.
    """
    relay = UdpRelay(settings)
    try:
        with _stop_flag() as signalled:
            if ready is not None:
                ready(relay.address)
            end = mono_s() + for_s if for_s is not None else None
            relay.run(lambda: signalled() or (end is not None and mono_s() >= end))
        return relay.counts
    finally:
        relay.close()


@contextmanager
def _stop_flag() -> Iterator[Callable[[], bool]]:
    """SIGTERM and SIGINT set a flag for as long as the block runs."""
    flagged: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        del frame
        flagged.append(number)

    before = {number: signal.signal(number, note) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield lambda: bool(flagged)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _waiting_datagrams(port: socket.socket) -> Iterator[tuple[bytes, Address]]:
    """What waits in a socket. An ICMP answer to something sent earlier is not a datagram."""
    for _ in range(_DRAIN):
        try:
            yield port.recvfrom(_MAX_DATAGRAM)
        except BlockingIOError:
            return
        except ConnectionError:
            continue


def _resolve_address(host: str, port: int) -> Address:
    try:
        return socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)[0][4][:2]  # type: ignore[return-value]
    except OSError as error:
        raise FaultSettingsError(
            f"plc_host = '{host}': {error.strerror or error}; give a name or an address"
        ) from error


def _bind_udp_socket(host: str, port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        listener.bind((host, port))
    except OSError as error:
        listener.close()
        raise FaultSettingsError(
            f"listen_host = '{host}', listen_port = {port}: {error.strerror or error}; choose another"
        ) from error
    listener.setblocking(False)
    return listener
