"""The PC's end against states made by hand: what it sends, when it stops, and what it says."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.client_events import (
    ClientPhase,
    DatagramDropped,
    GateRefused,
    LinkClosed,
    RejectSeen,
    StateReceived,
    TrajectoryEnded,
)
from protocol.client_link import ClientLink
from protocol.codec import decode_command, encode_state
from protocol.codes import LinkState, Mode, PlcState, RejectCode
from protocol.framing import RawFraming
from protocol.limits import AxisLimits, LimitTable, cfg_id
from protocol.messages import ZEROS, Command, Knot, State

MS = 1_000_000
TABLE = LimitTable((AxisLimits("slew", -1.0, 1.0, 0.5, 2.0),))
KNOTS = tuple(Knot(i * 50 * MS) for i in range(20))


class Pc:
    """A ClientLink and the state it is fed with."""

    def __init__(self) -> None:
        self.link = ClientLink(TABLE, RawFraming(), session=7)
        self.t_ns = 10_000 * MS
        self.state = State(7, 0, 500_000 * MS, PlcState.LINKED, nonce=5, rx_ok=25, link_state=LinkState.FRESH)

    def feed(self, **changes) -> list:  # type: ignore[no-untyped-def, type-arg]
        state = replace(self.state, seq=self.state.seq + 1, t_send_ns=self.state.t_send_ns + 10 * MS)
        self.state = replace(state, **changes)
        self.t_ns += 10 * MS
        return self.link.receive(encode_state(self.state), self.t_ns)

    def next(self) -> Command:
        datagram = self.link.send(self.t_ns)
        assert datagram is not None
        return decode_command(datagram)

    def holding(self) -> "Pc":
        self.feed(plc_state=PlcState.HOLD)
        return self

    def running(self) -> "Pc":
        self.holding()
        assert self.link.request_run(1, KNOTS, self.t_ns) == ()
        self.next()
        self.feed(plc_state=PlcState.RUN, traj_id=1, knot_last=5)
        return self

    def wait(self, ms: float) -> list:  # type: ignore[type-arg]
        self.t_ns += round(ms * MS)
        return self.link.poll(self.t_ns)


def test_hello_every_100_ms_until_the_plc_answers() -> None:
    pc = Pc()
    hello = pc.next()
    assert (hello.hello, hello.session, hello.seq, hello.cfg_id) == (True, 7, 1, cfg_id(TABLE))
    pc.t_ns += 99 * MS
    assert pc.link.send(pc.t_ns) is None
    pc.t_ns += MS
    assert pc.next().seq == 2
    assert pc.link.phase(pc.t_ns) is ClientPhase.OFFLINE
    pc.feed(session=0, plc_state=PlcState.DISARMED)
    assert pc.link.phase(pc.t_ns) is ClientPhase.DISARMED
    pc.feed(session=7, plc_state=PlcState.LINKED)
    assert pc.link.phase(pc.t_ns) is ClientPhase.LINKED
    heartbeat = pc.next()
    assert (heartbeat.mode, heartbeat.hello) == (Mode.HEARTBEAT, False)
    assert (heartbeat.ack_plc_seq, heartbeat.t_plc_echo_ns) == (pc.state.seq, pc.state.t_send_ns)


def test_arm_waits_for_a_proven_link_and_echoes_the_nonce() -> None:
    pc = Pc()
    pc.feed(rx_ok=24)
    pc.link.request_arm()
    assert pc.next().mode is Mode.HEARTBEAT
    pc.feed(rx_ok=25)
    command = pc.next()
    assert (command.mode, command.arm_nonce) == (Mode.ARM, 5)
    pc.link.cancel_request()
    assert pc.next().mode is Mode.HEARTBEAT
    pc.link.request_arm()
    pc.feed(plc_state=PlcState.HOLD)
    pc.feed(plc_state=PlcState.LINKED)
    assert pc.next().mode is Mode.HEARTBEAT  # the wish was fulfilled; it is not repeated


def test_reset_only_in_fault_and_disarm_until_the_session_is_gone() -> None:
    pc = Pc().holding()
    pc.link.request_reset()
    assert pc.next().mode is Mode.HEARTBEAT
    pc.feed(plc_state=PlcState.FAULT)
    pc.link.request_reset()
    assert pc.next().mode is Mode.RESET
    assert pc.link.phase(pc.t_ns) is ClientPhase.FAULT
    pc.feed(plc_state=PlcState.HOLD)
    pc.link.request_disarm()
    assert pc.next().mode is Mode.DISARM
    assert pc.feed(session=0, plc_state=PlcState.DISARMED)[-1] == LinkClosed("disarmed")
    assert pc.link.send(pc.t_ns) is None
    assert pc.feed() == []


def test_reset_is_asked_for_ten_times_a_second_with_heartbeats_in_between() -> None:
    """A refused RESET feeds no watchdog: the session must outlive a fault whose cause is still there."""
    pc = Pc()
    pc.feed(plc_state=PlcState.FAULT)
    pc.link.request_reset()
    sent = []
    for _ in range(50):
        sent.append(pc.next().mode)
        pc.feed()
        pc.feed()
    assert sent == 10 * [Mode.RESET, *4 * [Mode.HEARTBEAT]]


def test_a_stop_comes_before_a_disarm_and_does_not_replace_it() -> None:
    pc = Pc().running()
    pc.link.request_disarm()
    pc.link.cancel_request()  # as every stop does, so that nothing arms or resets after it
    pc.link.request_stop("the job was cancelled")
    stop = pc.next()
    assert stop.mode is Mode.STOP
    pc.feed(plc_state=PlcState.STOPPING, ack_seq=stop.seq)
    pc.feed(plc_state=PlcState.HOLD)
    assert pc.next().mode is Mode.DISARM


def test_a_disarm_outlives_a_gap_in_the_states() -> None:
    pc = Pc().holding()
    pc.wait(251)
    pc.link.request_disarm()
    assert pc.next().mode is Mode.STOP
    pc.wait(600)
    pc.feed()
    assert pc.next().mode is Mode.DISARM


def test_states_are_taken_once_and_in_order() -> None:
    pc = Pc().holding()
    datagram = encode_state(pc.state)
    pc.feed()
    assert pc.link.receive(datagram, pc.t_ns) == []  # late
    assert pc.link.receive(encode_state(pc.state), pc.t_ns) == []  # twice
    pc.feed(seq=pc.state.seq + 4)
    assert (pc.link.counters.lost, pc.link.counters.duplicate_or_late) == (3, 2)
    far = pc.feed(seq=pc.state.seq + 5000)
    assert far == [DatagramDropped(RejectCode.SEQ_JUMP, far[0].text)]


def test_a_late_state_from_before_the_session_does_not_end_it() -> None:
    pc = Pc()
    early = encode_state(replace(pc.state, session=0, plc_state=PlcState.DISARMED))
    pc.holding()
    assert pc.link.receive(early, pc.t_ns) == []
    assert not pc.link.closed


def test_a_plc_that_was_switched_off_and_on_is_seen_again_although_its_clock_began_anew() -> None:
    pc = Pc()
    pc.feed(session=0, plc_state=PlcState.FAULT)
    assert pc.link.phase(pc.t_ns) is ClientPhase.FAULT
    late = replace(pc.state, t_send_ns=5 * MS)
    assert pc.link.receive(encode_state(late), pc.t_ns + 250 * MS) == []
    pc.wait(30_000)
    assert pc.link.phase(pc.t_ns) is ClientPhase.OFFLINE
    pc.state = replace(pc.state, seq=0, t_send_ns=0)
    assert isinstance(pc.feed(session=0, plc_state=PlcState.DISARMED)[0], StateReceived)
    assert pc.link.phase(pc.t_ns) is ClientPhase.DISARMED


def test_without_states_first_no_knots_then_a_stop_then_the_end() -> None:
    pc = Pc().running()
    assert pc.next().mode is Mode.TRAJECTORY
    pc.wait(100)
    assert pc.next().mode is Mode.TRAJECTORY
    pc.wait(1)
    assert pc.next().mode is Mode.HEARTBEAT
    pc.wait(149)
    assert pc.next().mode is Mode.HEARTBEAT
    pc.wait(1)
    assert pc.next().mode is Mode.STOP
    assert pc.link.phase(pc.t_ns) is ClientPhase.OFFLINE
    events = pc.wait(750)
    assert [type(event) for event in events] == [TrajectoryEnded, LinkClosed]
    assert not events[0].reached


def test_the_window_follows_what_the_plc_reports() -> None:
    pc = Pc().holding()
    pc.link.request_run(1, KNOTS, pc.t_ns)
    assert (pc.next().knot_first, pc.next().knot_first) == (0, 0)
    pc.feed(plc_state=PlcState.RUN, traj_id=1, knot_last=5)
    assert pc.next().knot_first == 6
    pc.feed(knot_last=11, knot_playing=1)
    assert pc.next().knot_first == 12
    pc.feed(knot_last=19, knot_playing=3)
    assert pc.next().knot_first == 3


def test_the_end_is_reached_only_when_all_was_played() -> None:
    pc = Pc().running()
    ended = pc.feed(plc_state=PlcState.HOLD, t_play_ns=KNOTS[-1].t_ns)[-1]
    assert ended == TrajectoryEnded(1, True, "reached", pc.state.t_send_ns)
    pc = Pc().running()
    ended = pc.feed(plc_state=PlcState.HOLD, t_play_ns=KNOTS[-1].t_ns - 1)[-1]
    assert not ended.reached
    assert "stopped by itself" in ended.reason


@pytest.mark.parametrize("state", [PlcState.FAULT, PlcState.LOCAL, PlcState.LINKED])
def test_leaving_the_armed_state_ends_the_motion(state: PlcState) -> None:
    pc = Pc().running()
    ended = pc.feed(plc_state=state)[-1]
    assert ended == TrajectoryEnded(1, False, f"PLC went to {state.name}", pc.state.t_send_ns)


def test_a_refusal_by_the_plc_is_quoted() -> None:
    pc = Pc().holding()
    pc.link.request_run(1, KNOTS, pc.t_ns)
    seq = pc.next().seq
    events = pc.feed(reject_code=RejectCode.LIMIT_Q, reject_count=1, reject_seq=seq)
    assert [type(event) for event in events] == [StateReceived, RejectSeen, TrajectoryEnded]
    assert "leaves the joint range" in events[-1].reason


@pytest.mark.parametrize("code", [RejectCode.SESSION, RejectCode.SOURCE])
def test_a_refusal_of_somebody_else_s_datagram_ends_nothing(code: RejectCode) -> None:
    """Another PC numbers its HELLOs, too, and may be far ahead of us."""
    refusal = {"reject_code": code, "reject_count": 1, "reject_seq": 36003}
    pc = Pc().holding()
    pc.link.request_run(1, KNOTS, pc.t_ns)
    pc.next()
    assert [type(event) for event in pc.feed(**refusal)] == [StateReceived, RejectSeen]
    pc.feed(plc_state=PlcState.RUN, traj_id=1, knot_last=5)
    assert pc.next().mode is Mode.TRAJECTORY
    assert "the PLC stopped by itself" in pc.feed(plc_state=PlcState.HOLD)[-1].reason


def test_a_motion_that_was_given_up_and_plays_all_the_same_is_stopped() -> None:
    pc = Pc().holding()
    pc.link.request_run(1, KNOTS, pc.t_ns)
    seq = pc.next().seq
    assert isinstance(pc.feed(reject_code=RejectCode.LIMIT_Q, reject_count=1, reject_seq=seq)[-1], TrajectoryEnded)
    pc.feed(plc_state=PlcState.RUN, traj_id=1, knot_last=5)  # the START before it had been taken
    stop = pc.next()
    assert stop.mode is Mode.STOP
    assert pc.link.busy
    pc.feed(plc_state=PlcState.STOPPING, traj_id=1, ack_seq=stop.seq)
    pc.feed(plc_state=PlcState.HOLD)
    assert pc.next().mode is Mode.HEARTBEAT
    assert not pc.link.busy


def test_a_start_that_never_comes_is_given_up_with_a_stop() -> None:
    pc = Pc().holding()
    pc.link.request_run(1, KNOTS, pc.t_ns)
    for _ in range(102):
        pc.next()
        pc.feed()
        pc.link.poll(pc.t_ns)
    assert pc.next().mode is Mode.STOP
    ended = pc.feed(ack_seq=pc.link._seq)[-1]
    assert not ended.reached
    assert "did not start" in ended.reason


def test_the_gate_stops_what_the_planner_let_through() -> None:
    pc = Pc().holding()
    pc.link.request_run(1, KNOTS, pc.t_ns)
    pc.feed(q_ref=(0.1, *ZEROS[1:]))  # the reference has moved since the request
    assert pc.next().mode is Mode.STOP
    events = pc.wait(0)
    assert isinstance(events[0], GateRefused)
    assert "plan from q_ref" in events[0].text
    ended = pc.feed(ack_seq=pc.link._seq)[-1]
    assert ended.reason.startswith("motion gate")


def test_another_session_at_the_plc_is_seen_but_not_ours() -> None:
    pc = Pc()
    pc.feed(session=99, plc_state=PlcState.RUN, reject_code=RejectCode.SESSION, reject_count=1)
    assert pc.link.phase(pc.t_ns) is ClientPhase.DISARMED
    assert "another PC holds the PLC's session 0x00000063" in pc.link.last_reject == pc.link.other_pc
    assert not pc.link.linked


def test_a_pc_that_wants_the_session_is_named_as_such_and_no_command_of_ours_is_blamed() -> None:
    pc = Pc().holding()
    assert pc.link.other_pc == ""
    refused = {"reject_code": RejectCode.SESSION, "reject_count": 1, "reject_seq": pc.link._seq, "reject_offset": 16}
    event = pc.feed(**refused)[-1]
    assert event.text == pc.link.other_pc
    assert event.text.startswith("another PC asks for the PLC's session, which this one holds (0x")
    pc.feed(reject_code=RejectCode.LIMIT_Q, reject_count=2)
    assert pc.link.other_pc == ""


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=700))
def test_any_bytes_give_a_dropped_event(data: bytes) -> None:
    pc = Pc()
    assert isinstance(pc.link.receive(data, pc.t_ns)[0], DatagramDropped)
