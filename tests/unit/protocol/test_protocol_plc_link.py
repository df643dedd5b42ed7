"""The PLC's receive rules, one by one: what is refused feeds nothing and changes nothing."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.codec import decode_state, encode_command, encode_state
from protocol.codes import CommandFlag, Interp, LinkState, Mode, PlcState, RejectCode, WarnBit
from protocol.framing import RawFraming
from protocol.messages import Command, Knot, PlcStatus, State
from protocol.objection import Objection
from protocol.plc_events import CommandAccepted, CommandRejected, PlcAction, SessionOpened, SessionVoid, StateChanged
from protocol.plc_link import PlcLink, PlcLinkSettings
from protocol.plc_states import PlcEvent

MS = 1_000_000
CFG = 0xC0FFEE
PC = ("10.0.0.1", 50111)


class Bench:
    """A PlcLink and a PC made of one template command; time moves when told."""

    def __init__(self) -> None:
        nonces = iter(range(100, 10_000))
        self.verdict: Objection | None = None
        self.link = PlcLink(PlcLinkSettings(CFG), RawFraming(), lambda: next(nonces), lambda c, s: self.verdict)
        self.t_ns = 1000 * MS
        self.seq = 0
        self.link.apply(PlcEvent.BOOTED, self.t_ns)

    def state(self) -> State:
        return decode_state(self.link.send(PlcStatus(), self.t_ns))

    def command(self, mode: Mode = Mode.HEARTBEAT, **changes) -> Command:  # type: ignore[no-untyped-def]
        self.seq += 1
        command = Command(
            7,
            self.seq,
            555,
            mode,
            arm_nonce=self.link.nonce,
            ack_plc_seq=1,
            t_plc_echo_ns=self.t_ns - 15 * MS,
            cfg_id=CFG,
        )
        if mode in (Mode.TRAJECTORY, Mode.SERVO):
            command = replace(command, traj_id=1, interp=Interp.QUINTIC, knots=(Knot(0),), cmd_flags=CommandFlag.START)
        return replace(command, **changes)

    def give(self, command: Command, source: object = PC) -> list:  # type: ignore[type-arg]
        return self.link.receive(encode_command(command), self.t_ns, source)

    def send(self, mode: Mode = Mode.HEARTBEAT, source: object = PC, **changes) -> list:  # type: ignore[no-untyped-def, type-arg]
        return self.give(self.command(mode, **changes), source)

    def reach(self, state: PlcState) -> "Bench":
        if state is PlcState.DISARMED:
            return self
        if state is PlcState.LOCAL:
            self.link.apply(PlcEvent.LOCAL_ON, self.t_ns)
        self.send(hello=True)
        if state is PlcState.FAULT:
            self.link.apply(PlcEvent.FAULT, self.t_ns)
        if state in (PlcState.HOLD, PlcState.RUN, PlcState.STOPPING):
            for _ in range(25):
                self.send()
            self.send(Mode.ARM)
        if state in (PlcState.RUN, PlcState.STOPPING):
            self.send(Mode.TRAJECTORY)
        if state is PlcState.STOPPING:
            self.send(Mode.STOP)
        assert self.link.state is state
        return self

    def wait(self, ms: float) -> list:  # type: ignore[type-arg]
        self.t_ns += round(ms * MS)
        return self.link.poll(self.t_ns)

    def inner(self) -> tuple[object, ...]:
        return (self.link.state, self.link.session, self.link.nonce, self.link.peer, repr(self.link._session))


def code_of(events: list) -> RejectCode:  # type: ignore[type-arg]
    assert len(events) >= 1
    assert isinstance(events[0], CommandRejected)
    return events[0].code


def test_hello_opens_a_session_and_pins_its_source() -> None:
    bench = Bench()
    assert bench.link.peer is None
    events = bench.send(hello=True)
    assert events == [SessionOpened(7, PC), StateChanged(PlcState.DISARMED, PlcState.LINKED, PlcEvent.HELLO)]
    assert bench.link.peer == PC
    state = bench.state()
    assert (state.session, state.seq, state.plc_state, state.ack_seq) == (7, 1, PlcState.LINKED, 1)
    assert (state.t_pc_echo_ns, state.link_state, state.cfg_id) == (555, LinkState.FRESH, CFG)


@pytest.mark.parametrize("state", list(PlcState))
@pytest.mark.parametrize("mode", list(Mode))
def test_every_mode_in_every_state(state: PlcState, mode: Mode) -> None:
    if state is PlcState.BOOT:
        link = PlcLink(PlcLinkSettings(CFG), RawFraming(), lambda: 1)
        events = link.receive(encode_command(Command(7, 1, 1, mode, hello=True, cfg_id=CFG)), MS, PC)
        assert (code_of(events), link.state) == (RejectCode.MODE_ILLEGAL, PlcState.BOOT)
        return
    bench = Bench().reach(state)
    events = bench.send(mode)
    allowed = {
        PlcState.DISARMED: {},
        PlcState.LINKED: {Mode.HEARTBEAT: state, Mode.HOLD: state, Mode.STOP: state, Mode.QUICK_STOP: state},
        PlcState.HOLD: {m: state for m in (Mode.HEARTBEAT, Mode.ARM, Mode.HOLD, Mode.STOP, Mode.QUICK_STOP)}
        | {Mode.TRAJECTORY: PlcState.RUN, Mode.SERVO: PlcState.RUN, Mode.DISARM: PlcState.DISARMED},
        PlcState.RUN: {
            Mode.HEARTBEAT: state,
            Mode.TRAJECTORY: state,
        }  # it runs a trajectory: SERVO with its number is wrong
        | {m: PlcState.STOPPING for m in (Mode.HOLD, Mode.STOP, Mode.QUICK_STOP, Mode.DISARM)},
        PlcState.STOPPING: {
            m: state for m in (Mode.HEARTBEAT, Mode.HOLD, Mode.TRAJECTORY, Mode.STOP, Mode.QUICK_STOP, Mode.DISARM)
        },
        PlcState.FAULT: {m: state for m in (Mode.HEARTBEAT, Mode.HOLD, Mode.STOP, Mode.QUICK_STOP, Mode.DISARM)}
        | {Mode.RESET: PlcState.DISARMED},
        PlcState.LOCAL: {m: state for m in (Mode.HEARTBEAT, Mode.HOLD, Mode.STOP, Mode.QUICK_STOP, Mode.DISARM)},
    }[state]
    if state is PlcState.LINKED:
        allowed = allowed | {Mode.DISARM: PlcState.DISARMED}
    if mode in allowed:
        assert any(isinstance(event, CommandAccepted) for event in events)
        assert bench.link.state is allowed[mode]
    else:
        expected = {PlcState.DISARMED: RejectCode.SESSION}.get(state, RejectCode.MODE_ILLEGAL)
        if (state, mode) == (PlcState.LINKED, Mode.ARM):
            expected = RejectCode.LINK_NOT_PROVEN
        assert code_of(events) is expected
        assert bench.link.state is state


@pytest.mark.parametrize(
    ("changes", "source", "code"),
    [
        ({"session": 8}, PC, RejectCode.SESSION),
        ({"session": 8, "hello": True}, PC, RejectCode.SESSION),
        ({}, ("10.0.0.9", 1), RejectCode.SOURCE),
        ({"seq": 5000}, PC, RejectCode.SEQ_JUMP),
        ({"t_plc_echo_ns": 0}, PC, RejectCode.ECHO_STALE),
        ({"t_plc_echo_ns": 2**63}, PC, RejectCode.ECHO_STALE),
        ({"cfg_id": 1}, PC, RejectCode.CFG),
        ({"mode": Mode.RESET}, PC, RejectCode.MODE_ILLEGAL),
        ({"mode": Mode.SERVO, "traj_id": 1, "cfg_id": 1}, PC, RejectCode.CFG),
        ({"mode": Mode.ARM, "arm_nonce": 1}, PC, RejectCode.NONCE),
        ({"mode": Mode.TRAJECTORY, "traj_id": 0}, PC, RejectCode.TRAJ_ID),
    ],
)
def test_a_refusal_has_its_code_and_changes_nothing(changes: dict, source: object, code: RejectCode) -> None:  # type: ignore[type-arg]
    bench = Bench().reach(PlcState.HOLD)
    bench.wait(30)
    before = bench.inner()
    command = replace(bench.command(), **changes)
    assert code_of(bench.give(command, source)) is code
    assert bench.inner() == before
    state = bench.state()
    assert (state.reject_code, state.reject_count, state.reject_seq) == (code, 1, command.seq)
    assert state.rx_age_us == 30_000  # us: only an accepted command feeds the watchdog


def test_the_logics_own_check_has_the_last_word() -> None:
    bench = Bench().reach(PlcState.HOLD)
    bench.verdict = Objection(RejectCode.LIMIT_Q, 88)
    before = bench.inner()
    assert code_of(bench.send(Mode.TRAJECTORY)) is RejectCode.LIMIT_Q
    assert bench.inner() == before


def test_duplicates_and_late_ones_feed_nothing() -> None:
    bench = Bench().reach(PlcState.HOLD)
    first, second = bench.command(), bench.command()
    bench.give(second)
    bench.wait(50)
    assert bench.give(second) == []
    assert bench.give(first) == []
    state = bench.state()
    assert (state.rx_dup, state.rx_late, state.rx_lost, state.rx_age_us) == (1, 1, 1, 50_000)


@pytest.mark.parametrize("mode", [Mode.STOP, Mode.QUICK_STOP, Mode.DISARM])
def test_a_stop_is_taken_even_from_a_blind_pc_with_other_limits(mode: Mode) -> None:
    bench = Bench().reach(PlcState.RUN)
    bench.verdict = Objection(RejectCode.LIMIT_Q, 88)
    events = bench.send(mode, t_plc_echo_ns=0, cfg_id=1)
    assert isinstance(events[-1], CommandAccepted)
    assert bench.link.state is PlcState.STOPPING


def test_a_pc_that_has_gone_blind_is_stopped() -> None:
    bench = Bench().reach(PlcState.RUN)
    bench.t_ns += 500 * MS
    events = bench.send(Mode.TRAJECTORY, t_plc_echo_ns=bench.t_ns - 251 * MS)
    assert code_of(events) is RejectCode.ECHO_STALE
    assert bench.link.state is PlcState.STOPPING


def test_arming_needs_25_good_commands_and_the_present_nonce() -> None:
    bench = Bench().reach(PlcState.LINKED)
    for _ in range(23):
        bench.send()
    assert code_of(bench.send(Mode.ARM)) is RejectCode.LINK_NOT_PROVEN
    bench.send()
    assert code_of(bench.send(Mode.ARM, arm_nonce=bench.link.nonce + 1)) is RejectCode.NONCE
    events = bench.send(Mode.ARM)
    assert events[0] == StateChanged(PlcState.LINKED, PlcState.HOLD, PlcEvent.ARM)
    assert events[1].effect is PlcAction.ARM


def test_silence_warns_stops_and_ends_the_session() -> None:
    bench = Bench().reach(PlcState.RUN)
    assert bench.wait(100) == []
    assert bench.state().warn_bits == 0
    assert bench.wait(1) == []
    assert bench.state().warn_bits == WarnBit.LINK_LATE
    assert bench.wait(149) == []
    assert bench.link.state is PlcState.RUN
    assert bench.wait(0.001) == [StateChanged(PlcState.RUN, PlcState.STOPPING, PlcEvent.SOFT_STOP)]
    assert bench.state().link_state is LinkState.LOST
    assert bench.wait(1) == []  # tripped once, not every cycle
    bench.link.apply(PlcEvent.AT_REST, bench.t_ns)
    nonce = bench.link.nonce
    assert bench.wait(748) == []
    assert bench.wait(2) == [
        StateChanged(PlcState.HOLD, PlcState.DISARMED, PlcEvent.VOID),
        SessionVoid(7, "silence > 1 s"),
    ]
    state = bench.state()
    assert (state.session, state.wd_trips, state.link_state) == (0, 1, LinkState.NO_SESSION)
    assert bench.link.nonce not in (0, nonce)
    assert bench.link.peer == PC  # still told


def test_a_ramp_still_under_way_keeps_its_session_until_rest() -> None:
    bench = Bench().reach(PlcState.STOPPING)
    bench.wait(1500)
    assert (bench.link.state, bench.link.session) == (PlcState.STOPPING, 7)
    bench.link.apply(PlcEvent.AT_REST, bench.t_ns)
    bench.wait(1)
    assert (bench.link.state, bench.link.session) == (PlcState.DISARMED, 0)


def test_the_pc_may_ask_for_a_shorter_timeout_never_for_a_longer() -> None:
    for asked_ms, trips_ms in ((120, 120), (10, 100), (5000, 250), (0, 250)):
        bench = Bench().reach(PlcState.RUN)
        bench.send(Mode.TRAJECTORY, timeout_us=asked_ms * 1000)
        bench.wait(trips_ms)
        assert bench.link.state is PlcState.RUN
        bench.wait(0.01)
        assert bench.link.state is PlcState.STOPPING


def test_motion_never_resumes_by_itself() -> None:
    bench = Bench().reach(PlcState.RUN)
    bench.wait(251)
    bench.link.apply(PlcEvent.AT_REST, bench.t_ns)
    events = bench.send(Mode.TRAJECTORY)  # the PC is back and goes on as if nothing had been
    assert events == [CommandAccepted(events[0].command, PlcAction.KEEPALIVE)]
    assert bench.link.state is PlcState.HOLD
    assert code_of(bench.send(Mode.TRAJECTORY, traj_id=0)) is RejectCode.TRAJ_ID
    events = bench.send(Mode.TRAJECTORY, traj_id=2)
    assert [type(event) for event in events] == [StateChanged, CommandAccepted]
    assert bench.link.state is PlcState.RUN
    assert code_of(bench.send(Mode.TRAJECTORY, traj_id=1)) is RejectCode.TRAJ_ID


def test_a_prefilled_trajectory_is_void_after_silence_too() -> None:
    bench = Bench().reach(PlcState.HOLD)
    assert bench.send(Mode.TRAJECTORY, cmd_flags=CommandFlag(0))[0].effect is PlcAction.LOAD
    bench.wait(251)
    assert bench.send(Mode.TRAJECTORY)[0].effect is PlcAction.KEEPALIVE
    assert bench.link.state is PlcState.HOLD


@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.STOP, Mode.QUICK_STOP])
@pytest.mark.parametrize("motion", [Mode.TRAJECTORY, Mode.SERVO])
def test_a_prefilled_motion_is_void_after_a_stop_too(mode: Mode, motion: Mode) -> None:
    bench = Bench().reach(PlcState.HOLD)
    bench.send(motion, cmd_flags=CommandFlag(0))
    bench.send(mode)
    assert bench.link.state is PlcState.HOLD
    assert bench.send(motion)[0].effect is PlcAction.KEEPALIVE
    assert bench.link.state is PlcState.HOLD
    bench.send(motion, traj_id=2)
    assert bench.link.state is PlcState.RUN


def test_another_trajectory_while_one_runs_stops_and_starts_nothing() -> None:
    bench = Bench().reach(PlcState.RUN)
    events = bench.send(Mode.TRAJECTORY, traj_id=2)
    assert events[0] == StateChanged(PlcState.RUN, PlcState.STOPPING, PlcEvent.SOFT_STOP)
    assert events[1].effect is PlcAction.KEEPALIVE


def test_a_replayed_old_session_cannot_arm() -> None:
    bench = Bench()
    recorded = [bench.command(hello=True), *(bench.command() for _ in range(30)), bench.command(Mode.ARM)]
    for command in recorded:
        bench.give(command)
    assert bench.link.state is PlcState.HOLD
    bench.wait(1001)
    assert bench.link.state is PlcState.DISARMED
    for command in recorded:  # an hour later, from the same address
        bench.give(command)
    assert bench.link.state is PlcState.LINKED


def test_no_take_over_but_a_restarted_pc_gets_in_after_a_second() -> None:
    bench = Bench().reach(PlcState.HOLD)
    assert code_of(bench.send(hello=True, session=9, source=("10.0.0.1", 6))) is RejectCode.SESSION
    assert bench.link.peer == PC
    bench.wait(1001)
    bench.send(hello=True, session=9, source=("10.0.0.1", 6))
    assert (bench.link.session, bench.link.state, bench.link.peer) == (9, PlcState.LINKED, ("10.0.0.1", 6))


def test_a_refused_sender_gets_the_next_state_once_beside_the_peer() -> None:
    other, hello = ("10.0.0.1", 6), Command(9, 1, 1, hello=True, cfg_id=CFG)
    old = bytearray(encode_command(hello))
    old[4] += 1  # ver_major
    bench = Bench()
    bench.link.receive(bytes(old), bench.t_ns, other)
    assert bench.link.receivers() == [other]  # while nobody is in session
    assert bench.state().reject_code == RejectCode.VERSION
    bench.reach(PlcState.HOLD)
    inner = bench.inner()
    bench.give(hello, other)
    assert bench.inner() == inner
    assert (bench.link.receivers(), bench.link.receivers()) == ([PC, other], [PC])
    assert (bench.state().session, bench.state().reject_code) == (7, RejectCode.SESSION)
    bench.give(hello, PC)  # the peer hears it anyway
    not_worth_it = (encode_state(bench.state()), bytes(old[:567]), bytes(1304))  # two PLCs, a short one, no command
    for datagram in not_worth_it:
        bench.link.receive(datagram, bench.t_ns, other)
        assert bench.link.receivers() == [PC]


def test_a_hello_with_other_limits_is_told_why() -> None:
    bench = Bench()
    assert code_of(bench.send(hello=True, cfg_id=1)) is RejectCode.CFG
    assert (bench.link.session, bench.link.state, bench.link.peer) == (0, PlcState.DISARMED, PC)
    state = bench.state()
    assert (state.session, state.reject_code) == (0, RejectCode.CFG)


def test_reset_ends_the_session_so_that_hello_and_arm_are_needed() -> None:
    bench = Bench().reach(PlcState.FAULT)
    bench.verdict = Objection(RejectCode.FAULT_PRESENT, 88)
    assert code_of(bench.send(Mode.RESET)) is RejectCode.FAULT_PRESENT
    bench.verdict = None
    events = bench.send(Mode.RESET)
    assert [type(e) for e in events] == [StateChanged, SessionVoid, CommandAccepted]
    assert (bench.link.state, bench.link.session) == (PlcState.DISARMED, 0)


MODES = st.sampled_from(Mode)
STEPS = st.one_of(
    st.tuples(st.just("send"), MODES, st.integers(-3, 4), st.integers(0, 3)),
    st.tuples(st.just("wait"), st.sampled_from([1, 20, 90, 200, 400, 1100])),
    st.tuples(st.just("junk"), st.binary(max_size=40)),
)


@settings(max_examples=200, deadline=None)
@given(st.lists(STEPS, max_size=40))
def test_whatever_comes_without_arm_nothing_runs(steps: list) -> None:  # type: ignore[type-arg]
    """Any mix of commands, silence and junk: never an exception, and RUN only through ARM and a start."""
    bench = Bench().reach(PlcState.LINKED)
    armed = False
    for step in steps:
        events: list = []  # type: ignore[type-arg]
        if step[0] == "send":
            command = replace(bench.command(step[1]), traj_id=step[3])
            events = bench.give(replace(command, seq=max(0, command.seq + step[2])))
        elif step[0] == "wait":
            events = bench.wait(step[1])
        else:
            events = bench.link.receive(step[1], bench.t_ns, PC)
            assert isinstance(events[0], CommandRejected)
        for event in events:
            if isinstance(event, StateChanged):
                armed = event.new in (PlcState.HOLD, PlcState.RUN, PlcState.STOPPING)
                if event.new is PlcState.RUN:
                    assert event.old is PlcState.HOLD
                if event.old is PlcState.LINKED and armed:
                    assert event.event is PlcEvent.ARM
        assert armed == (bench.link.state in (PlcState.HOLD, PlcState.RUN, PlcState.STOPPING))
