"""The link process's wishes: what ends them, and what does not. Its loop is turned by hand, against no PLC at all."""

import multiprocessing
import os
from dataclasses import replace

import pytest

from protocol.codec import decode_command, encode_state
from protocol.codes import LinkState, Mode, PlcState
from protocol.limits import limits_of
from protocol.messages import Command, State
from server.link import process as module
from server.link.contracts import ArmRequest, DisarmRequest, LinkRequest, ResetRequest, StopRequest
from server.link.process import LinkProcess
from server.link.settings import LinkSettings
from server.settings import read_machine

MS = 1_000_000


class Loop:
    """A LinkProcess and the states that it is fed with; its clock goes when told."""

    def __init__(self, monkeypatch):
        self.t_ns = 10_000 * MS
        monkeypatch.setattr(module, "mono_ns", lambda: self.t_ns)
        monkeypatch.setattr(module, "raise_priority", str)
        self.server, pipe = multiprocessing.Pipe()
        settings = LinkSettings(local_host="127.0.0.1", local_port=0)
        self.process = LinkProcess(pipe, settings, limits_of(read_machine("hiab033").joints), os.getppid())
        self.state = State(0, 0, 500_000 * MS, PlcState.LINKED, nonce=5, rx_ok=25, link_state=LinkState.FRESH)

    def close(self):
        self.process._udp.close()
        self.server.close()

    def ask(self, request: LinkRequest) -> None:
        self.process._request(request)

    def feed(self, **changes) -> None:
        """The next state, of the process's own session unless told otherwise."""
        newer = replace(self.state, seq=self.state.seq + 1, t_send_ns=self.state.t_send_ns + 10 * MS)
        self.state = replace(newer, session=self.process._link.session)
        self.state = replace(self.state, **changes)
        self.process._handle(self.process._link.receive(encode_state(self.state), self.t_ns), self.t_ns)

    def tick(self, ms: int = 20) -> Command:
        """Time goes on; the command that the loop would send now."""
        self.t_ns += ms * MS
        self.process._tick(self.t_ns, self.t_ns)  # sends nothing: no address is known
        datagram = self.process._link.send(self.t_ns)
        assert datagram is not None
        return decode_command(datagram)


@pytest.fixture
def loop(monkeypatch):
    made = Loop(monkeypatch)
    yield made
    made.close()


def test_a_stop_of_the_job_does_not_cancel_the_disarm_that_brought_it(loop):
    loop.feed(plc_state=PlcState.RUN)
    loop.ask(DisarmRequest())
    loop.ask(StopRequest("the job was cancelled"))
    stop = loop.tick()
    assert stop.mode is Mode.STOP
    loop.feed(plc_state=PlcState.STOPPING, ack_seq=stop.seq)
    loop.feed(plc_state=PlcState.HOLD)
    assert loop.tick().mode is Mode.DISARM


def test_a_lapse_or_a_stop_ends_the_wish_to_arm(loop):
    loop.feed()
    loop.ask(ArmRequest(valid_s=0.3))
    assert loop.tick().mode is Mode.ARM
    loop.tick(290)
    loop.feed()
    assert loop.tick().mode is Mode.HEARTBEAT  # lapsed
    loop.ask(ArmRequest())
    loop.ask(StopRequest("operator"))
    stop = loop.tick(100)
    loop.feed(ack_seq=stop.seq)
    assert loop.tick(100).mode is Mode.HEARTBEAT


def test_a_wish_to_reset_outlives_its_session_until_it_lapses(loop):
    loop.feed(plc_state=PlcState.FAULT)
    loop.ask(ResetRequest())
    assert loop.tick().mode is Mode.RESET
    first = loop.process._link
    loop.feed(session=0)  # the PLC has ended the session
    assert loop.process._link is not first
    loop.feed()
    assert loop.tick().mode is Mode.RESET
    for _ in range(16):
        loop.feed()
        loop.tick(200)
    loop.feed()
    assert loop.tick(100).mode is Mode.HEARTBEAT  # what comes later is not reset unseen


def test_a_reset_that_has_come_true_is_not_repeated_for_the_next_fault(loop):
    loop.feed(plc_state=PlcState.FAULT)
    loop.ask(ResetRequest())
    assert loop.tick().mode is Mode.RESET
    loop.feed(session=0, plc_state=PlcState.DISARMED)
    loop.feed(plc_state=PlcState.FAULT)
    assert loop.tick(120).mode is Mode.HEARTBEAT


def test_a_machine_that_was_armed_is_not_armed_again_when_its_session_ends(loop):
    loop.feed()
    loop.ask(ArmRequest())
    assert loop.tick().mode is Mode.ARM
    loop.feed(plc_state=PlcState.HOLD)
    loop.feed(session=0, plc_state=PlcState.DISARMED)
    loop.feed(plc_state=PlcState.LINKED)
    assert loop.tick(120).mode is Mode.HEARTBEAT
