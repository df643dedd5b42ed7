"""The machine in real time: absolute deadlines, at most 20 ms of cycles in one go, datagrams in between."""

import socket
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from recording.clock import mono_ns
from sim_plc.machine_loop import MS, MachineLoop

WAKE_PERIOD_NS = 2 * MS
CATCH_UP_BATCH_MAX_NS = 20 * MS  # at most this much is caught up before the socket is looked at again
CATCH_UP_MAX_NS = (
    2000 * MS
)  # a pause of this computer is not one of the PLC: up to this much is caught up, more is skipped
_DRAIN = 64  # datagrams a wake, so that a flood cannot keep the plant from its cycles
_MAX_DATAGRAM = 4096


@dataclass(slots=True)
class LoopHealth:
    """How well the loop keeps up with the clock."""

    n_cycles: int = 0
    n_wakes: int = 0
    catch_ups: int = 0  # wakes that found more than 20 ms to do
    lost_ms: int = 0  # let go, because the loop was more than 2 s behind
    behind_max_ms: float = 0.0
    n_datagrams_received: int = 0
    n_states_sent: int = 0


class UdpPort:
    """A bound, non-blocking UDP socket."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)

    @property
    def address(self) -> tuple[str, int]:
        """Where it is bound."""
        return self._socket.getsockname()

    def receive(self) -> tuple[bytes, tuple[str, int]] | None:
        """The next datagram and its sender, or None."""
        while True:
            try:
                return self._socket.recvfrom(_MAX_DATAGRAM)
            except BlockingIOError:
                return None
            except ConnectionError:  # an ICMP answer to something we sent: the PC is gone
                continue

    def send(self, datagram: bytes, peer: tuple[str, int]) -> None:
        """Send, or lose it: the protocol bears loss."""
        with suppress(OSError):
            self._socket.sendto(datagram, peer)

    def close(self) -> None:
        """Release the port."""
        self._socket.close()


class RealTimeLoop:
    """Keeps a machine at the pace of the PLC's clock, t_plc = monotonic clock + epoch offset."""

    def __init__(
        self, machine: MachineLoop, udp: UdpPort, epoch_offset_ns: int, clock: Callable[[], int] = mono_ns
    ) -> None:
        self.health = LoopHealth()
        self._machine, self._udp, self._offset_ns, self._clock = machine, udp, epoch_offset_ns, clock

    def run(self, stopped: Callable[[], bool]) -> None:
        """Until `stopped`."""
        deadline_ns = self._clock()
        while not stopped():
            left_ns = self.run_due_cycles()
            if left_ns > 0:
                deadline_ns = self._clock()
                continue
            deadline_ns = max(deadline_ns + WAKE_PERIOD_NS, self._clock() - WAKE_PERIOD_NS)
            time.sleep(max(deadline_ns - self._clock(), 0) * 1e-9)

    def run_due_cycles(self) -> int:
        """Take what has arrived, run the cycles that are due (20 ms at most); what is left to catch up [ns]."""
        machine, health = self._machine, self.health
        now_ns = self._clock() + self._offset_ns
        self._receive_waiting_datagrams(now_ns)
        behind_ns = now_ns - machine.t_plc_ns
        health.n_wakes += 1
        health.behind_max_ms = max(health.behind_max_ms, behind_ns / MS)
        if behind_ns > CATCH_UP_BATCH_MAX_NS:
            health.catch_ups += 1
        if behind_ns > CATCH_UP_MAX_NS:
            let_go = (behind_ns - CATCH_UP_BATCH_MAX_NS) // machine.cycle_ns
            machine.t_plc_ns += let_go * machine.cycle_ns
            health.lost_ms += let_go * machine.cycle_ns // MS
        until_ns = min(now_ns, machine.t_plc_ns + CATCH_UP_BATCH_MAX_NS - machine.cycle_ns)
        while machine.t_plc_ns <= until_ns:
            self._run_cycle()
        return max(now_ns - machine.t_plc_ns, 0)

    def _run_cycle(self) -> None:
        machine = self._machine
        datagram = machine.run_cycle()
        self.health.n_cycles += 1
        if datagram is None:
            return
        self.health.n_states_sent += 1
        for receiver in machine.plc.link.receivers():
            if isinstance(receiver, tuple):
                self._udp.send(datagram, (receiver[0], receiver[1]))

    def _receive_waiting_datagrams(self, now_ns: int) -> None:
        for _ in range(_DRAIN):
            arrived = self._udp.receive()
            if arrived is None:
                return
            self.health.n_datagrams_received += 1
            self._machine.plc.receive(arrived[0], now_ns, arrived[1])
