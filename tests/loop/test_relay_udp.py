"""The fault relay on real sockets: alone with a fake clock, between both ends of the link, and as a command."""

import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator

import pytest
import typer
from link_toy_plc import MS, TABLE, ToyPlc, smooth_knots
from typer.testing import CliRunner

from longreach.relay_command import relay
from protocol.client_events import ClientEvent, ClientPhase, TrajectoryEnded
from protocol.client_link import ClientLink
from protocol.codes import PlcState
from protocol.framing import RawFraming
from protocol.messages import Axes, pad_to_eight_axes
from recording.clock import mono_ns
from server.errors import SettingsError
from sim_plc.relay.faults import FaultCounts, Faults, FaultSettingsError
from sim_plc.relay.relay_process import UdpRelay
from sim_plc.relay.settings import RelaySettings

pytestmark = [pytest.mark.system, pytest.mark.real_time]
GOAL: Axes = pad_to_eight_axes((0.1, -0.1, 0.05))
EPOCH_NS = 3_600_000_000_000


def udp() -> socket.socket:
    port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    port.bind(("127.0.0.1", 0))
    port.settimeout(5.0)
    return port


class Bench:
    """A relay with a clock that stands still until it is told to move, a PLC socket and PC sockets."""

    def __init__(self, to_plc: Faults = Faults(), to_pc: Faults = Faults(), pcs: int = 1) -> None:  # noqa: B008 frozen
        self.now_ns = 77 * MS
        self.plc, self.pcs = udp(), [udp() for _ in range(pcs)]
        settings = RelaySettings(plc_port=self.plc.getsockname()[1], listen_port=0, to_plc=to_plc, to_pc=to_pc)
        self.relay = UdpRelay(settings, clock=lambda: self.now_ns)

    def up(self, datagram: bytes, pc: int = 0) -> None:
        self.pcs[pc].sendto(datagram, self.relay.address)
        self.relay.turn(5.0)

    def down(self, datagram: bytes, to: tuple[str, int]) -> None:
        self.plc.sendto(datagram, to)
        self.relay.turn(5.0)

    def nothing_at(self, port: socket.socket) -> bool:
        port.setblocking(False)
        try:
            port.recvfrom(100)
        except BlockingIOError:
            return True
        finally:
            port.settimeout(5.0)
        return False

    def close(self) -> None:
        for port in (self.relay, self.plc, *self.pcs):
            port.close()


@pytest.fixture
def bench() -> Iterator[Callable[..., Bench]]:
    made: list[Bench] = []

    def make(**settings: object) -> Bench:
        made.append(Bench(**settings))  # type: ignore[arg-type]
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_it_passes_bytes_both_ways_and_keeps_pcs_apart(bench: Callable[..., Bench]) -> None:
    b = bench(pcs=2)
    b.up(b"one")
    first, from_one = b.plc.recvfrom(100)
    b.up(b"two", pc=1)
    second, from_two = b.plc.recvfrom(100)
    assert (first, second) == (b"one", b"two")
    assert from_one != from_two
    b.down(b"for two", from_two)
    assert b.pcs[1].recvfrom(100) == (b"for two", b.relay.address)
    assert b.nothing_at(b.pcs[0])
    figures = b.relay.counts
    assert figures.n_pcs == 2
    assert figures.to_plc == FaultCounts(taken=2, delivered=2)
    assert figures.to_pc == FaultCounts(taken=1, delivered=1)


def test_a_delayed_datagram_waits_for_its_time(bench: Callable[..., Bench]) -> None:
    b = bench(to_plc=Faults(delay_ms=10.0))
    b.up(b"late")
    assert b.nothing_at(b.plc)
    b.now_ns += 10 * MS
    b.relay.turn(0.0)
    assert b.plc.recv(100) == b"late"


def test_windows_count_from_the_first_datagram(bench: Callable[..., Bench]) -> None:
    b = bench(to_plc=Faults(cut_windows_s=((0.1, 0.2),)))
    for datagram in (b"a", b"b", b"c"):
        b.up(datagram)
        b.now_ns += 100 * MS
    assert [b.plc.recv(100), b.plc.recv(100)] == [b"a", b"c"]
    assert b.relay.counts.to_plc.cut == 1


def test_beyond_sixteen_pcs_the_oldest_is_given_up_but_still_counted(bench: Callable[..., Bench]) -> None:
    b = bench(pcs=17)
    for pc in range(17):
        b.up(b"hello", pc)
    _, oldest = b.plc.recvfrom(100)
    assert b.relay.counts.to_plc.delivered == 17
    b.plc.sendto(b"nobody there", oldest)
    b.relay.turn(0.0)
    assert b.nothing_at(b.pcs[0])


def test_a_plc_that_is_not_there_is_only_silence(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.plc.close()
    for _ in range(3):
        b.up(b"anybody?")
    assert b.relay.counts.to_plc.taken == 3
    assert b.nothing_at(b.pcs[0])


def test_a_taken_port_is_refused_by_name() -> None:
    with udp() as taken, pytest.raises(FaultSettingsError, match="listen_port = "):
        UdpRelay(RelaySettings(listen_port=taken.getsockname()[1]))


class ToyOnUdp:
    """The toy PLC on a real socket, in a thread, its clock an hour ahead."""

    def __init__(self) -> None:
        self.plc, self.port, self.done = ToyPlc(), udp(), False
        self.port.settimeout(0.001)
        self.thread = threading.Thread(target=self._run)
        self.thread.start()

    def _run(self) -> None:
        while not self.done:
            try:
                datagram, source = self.port.recvfrom(2048)
            except TimeoutError:
                datagram, source = b"", None
            t_ns = mono_ns() + EPOCH_NS
            if source is not None:
                self.plc.receive(datagram, t_ns, source)
            for answer, peer in self.plc.cycle(t_ns):
                self.port.sendto(answer, peer)  # type: ignore[arg-type]

    def close(self) -> None:
        self.done = True
        self.thread.join()
        self.port.close()


@pytest.fixture
def toy() -> Iterator[ToyOnUdp]:
    plc = ToyOnUdp()
    yield plc
    plc.close()


class PcOnUdp:
    """A client on a real socket, 20 ms at a time."""

    def __init__(self, port: int) -> None:
        self.client, self.port = ClientLink(TABLE, RawFraming(), session=4711), udp()
        self.port.connect(("127.0.0.1", port))
        self.events: list[ClientEvent] = []

    def until(self, wanted: Callable[[], bool], within_s: float) -> bool:
        end_ns = mono_ns() + round(within_s * 1e9)
        while not wanted() and mono_ns() < end_ns:
            t_ns = mono_ns()
            self.events += self.client.poll(t_ns)
            datagram = self.client.send(t_ns)
            if datagram is not None:
                self.port.send(datagram)
            while (left_ns := t_ns + 20 * MS - mono_ns()) > 0:
                self.port.settimeout(left_ns * 1e-9)
                try:
                    self.events += self.client.receive(self.port.recv(2048), mono_ns())
                except TimeoutError:
                    break
        return wanted()

    def in_phase(self, phase: ClientPhase) -> Callable[[], bool]:
        return lambda: self.client.phase(mono_ns()) is phase

    def ended(self) -> list[TrajectoryEnded]:
        return [event for event in self.events if isinstance(event, TrajectoryEnded)]


def test_a_motion_reaches_its_goal_through_a_bad_network_and_a_cut_is_noticed(toy: ToyOnUdp, fault_relay) -> None:
    bad = Faults(
        loss_frac=0.15, duplicate_frac=0.1, reorder_frac=0.1, corrupt_frac=0.05, truncate_frac=0.05, jitter_ms=15.0
    )
    running = fault_relay(toy.port.getsockname()[1], bad, bad)
    pc = PcOnUdp(running.port)
    with pc.port:
        assert pc.until(pc.in_phase(ClientPhase.LINKED), 5.0)
        pc.client.request_arm()
        assert pc.until(pc.in_phase(ClientPhase.ARMED), 10.0)
        assert pc.client.state is not None
        assert pc.client.request_run(1, smooth_knots(pc.client.state.q_ref, GOAL, 1.0), mono_ns()) == ()
        assert pc.until(lambda: bool(pc.ended()), 8.0)
        assert pc.ended()[0].reached, pc.ended()[0].reason
        assert toy.plc.q_ref == GOAL

        running.change(to_pc=Faults(cut_windows_s=((0.0, 1e9),)))
        assert pc.until(pc.in_phase(ClientPhase.OFFLINE), 2.0)
    figures = running.figures
    assert figures.to_pc.cut > 5
    for counts in (figures.to_plc, figures.to_pc):
        for name in ("lost", "duplicated", "reordered", "corrupted", "truncated"):
            assert getattr(counts, name) > 0, name
        assert counts.taken - counts.lost - counts.cut + counts.duplicated >= counts.delivered
    assert toy.plc.link.state is not PlcState.RUN


def test_the_command_relays_and_tells_its_figures_on_sigterm() -> None:
    script = "import typer; from longreach.relay_command import relay; typer.run(relay)"
    with udp() as plc, udp() as pc:
        options = ["--plc-port", str(plc.getsockname()[1]), "--listen-port", "0", "--duplicate-pct", "100"]
        command = [sys.executable, "-c", script, *options]
        environment = {**os.environ, "COLUMNS": "120", "NO_COLOR": "1"}
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment) as process:
            assert process.stderr is not None
            found = re.search(r"udp 127\.0\.0\.1:(\d+),", process.stderr.readline())
            assert found
            pc.sendto(b"twice", ("127.0.0.1", int(found[1])))
            assert [plc.recv(100), plc.recv(100)] == [b"twice", b"twice"]
            process.send_signal(signal.SIGTERM)
            told = process.stderr.read()
            assert process.wait(5.0) == 0
    assert re.search(r"taken\D+1\D+0\D", told)
    assert re.search(r"delivered\D+2\D+0\D", told)
    assert re.search(r"duplicated\D+1\D+0\D", told)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--cut-after-s", "1", "--cut-direction", "up"], "direction = 'up'"),
        (["--plc-port", "0"], "plc_port = 0"),
        (["--delay-ms", "1e6"], "delay_ms = 1000000"),
        (["--plc-host", "no.such.host.invalid"], "plc_host = 'no.such.host.invalid'"),
    ],
)
def test_the_command_refuses_what_makes_no_sense(options: list[str], named: str) -> None:
    app = typer.Typer()
    app.command()(relay)
    error = CliRunner().invoke(app, [*options, "--for-s", "0"]).exception
    assert isinstance(error, SettingsError)
    assert named in str(error)
