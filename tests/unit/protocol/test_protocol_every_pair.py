"""Every pair: PLC state and event, PLC state and mode over a fresh, late and lost link, client phase and input.

The grids are written down by hand from docs/plc-link.md; a dot means "taken, stays", a dash "has no place here".
"""

import re
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from protocol.client_events import ClientPhase, DatagramDropped, LinkClosed, StateReceived
from protocol.client_link import ClientLink
from protocol.codec import decode_command, decode_state, encode_command, encode_state
from protocol.codes import CommandFlag, Interp, LinkState, Mode, PlcState, RejectCode
from protocol.errors import IllegalTransitionError, LocalProtocolError
from protocol.framing import RawFraming
from protocol.limits import AxisLimits, LimitTable
from protocol.messages import ZEROS, Command, Knot, PlcStatus, State
from protocol.plc_events import CommandRejected
from protocol.plc_link import PlcLink, PlcLinkSettings
from protocol.plc_states import PlcEvent

MS = 1_000_000
CFG = 0xC0FFEE
PC = ("10.0.0.1", 50111)
LETTERS = {
    "B": PlcState.BOOT, "D": PlcState.DISARMED, "L": PlcState.LINKED, "H": PlcState.HOLD, "R": PlcState.RUN,
    "S": PlcState.STOPPING, "F": PlcState.FAULT, "O": PlcState.LOCAL,
}  # fmt: skip

# --- state x event ----------------------------------------------------------------------------------------------------

EVENTS = """
            BOOTED HELLO ARM START END SOFT_STOP QUICK_STOP AT_REST DISARM VOID FAULT RESET LOCAL_ON LOCAL_OFF
BOOT        D      -     -   -     -   -         -          -       -      -    F     -     -        -
DISARMED    -      L     -   -     -   -         -          -       -      -    F     -     O        -
LINKED      -      .     H   -     -   .         .          -       D      D    F     -     O        -
HOLD        -      -     .   R     -   .         .          .       D      D    F     -     O        -
RUN         -      -     -   -     H   S         S          -       S      S    F     -     O        -
STOPPING    -      -     -   -     -   .         .          H       .      .    F     -     O        -
FAULT       -      .     -   -     -   .         .          .       .      .    .     D     -        -
LOCAL       -      .     -   -     -   .         .          .       .      .    F     -     -        D
"""


def grid(text: str) -> dict[tuple[str, str], str]:
    """(row, column) -> cell."""
    head, *rows = text.strip("\n").splitlines()
    columns = head.split()
    cells: dict[tuple[str, str], str] = {}
    for row in rows:
        name, *values = row.split()
        cells |= {(name, column): value for column, value in zip(columns, values, strict=True)}
    return cells


def link_in(state: PlcState) -> PlcLink:
    link = PlcLink(PlcLinkSettings(CFG), RawFraming(), lambda: 55)
    link.state = state
    return link


def test_the_grid_of_events_has_every_pair() -> None:
    assert set(grid(EVENTS)) == {(s.name, e.name) for s, e in product(PlcState, PlcEvent)}


@pytest.mark.parametrize("state", list(PlcState))
@pytest.mark.parametrize("event", list(PlcEvent))
def test_every_state_with_every_event_in_the_link(state: PlcState, event: PlcEvent) -> None:
    cell, link = grid(EVENTS)[state.name, event.name], link_in(state)
    before = repr(link)
    if cell == "-":
        with pytest.raises(IllegalTransitionError, match=rf"{state.name}.*{event.name}"):
            link.apply(event, MS)
        assert repr(link) == before
        return
    events = link.apply(event, MS)
    assert link.state is (state if cell == "." else LETTERS[cell])
    assert bool(events) is (cell != ".")


def test_the_documented_diagram_shows_the_same() -> None:
    text = (Path(__file__).parents[3] / "docs" / "plc-link.md").read_text(encoding="utf-8")
    drawn = {
        (old, event, new)
        for old, new, names in re.findall(r"^    (\w+) --> (\w+): ([A-Z_, ]+)$", text, re.MULTILINE)
        for event in names.split(", ")
    }
    changes = {(s, e, LETTERS[cell].name) for (s, e), cell in grid(EVENTS).items() if cell not in "-."}
    assert drawn == changes


# --- state x mode x link ----------------------------------------------------------------------------------------------

# the letter of the next state; otherwise refused: m MODE_ILLEGAL, s SESSION
# TRAJECTORY and SERVO: with the number of the trajectory that is there (or 1); +: with the next number
MODES = """
          HELLO HEARTBEAT ARM HOLD TRAJECTORY SERVO TRAJECTORY+ SERVO+ STOP QUICK_STOP RESET DISARM
BOOT      m     s         s   s    s          s     s           s      s    s          s     s
DISARMED  L     s         s   s    s          s     s           s      s    s          s     s
LINKED    .     .         H   .    m          m     m           m      .    .          m     D
HOLD      .     .         .   .    R          R     R           R      .    .          m     D
RUN       .     .         m   S    .          m     S           S      S    S          m     S
STOPPING  .     .         m   .    .          m     .           .      .    .          m     .
FAULT     .     .         m   .    m          m     m           m      .    .          D     .
LOCAL     .     .         m   .    m          m     m           m      .    .          m     .
"""
REFUSED = {"m": RejectCode.MODE_ILLEGAL, "s": RejectCode.SESSION}
AGES_MS = {LinkState.FRESH: 100, LinkState.LATE: 101, LinkState.LOST: 251}


class Plc:
    """A PlcLink brought into a state, and the command that a PC would send it."""

    def __init__(self, state: PlcState) -> None:
        nonces = iter(range(100, 1000))
        self.link = PlcLink(PlcLinkSettings(CFG), RawFraming(), lambda: next(nonces))
        self.t_ns, self.seq = 1000 * MS, 0
        if state is PlcState.BOOT:
            return
        self.link.apply(PlcEvent.BOOTED, self.t_ns)
        if state is PlcState.DISARMED:
            return
        self.give("HELLO")
        if state is PlcState.FAULT:
            self.link.apply(PlcEvent.FAULT, self.t_ns)
        elif state is PlcState.LOCAL:
            self.link.apply(PlcEvent.LOCAL_ON, self.t_ns)
        for _ in range(24):
            self.give("HEARTBEAT")
        for name in {PlcState.HOLD: ("ARM",), PlcState.RUN: ("ARM", "TRAJECTORY")}.get(state, ()):
            self.give(name)
        if state is PlcState.STOPPING:
            for name in ("ARM", "TRAJECTORY", "STOP"):
                self.give(name)
        assert self.link.state is state

    def give(self, name: str) -> list[Any]:
        self.seq += 1
        mode = Mode.HEARTBEAT if name == "HELLO" else Mode[name.rstrip("+")]
        motion = mode in (Mode.TRAJECTORY, Mode.SERVO)
        command = Command(
            7, self.seq, 555, mode, hello=name == "HELLO", arm_nonce=self.link.nonce, ack_plc_seq=1,
            t_plc_echo_ns=self.t_ns - MS, cfg_id=CFG, traj_id=(2 if "+" in name else 1) if motion else 0,
            interp=Interp.QUINTIC if motion else Interp.NONE, knots=(Knot(0),) if motion else (),
            cmd_flags=CommandFlag.START if motion else CommandFlag(0),
        )  # fmt: skip
        return self.link.receive(encode_command(command), self.t_ns, PC)

    def seen(self) -> State:
        return decode_state(self.link.send(PlcStatus(), self.t_ns))


def test_the_grid_of_modes_has_every_pair() -> None:
    columns = {"HELLO", "TRAJECTORY+", "SERVO+", *(mode.name for mode in Mode)}
    assert set(grid(MODES)) == set(product((s.name for s in PlcState), columns))


@pytest.mark.parametrize("state", list(PlcState))
@pytest.mark.parametrize("link_state", list(AGES_MS))
def test_every_state_with_every_mode_over_every_link(state: PlcState, link_state: LinkState) -> None:
    for name in sorted({column for _, column in grid(MODES)}):
        plc = Plc(state)
        plc.t_ns += AGES_MS[link_state] * MS
        plc.link.poll(plc.t_ns)
        # a lost link has already ended the motion; everything else waits for the PC
        met = PlcState.STOPPING if (state, link_state) == (PlcState.RUN, LinkState.LOST) else state
        assert plc.link.state is met, name
        before = plc.seen()
        in_session = state not in (PlcState.BOOT, PlcState.DISARMED)
        assert before.link_state is (link_state if in_session else LinkState.NO_SESSION), name
        check_pair(plc, name, grid(MODES)[met.name, name], met, before)


def check_pair(plc: Plc, name: str, cell: str, met: PlcState, before: State) -> None:
    inside = repr(plc.link._session)
    events = plc.give(name)
    after = plc.seen()
    if cell in REFUSED:
        assert isinstance(events[0], CommandRejected), name
        assert (events[0].code, plc.link.state) == (REFUSED[cell], met), name
        assert repr(plc.link._session) == inside, name
        assert (after.link_state, after.rx_age_us, after.nonce) == (before.link_state, before.rx_age_us, before.nonce)
        assert (after.reject_code, after.reject_count) == (REFUSED[cell], before.reject_count + 1), name
        assert after.reject_offset == (16 if cell == "s" else 48), name
        return
    expected = met if cell == "." else LETTERS[cell]
    assert not isinstance(events[0], CommandRejected), (name, events)
    assert plc.link.state is expected, name
    assert after.reject_count == before.reject_count, name
    if expected is PlcState.DISARMED:
        assert (after.session, after.link_state) == (0, LinkState.NO_SESSION), name
    else:
        assert (after.session, after.link_state, after.rx_age_us) == (7, LinkState.FRESH, 0), name


# --- client phase x input ---------------------------------------------------------------------------------------------

TABLE = LimitTable((AxisLimits("slew", -1.0, 1.0, 0.5, 2.0),))
KNOTS = tuple(Knot(i * 50 * MS) for i in range(40))
STATES = {
    ClientPhase.LINKED: PlcState.LINKED, ClientPhase.ARMED: PlcState.HOLD, ClientPhase.FAULT: PlcState.FAULT,
    ClientPhase.LOCAL: PlcState.LOCAL,
}  # fmt: skip
PHASES = {
    PlcState.BOOT: "DISARMED", PlcState.DISARMED: "DISARMED", PlcState.LINKED: "LINKED", PlcState.HOLD: "ARMED",
    PlcState.RUN: "RUNNING", PlcState.STOPPING: "STOPPING", PlcState.FAULT: "FAULT", PlcState.LOCAL: "LOCAL",
}  # fmt: skip
OPEN = tuple(phase for phase in ClientPhase if phase not in (ClientPhase.OFFLINE, ClientPhase.DISARMED))

# what is sent after a request: h HELLO, a dot HEARTBEAT, otherwise the mode's letter; a dash: the request is refused
REQUESTS = """
          nothing  arm  reset  disarm  stop  quick_stop  cancel  run  servo  tail  target  finish
OFFLINE   h        h    h      h       h     h           h       -    -      -     -       -
DISARMED  h        h    h      h       h     h           h       -    -      -     -       -
LINKED    .        A    .      D       S     Q           .       -    -      -     -       -
ARMED     .        .    .      D       S     Q           .       T    V      -     -       -
RUNNING   T        T    T      D       S     Q           T       -    -      T     -       -
SERVOING  V        V    V      D       S     Q           V       -    -      -     V       V
STOPPING  .        .    .      D       S     Q           .       -    -      .     -       -
FAULT     .        .    R      D       S     Q           .       -    -      -     -       -
LOCAL     .        .    .      D       S     Q           .       -    -      -     -       -
"""
SENT = {
    "h": "HELLO", ".": "HEARTBEAT", "A": "ARM", "R": "RESET", "D": "DISARM", "S": "STOP", "Q": "QUICK_STOP",
    "T": "TRAJECTORY", "V": "SERVO",
}  # fmt: skip


class Pc:
    """A ClientLink brought into a phase by states made by hand."""

    def __init__(self, phase: ClientPhase, servo: bool = False) -> None:
        self.link = ClientLink(TABLE, RawFraming(), session=7)
        self.t_ns = 10_000 * MS
        self.state = State(7, 0, 500_000 * MS, PlcState.LINKED, nonce=5, rx_ok=25, link_state=LinkState.FRESH)
        if phase is ClientPhase.DISARMED:
            self.feed(session=0, plc_state=PlcState.DISARMED)
        elif phase in STATES:
            self.feed(plc_state=STATES[phase])
        elif phase is not ClientPhase.OFFLINE:
            self.feed(plc_state=PlcState.HOLD)
            self.ask("first servo" if servo else "first run")
            self.link.send(self.t_ns)
            self.feed(plc_state=PlcState.RUN, traj_id=1, knot_last=5)
            if phase is ClientPhase.STOPPING:
                self.feed(plc_state=PlcState.STOPPING)
        self.session_open = phase in OPEN
        assert self.link.phase(self.t_ns) is phase

    def make(self, **changes: Any) -> bytes:
        newer = replace(self.state, seq=self.state.seq + 1, t_send_ns=self.state.t_send_ns + 10 * MS)
        self.state = replace(newer, **changes)
        return encode_state(self.state)

    def feed(self, **changes: Any) -> list[Any]:
        return self.link.receive(self.make(**changes), self.t_ns)

    def sent(self) -> str:
        datagram = self.link.send(self.t_ns)
        assert datagram is not None
        command = decode_command(datagram)
        return "HELLO" if command.hello else command.mode.name

    def ask(self, request: str) -> None:
        link, t_ns = self.link, self.t_ns
        {
            "nothing": lambda: None,
            "arm": link.request_arm,
            "reset": link.request_reset,
            "disarm": link.request_disarm,
            "stop": lambda: link.request_stop("test"),
            "quick_stop": lambda: link.request_stop("test", quick=True),
            "cancel": link.cancel_request,
            "first run": lambda: link.request_run(1, KNOTS, t_ns),
            "first servo": lambda: link.request_servo(1, t_ns),
            "run": lambda: link.request_run(2, KNOTS, t_ns),
            "servo": lambda: link.request_servo(2, t_ns),
            "tail": lambda: link.request_tail(1, 10, KNOTS[10:], t_ns),
            "target": lambda: link.set_servo_target(ZEROS, ZEROS, t_ns),
            "finish": link.finish_servo,
        }[request]()


@pytest.mark.parametrize("row", [*(phase.name for phase in ClientPhase), "SERVOING"])
def test_every_phase_with_every_request(row: str) -> None:
    phase = ClientPhase.RUNNING if row == "SERVOING" else ClientPhase[row]
    for request in sorted({column for _, column in grid(REQUESTS)}):
        pc, cell = Pc(phase, servo=row == "SERVOING"), grid(REQUESTS)[row, request]
        if cell == "-":
            before = repr(pc.link)
            with pytest.raises(LocalProtocolError):
                pc.ask(request)
            assert repr(pc.link) == before, request
        else:
            pc.ask(request)
            assert pc.link.phase(pc.t_ns) is phase, request
            assert pc.sent() == SENT[cell], request


@pytest.mark.parametrize("phase", list(ClientPhase))
@pytest.mark.parametrize("state", list(PlcState))
def test_every_phase_with_every_state_of_its_session(phase: ClientPhase, state: PlcState) -> None:
    pc = Pc(phase)
    assert isinstance(pc.feed(plc_state=state, session=7)[0], StateReceived)
    assert pc.link.phase(pc.t_ns).name == PHASES[state]


@pytest.mark.parametrize("phase", list(ClientPhase))
@pytest.mark.parametrize("state", list(PlcState))
def test_every_phase_with_every_state_of_another_session(phase: ClientPhase, state: PlcState) -> None:
    """An open session is over then; without one the PLC is seen, and no more."""
    pc = Pc(phase)
    events = pc.feed(plc_state=state, session=8)
    assert isinstance(events[0], StateReceived)
    if pc.session_open:
        assert isinstance(events[-1], LinkClosed)
        assert pc.link.phase(pc.t_ns) is ClientPhase.OFFLINE
        assert pc.link.send(pc.t_ns) is None
    else:
        shown = PHASES[state] if state in (PlcState.FAULT, PlcState.LOCAL) else "DISARMED"
        assert pc.link.phase(pc.t_ns).name == shown
        assert pc.sent() == "HELLO"


@pytest.mark.parametrize("phase", list(ClientPhase))
def test_every_phase_with_what_is_no_news(phase: ClientPhase) -> None:
    """Junk is dropped, a repetition is passed over; neither changes the phase."""
    pc = Pc(phase)
    good = encode_state(pc.state)
    for junk in (b"", b"\x00", good[:-1], good + b"\x00", good[:-1] + bytes((good[-1] ^ 1,)), bytes(568)):
        events = pc.link.receive(junk, pc.t_ns)
        assert [type(event) for event in events] == [DatagramDropped]
        assert pc.link.phase(pc.t_ns) is phase
    if pc.session_open:
        assert pc.link.receive(good, pc.t_ns) == []
        far = pc.make(seq=pc.state.seq + 1002)
        assert [event.code for event in pc.link.receive(far, pc.t_ns)] == [RejectCode.SEQ_JUMP]
        assert pc.link.phase(pc.t_ns) is phase


@pytest.mark.parametrize("phase", list(ClientPhase))
def test_every_phase_with_silence(phase: ClientPhase) -> None:
    """After 250 ms it counts as offline and STOP is sent; after a second an open session is over."""
    pc = Pc(phase)
    pc.t_ns += 250 * MS
    pc.link.poll(pc.t_ns)
    assert pc.link.phase(pc.t_ns) is phase
    pc.t_ns += 1
    assert pc.link.poll(pc.t_ns) == []
    assert pc.link.phase(pc.t_ns) is ClientPhase.OFFLINE
    assert pc.sent() == ("STOP" if pc.session_open else "HELLO")
    pc.t_ns += 750 * MS
    events = pc.link.poll(pc.t_ns)
    assert any(isinstance(event, LinkClosed) for event in events) is pc.session_open
    assert pc.link.closed is pc.session_open
