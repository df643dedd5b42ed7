"""Both ends of the link in virtual time, through a channel that loses, doubles, delays, reorders. No sockets."""

import heapq
import random
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest
from link_toy_plc import MS, RAMP_NS, TABLE, ToyPlc, smooth_knots

from protocol.client_events import ClientPhase, LinkClosed, RejectSeen, StateReceived, TrajectoryEnded
from protocol.client_link import ClientLink
from protocol.codes import PlcState
from protocol.errors import LocalProtocolError
from protocol.framing import EapFraming, RawFraming
from protocol.messages import ZEROS, Axes
from protocol.plc_events import StateChanged

GOAL: Axes = (0.4, -0.3, 0.2, *ZEROS[3:])
IDS = ("10.0.0.1.1.1", "10.0.0.2.1.1")


@dataclass(frozen=True)
class Channel:
    """What happens to datagrams: fractions, delay range [ms], and a one-way cut as (direction, from_ms, to_ms)."""

    loss: float = 0.0
    duplicate: float = 0.0
    corrupt: float = 0.0
    delay_ms: tuple[float, float] = (0.2, 0.4)
    cuts: tuple[tuple[str, float, float], ...] = ()


@dataclass
class Loop:
    """PC and PLC with clocks 1000 s apart, milliseconds of virtual time."""

    channel: Channel = Channel()
    seed: int = 0
    eap: bool = False
    t_ns: int = 0
    events: list = field(default_factory=list)  # type: ignore[type-arg]
    phases: list[ClientPhase] = field(default_factory=list)
    sessions: int = 0
    pc_alive: bool = True

    def __post_init__(self) -> None:
        self.rng = random.Random(self.seed)
        self.plc = ToyPlc(TABLE, EapFraming.for_plc(*IDS) if self.eap else RawFraming())
        self.flying: list[tuple[int, int, str, bytes]] = []
        self.count = 0
        self.connect()

    def connect(self) -> None:
        self.sessions += 1
        self.pc = ClientLink(TABLE, EapFraming.for_client(*IDS) if self.eap else RawFraming(), 1000 + self.sessions)

    def plc_ns(self, t_ns: int) -> int:
        return t_ns + 1_000_000 * MS

    def post(self, way: str, datagram: bytes) -> None:
        channel, rng = self.channel, self.rng
        cut = any(way == w and a <= self.t_ns / MS < b for w, a, b in channel.cuts)
        for _ in range(2 if rng.random() < channel.duplicate else 1):
            if cut or rng.random() < channel.loss:
                continue
            if rng.random() < channel.corrupt:
                broken = bytearray(datagram)
                broken[rng.randrange(len(broken))] ^= 1 << rng.randrange(8)
                datagram = bytes(broken)
            self.count += 1
            arrival_ns = self.t_ns + round(rng.uniform(*channel.delay_ms) * MS)
            heapq.heappush(self.flying, (arrival_ns, self.count, way, datagram))

    def step(self) -> None:
        """One millisecond."""
        self.t_ns += MS
        while self.flying and self.flying[0][0] <= self.t_ns:
            arrival_ns, _, way, datagram = heapq.heappop(self.flying)
            if way == "to_plc":
                self.plc.receive(datagram, self.plc_ns(self.t_ns))
            elif self.pc_alive:
                self.note(self.pc.receive(datagram, arrival_ns))
        for datagram, _ in self.plc.cycle(self.plc_ns(self.t_ns)):
            self.post("to_pc", datagram)
        if self.pc_alive and self.t_ns % (20 * MS) == 0:
            self.note(self.pc.poll(self.t_ns))
            datagram = self.pc.send(self.t_ns)
            if datagram:
                self.post("to_plc", datagram)
            self.phases.append(self.pc.phase(self.t_ns))

    def note(self, events: list) -> None:  # type: ignore[type-arg]
        self.events += [event for event in events if not isinstance(event, StateReceived)]
        if any(isinstance(event, LinkClosed) for event in events):
            self.connect()

    def until(self, wanted: Callable[[], bool], within_s: float) -> bool:
        end_ns = self.t_ns + round(within_s * 1e9)
        while self.t_ns < end_ns:
            if wanted():
                return True
            self.step()
        return wanted()

    def armed(self) -> "Loop":
        assert self.until(lambda: self.pc.phase(self.t_ns) is ClientPhase.LINKED, 5)
        self.pc.request_arm()
        assert self.until(lambda: self.pc.phase(self.t_ns) is ClientPhase.ARMED, 5)
        return self

    def run(self, goal: Axes = GOAL, duration_s: float = 3.0, traj_id: int = 1) -> "Loop":
        assert self.pc.state is not None
        knots = smooth_knots(self.pc.state.q_ref, goal, duration_s)
        assert self.pc.request_run(traj_id, knots, self.t_ns) == ()
        return self

    def ended(self, within_s: float) -> TrajectoryEnded:
        def found() -> list[TrajectoryEnded]:
            return [event for event in self.events if isinstance(event, TrajectoryEnded)]

        assert self.until(lambda: bool(found()), within_s)
        assert len(found()) == 1
        return found()[0]

    def moves(self) -> list[tuple[PlcState, PlcState]]:
        return [(e.old, e.new) for e in self.plc.events if isinstance(e, StateChanged)]


@pytest.mark.parametrize("eap", [False, True])
def test_hello_arm_run_reach(eap: bool) -> None:
    loop = Loop(eap=eap).armed()
    assert loop.t_ns < 1000 * MS  # half a second of good commands and a bit
    ended = loop.run().ended(within_s=4)
    assert (ended.traj_id, ended.reached, ended.reason) == (1, True, "reached")
    assert loop.plc.q_ref == GOAL
    assert loop.pc.clock_offset.offset_ns is not None
    assert abs(loop.pc.clock_offset.offset_ns + 1_000_000 * MS) < 1 * MS
    assert loop.pc.phase(loop.t_ns) is ClientPhase.ARMED


def test_a_second_trajectory_starts_where_the_first_ended() -> None:
    loop = Loop().armed()
    loop.run().ended(4)
    loop.events.clear()
    assert loop.run(ZEROS, traj_id=2).ended(4).reached
    assert loop.plc.q_ref == ZEROS


def undisturbed() -> dict[int, Axes]:
    loop = Loop().armed()
    loop.run().ended(4)
    return dict(loop.plc.track)


@pytest.mark.parametrize("seed", range(10))
def test_under_heavy_loss_the_reference_is_bit_identical(seed: int) -> None:
    channel = Channel(loss=0.3, duplicate=0.1, corrupt=0.02, delay_ms=(0.2, 35.0))
    loop = Loop(channel, seed).armed()
    ended = loop.run().ended(within_s=6)
    assert ended.reached, ended.reason
    clean = undisturbed()
    assert dict(loop.plc.track) == clean
    assert loop.plc.link._counters.watchdog_trips == 0


def test_ten_lost_commands_in_a_row_cost_nothing() -> None:
    loop = Loop().armed().run()
    start_ms = loop.t_ns / MS
    cuts = tuple(("to_plc", start_ms + at, start_ms + at + 200) for at in (100, 700, 1500, 2300))
    loop.channel = Channel(cuts=cuts)
    assert loop.ended(6).reached
    assert dict(loop.plc.track) == undisturbed()


def test_killed_pc_means_a_ramp_within_its_bound_and_no_motion_after() -> None:
    loop = Loop().armed().run()
    loop.until(lambda: loop.plc.link.state is PlcState.RUN, 1)
    loop.until(lambda: False, 0.8)
    loop.pc_alive = False
    killed_ns = loop.t_ns
    assert loop.until(lambda: loop.plc.link.state is PlcState.STOPPING, 1)
    assert loop.t_ns - killed_ns <= 260 * MS
    assert loop.until(lambda: loop.plc.link.state is PlcState.HOLD, 1)
    assert loop.t_ns - killed_ns <= 260 * MS + RAMP_NS + 2 * MS
    assert loop.until(lambda: loop.plc.link.state is PlcState.DISARMED, 1.5)
    loop.connect()
    loop.pc_alive = True
    assert loop.until(lambda: loop.pc.phase(loop.t_ns) is ClientPhase.LINKED, 2)
    loop.until(lambda: False, 2.0)
    assert loop.plc.link.state is PlcState.LINKED  # not armed, not moving


def test_a_pc_that_hears_nothing_stops_the_machine_and_says_so() -> None:
    loop = Loop().armed().run()
    loop.until(lambda: False, 0.5)
    loop.channel = Channel(cuts=(("to_pc", loop.t_ns / MS, 1e9),))
    cut_ns = loop.t_ns
    assert loop.until(lambda: loop.plc.link.state is PlcState.STOPPING, 1)
    assert loop.t_ns - cut_ns <= 300 * MS
    ended = loop.ended(2)
    assert not ended.reached
    assert "no state from the PLC" in ended.reason
    assert loop.phases[-1] is ClientPhase.OFFLINE


def test_a_short_cut_both_ways_stops_motion_which_does_not_resume() -> None:
    loop = Loop().armed().run()
    loop.until(lambda: False, 0.5)
    now_ms = loop.t_ns / MS
    loop.channel = Channel(cuts=(("to_pc", now_ms, now_ms + 400), ("to_plc", now_ms, now_ms + 400)))
    ended = loop.ended(3)
    assert not ended.reached
    loop.until(lambda: False, 2)
    assert loop.plc.link.state is PlcState.HOLD
    assert loop.moves().count((PlcState.HOLD, PlcState.RUN)) == 1


def test_stop_and_disarm() -> None:
    loop = Loop().armed().run()
    loop.until(lambda: False, 0.5)
    loop.pc.request_stop("operator")
    ended = loop.ended(1)
    assert (ended.reached, ended.reason) == (False, "operator")
    assert not loop.pc.busy
    loop.events.clear()
    loop.run(traj_id=2)
    loop.until(lambda: False, 0.3)
    loop.pc.request_disarm()
    assert loop.until(lambda: loop.plc.link.state is PlcState.DISARMED, 1)
    assert (PlcState.RUN, PlcState.STOPPING) in loop.moves()
    assert not loop.ended(1).reached
    assert loop.until(lambda: loop.pc.phase(loop.t_ns) is ClientPhase.LINKED, 1)  # new session, not armed


def test_a_stop_before_the_start_is_seen_still_ends_the_motion() -> None:
    loop = Loop(Channel(delay_ms=(60.0, 60.0))).armed().run()
    loop.pc.request_stop("changed my mind")
    ended = loop.ended(2)
    assert not ended.reached
    loop.until(lambda: False, 1)
    assert loop.plc.link.state is PlcState.HOLD
    assert loop.plc.track == []


def test_a_second_pc_is_refused_while_the_first_is_in_session() -> None:
    loop = Loop().armed()
    second = ClientLink(TABLE, RawFraming(), 4711)
    for _ in range(10):
        hello = second.send(loop.t_ns)
        if hello:
            loop.plc.receive(hello, loop.plc_ns(loop.t_ns), "other")
        loop.until(lambda: False, 0.05)
    assert loop.plc.link.session == loop.pc.session
    assert loop.pc.phase(loop.t_ns) is ClientPhase.ARMED


def test_an_idle_second_pc_that_counts_higher_ends_no_motion() -> None:
    loop = Loop().armed()
    second = ClientLink(TABLE, RawFraming(), 4711, _seq=36_000)
    loop.run()
    while not any(isinstance(event, TrajectoryEnded) for event in loop.events):
        hello = second.send(loop.t_ns)
        if hello:
            loop.plc.receive(hello, loop.plc_ns(loop.t_ns), "other")
        loop.step()
    assert loop.ended(0.0).reached
    assert any(isinstance(event, RejectSeen) for event in loop.events)  # it was seen, and passed over


def test_requests_that_make_no_sense_are_our_own_mistake() -> None:
    loop = Loop()
    loop.until(lambda: loop.pc.phase(loop.t_ns) is ClientPhase.LINKED, 2)
    knots = smooth_knots(ZEROS, GOAL, 3.0)
    with pytest.raises(LocalProtocolError, match="must be armed"):
        loop.pc.request_run(1, knots, loop.t_ns)
    loop.armed().run()
    with pytest.raises(LocalProtocolError, match="idle"):
        loop.pc.request_run(2, knots, loop.t_ns)
    fast = smooth_knots(ZEROS, GOAL, 0.5)
    loop.ended(4)
    assert loop.pc.request_run(3, fast, loop.t_ns)  # refusals
    assert not loop.pc.busy


def test_a_plc_that_refuses_the_start_is_quoted() -> None:
    loop = Loop().armed()
    knots = smooth_knots(ZEROS, GOAL, 3.0)
    loop.plc.q_ref = (1e-9, *ZEROS[1:])  # the toy wants exactly its reference; ours allows the tolerance
    assert loop.pc.request_run(1, knots, loop.t_ns) == ()
    ended = loop.ended(2)
    assert not ended.reached
    assert "START" in ended.reason


@pytest.mark.parametrize("seed", range(24))
def test_random_fault_schedules_never_move_an_unarmed_plc_and_always_end(seed: int) -> None:
    rng = random.Random(seed)
    cuts = tuple(
        (rng.choice(["to_pc", "to_plc"]), t := rng.uniform(0, 6000), t + rng.choice([50, 150, 300, 700, 1500]))
        for _ in range(4)
    )
    channel = Channel(
        rng.choice([0, 0.1, 0.4]), rng.choice([0, 0.2]), rng.choice([0, 0.05]), (0.2, rng.choice([0.5, 30, 80])), cuts
    )
    loop = Loop(channel, seed)
    traj_id = 0
    for _ in range(8):
        if loop.pc.phase(loop.t_ns) is ClientPhase.LINKED:
            loop.pc.request_arm()
        if loop.pc.phase(loop.t_ns) is ClientPhase.ARMED and not loop.pc.busy and loop.pc.state:
            traj_id += 1
            loop.pc.request_run(traj_id, smooth_knots(loop.pc.state.q_ref, GOAL, 3.0), loop.t_ns)
        loop.until(lambda: False, 1.0)
    for old, new in loop.moves():
        if new is PlcState.RUN:
            assert old is PlcState.HOLD
    starts = loop.moves().count((PlcState.HOLD, PlcState.RUN))
    assert starts <= traj_id  # every start was asked for, once
    ends = [event.traj_id for event in loop.events if isinstance(event, TrajectoryEnded)]
    assert len(ends) == len(set(ends))
    # silence always ends in DISARMED at rest
    loop.pc_alive = False
    loop.flying.clear()
    assert loop.until(lambda: loop.plc.link.state in (PlcState.DISARMED, PlcState.LINKED), 1.6)
    loop.until(lambda: False, 1.1)
    assert loop.plc.link.state is PlcState.DISARMED
    still = loop.plc.q_ref
    loop.until(lambda: False, 0.5)
    assert loop.plc.q_ref == still
