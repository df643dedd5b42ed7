"""The real-time loop against a clock and a socket of our own: pace, batches, time let go, states, stamps."""

import signal

import numpy as np
import pytest
from virtual_plc import MACHINE, MS, Q_START, TABLE

from protocol.client_link import ClientLink
from protocol.codes import PlcState
from protocol.framing import EapFraming, RawFraming
from sim_plc.machine_loop import plc_framing
from sim_plc.plc.logic import PlcLogic
from sim_plc.plc.sample import PlantSample
from sim_plc.process import _StopFlag
from sim_plc.real_time import RealTimeLoop

OFFSET_NS = 5_000_000_000_000
PC = ("127.0.0.1", 40001)


class StillMachine:
    """A machine loop without a plant: the joints stay where they are."""

    def __init__(self, t_plc_ns):
        self.t_plc_ns, self.cycle_ns = t_plc_ns, MS
        self.plc = PlcLogic(MACHINE, RawFraming(), lambda: 77)
        zeros = np.zeros(6)
        self._sample = PlantSample(np.array(Q_START), zeros, zeros, zeros, 19e6, 40.0)

    def run_cycle(self):
        t_ns = self.t_plc_ns
        self.plc.run_cycle(t_ns, self._sample)
        self.t_plc_ns += MS
        link = self.plc.link
        due = t_ns % (10 * MS) == 0 and (link.peer is not None or link.refused is not None)
        return self.plc.send(t_ns) if due else None


class Wire:
    def __init__(self):
        self.to_plc, self.from_plc = [], []

    def receive(self):
        return self.to_plc.pop(0) if self.to_plc else None

    def send(self, datagram, peer):
        self.from_plc.append((datagram, peer))


class Rig:
    def __init__(self):
        self.t_mono_ns = 1000 * MS
        self.machine, self.wire = StillMachine(self.t_mono_ns + OFFSET_NS), Wire()
        self.loop = RealTimeLoop(self.machine, self.wire, OFFSET_NS, lambda: self.t_mono_ns)

    def pass_ms(self, ms):
        self.t_mono_ns += round(ms * MS)
        return self.loop.run_due_cycles()


def test_it_runs_the_cycles_that_are_due():
    rig = Rig()
    for _ in range(50):
        assert rig.pass_ms(2) == 0
    assert rig.loop.health.n_cycles == 101  # 100 ms and the one at the start
    assert rig.machine.t_plc_ns == rig.t_mono_ns + OFFSET_NS + MS
    assert rig.loop.health.catch_ups == 0


def test_a_delay_is_caught_up_in_batches_of_20_ms():
    rig = Rig()
    rig.pass_ms(2)
    left = rig.pass_ms(70)
    assert rig.loop.health.n_cycles == 3 + 20
    assert left > 0
    rounds = 1
    while rig.loop.run_due_cycles() > 0:
        rounds += 1
    assert rounds == 3
    assert rig.loop.health.n_cycles == 73
    assert rig.loop.health.lost_ms == 0
    assert rig.loop.health.catch_ups >= 2


@pytest.mark.parametrize(("pause_ms", "lost_ms"), [(1000, 0), (3000, 2980)])
def test_a_pause_of_the_computer_is_caught_up_and_a_long_one_let_go_and_counted(pause_ms, lost_ms):
    rig = Rig()
    rig.pass_ms(2)
    rig.pass_ms(pause_ms)
    while rig.loop.run_due_cycles() > 0:
        pass
    assert rig.loop.health.lost_ms == pytest.approx(lost_ms, abs=3)
    assert rig.machine.t_plc_ns == rig.t_mono_ns + OFFSET_NS + MS
    assert rig.loop.health.behind_max_ms > 0.99 * pause_ms


def test_states_go_to_the_peer_every_10_ms_and_commands_are_stamped_when_they_come():
    rig = Rig()
    client = ClientLink(TABLE, RawFraming(), session=5)
    for step in range(1000):
        rig.pass_ms(2)
        for datagram, peer in rig.wire.from_plc:
            assert peer == PC
            client.receive(datagram, rig.t_mono_ns)
        rig.wire.from_plc.clear()
        if step % 10 == 0:
            datagram = client.send(rig.t_mono_ns)
            if datagram is not None:
                rig.wire.to_plc.append((datagram, PC))
        if step == 200:
            client.request_arm()
    assert client.state.plc_state is PlcState.HOLD
    assert rig.loop.health.n_states_sent == client.counters.received
    assert 190 <= rig.loop.health.n_states_sent <= 200
    assert client.clock_offset.offset_ns is not None
    assert abs(client.clock_offset.offset_ns + OFFSET_NS) <= 2 * MS  # the wake period is the error


def test_a_second_pc_is_answered_and_told_that_another_one_holds_the_plc():
    rig = Rig()
    holder, second = (ClientLink(TABLE, RawFraming(), session=number) for number in (5, 6))
    ends = {PC: holder, ("127.0.0.1", 40002): second}
    heard = {address: 0 for address in ends}
    for _ in range(100):
        for address, client in ends.items():
            datagram = client.send(rig.t_mono_ns)
            rig.wire.to_plc += [] if datagram is None else [(datagram, address)]
        rig.pass_ms(20)
        for datagram, address in rig.wire.from_plc:
            ends[address].receive(datagram, rig.t_mono_ns)
            heard[address] += 1
        rig.wire.from_plc.clear()
    assert (holder.linked, second.linked) == (True, False)
    assert second.other_pc == second.last_reject
    assert second.other_pc.startswith("another PC holds the PLC's session 0x00000005; end the server there")
    assert heard[PC] > 180
    assert heard["127.0.0.1", 40002] == pytest.approx(20, abs=2)  # one answer for each HELLO


def test_framing_by_name():
    assert isinstance(plc_framing("raw", "", ""), RawFraming)
    framing = plc_framing("eap", "192.168.0.10.1.1", "192.168.0.20.1.1")
    assert isinstance(framing, EapFraming)
    assert framing.own_publisher == bytes([192, 168, 0, 20, 1, 1])


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_preparation_and_afterwards_sets_a_flag(number: int) -> None:
    """At the first start the preparation compiles for a minute; nobody waits for its end."""
    before, order = signal.getsignal(number), []

    def prepare() -> None:
        with _StopFlag():
            try:
                signal.raise_signal(number)
                order.append("goes on")
            finally:
                signal.raise_signal(number)  # impatience does not keep what was created from being removed
                order.append("removed")

    with pytest.raises(SystemExit) as ending:
        prepare()
    assert (ending.value.code, order) == (128 + number, ["removed"])
    with _StopFlag() as stopped:
        stopped.prepared = True
        assert not stopped()
        signal.raise_signal(number)
        assert stopped()
    assert signal.getsignal(number) is before
