"""The PLC's end of the link: receive rules, session, watchdog and the state machine. Sans-IO; knows nothing of joints.

The rules are applied in the order of docs/plc-link.md; the first failure counts and nothing else happens.
Written apart from the client's end: both share codec and sequence rule only.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, fields, replace

from protocol.codec import decode_command, encode_state, may_be_answered
from protocol.codes import CommandFlag, HeaderFlag, LinkState, Mode, PlcState, RejectCode, WarnBit
from protocol.errors import RefusedError, RemoteProtocolError, SessionError
from protocol.framing import Framing
from protocol.layout import COMMAND_BODY_LAYOUT, HEADER_LAYOUT, VERSION_MINOR
from protocol.messages import Command, PlcStatus, State
from protocol.objection import Objection
from protocol.plc_events import (
    CommandAccepted,
    CommandRejected,
    PlcAction,
    PlcLinkEvent,
    SessionOpened,
    SessionVoid,
    StateChanged,
)
from protocol.plc_states import ARMED_STATES, PlcEvent, next_state
from protocol.sequence import SequenceKind, classify_sequence, next_sequence
from protocol.timeouts import (
    COMMAND_LATE_TIMEOUT,
    COMMAND_LOST_TIMEOUT,
    ECHO_STALE_TIMEOUT,
    GOOD_COMMANDS_TO_ARM,
    SESSION_TIMEOUT,
)

CommandCheck = Callable[[Command, PlcState], Objection | None]


def accept_all(command: Command, state: PlcState) -> Objection | None:
    """The check of a PLC without limits: for tests of the link alone."""
    del command, state
    return None


@dataclass(frozen=True, slots=True)
class PlcLinkSettings:
    """What the link needs to know of its machine."""

    cfg_id: int
    simulation: bool = False
    key: bytes = b""  # with a key only signed commands are taken, and states are signed


@dataclass(slots=True)
class _Counters:
    accepted: int = 0
    lost: int = 0
    duplicates: int = 0
    late: int = 0
    malformed: int = 0
    watchdog_trips: int = 0


@dataclass(slots=True)
class _LastReject:
    code: RejectCode = RejectCode.NONE
    count: int = 0
    seq: int = 0
    field_offset: int = 0


@dataclass(slots=True)
class _Session:
    """What is known of the PC while a session is open; a void session is a fresh object with id 0."""

    session: int = 0
    sender: Hashable = None
    last_seq: int = 0
    n_good_commands: int = 0
    accepted_ns: int = 0
    pc_time_ns: int = 0
    timeout_ns: int = COMMAND_LOST_TIMEOUT.duration_ns
    traj_id: int = 0  # newest trajectory seen
    servo_mode: bool = False  # that one is followed in servo mode
    trajectory_over: bool = False  # that trajectory has ended or was stopped
    command_late: bool = False
    newer_minor: bool = False


_AT = {f.name: f.offset for block in (HEADER_LAYOUT, COMMAND_BODY_LAYOUT) for f in block.fields}
_STATUS_FIELDS = tuple(f.name for f in fields(PlcStatus) if f.name not in ("simulation", "dry_run"))
_SAFE_MODES = frozenset({Mode.STOP, Mode.QUICK_STOP, Mode.DISARM})
_MOTION_MODES = (Mode.TRAJECTORY, Mode.SERVO)
_LEGAL: dict[PlcState, frozenset[Mode]] = {
    PlcState.BOOT: frozenset(),
    PlcState.DISARMED: frozenset(),
    PlcState.LINKED: frozenset({Mode.HEARTBEAT, Mode.ARM, Mode.HOLD}) | _SAFE_MODES,
    PlcState.HOLD: frozenset({Mode.HEARTBEAT, Mode.ARM, Mode.HOLD, Mode.TRAJECTORY, Mode.SERVO}) | _SAFE_MODES,
    PlcState.RUN: frozenset({Mode.HEARTBEAT, Mode.HOLD, Mode.TRAJECTORY, Mode.SERVO}) | _SAFE_MODES,
    PlcState.STOPPING: frozenset({Mode.HEARTBEAT, Mode.HOLD, Mode.TRAJECTORY, Mode.SERVO}) | _SAFE_MODES,
    PlcState.FAULT: frozenset({Mode.HEARTBEAT, Mode.HOLD, Mode.RESET}) | _SAFE_MODES,
    PlcState.LOCAL: frozenset({Mode.HEARTBEAT, Mode.HOLD}) | _SAFE_MODES,
}
_EFFECTS = {
    Mode.ARM: PlcAction.ARM,
    Mode.HOLD: PlcAction.STOP,
    Mode.STOP: PlcAction.STOP,
    Mode.QUICK_STOP: PlcAction.QUICK_STOP,
    Mode.RESET: PlcAction.RESET,
    Mode.DISARM: PlcAction.DISARM,
}
_STOPS = frozenset({PlcAction.STOP, PlcAction.QUICK_STOP, PlcAction.DISARM})
_EVENTS = {
    PlcAction.ARM: PlcEvent.ARM,
    PlcAction.STOP: PlcEvent.SOFT_STOP,
    PlcAction.QUICK_STOP: PlcEvent.QUICK_STOP,
    PlcAction.RESET: PlcEvent.RESET,
    PlcAction.DISARM: PlcEvent.DISARM,
}


@dataclass(slots=True)
class PlcLink:
    """One PLC's link over its whole life; sessions come and go in it. `t_plc_ns` is the PLC's own monotonic clock."""

    settings: PlcLinkSettings
    framing: Framing
    draw_nonce: Callable[[], int]
    command_check: CommandCheck = accept_all
    state: PlcState = PlcState.BOOT
    peer: Hashable = None  # where states go: the source of the last valid HELLO
    refused: Hashable = None  # a sender that was refused and is not the peer: the next state goes to it too
    nonce: int = 0
    state_seq: int = 0
    _session: _Session = field(default_factory=_Session)
    _counters: _Counters = field(default_factory=_Counters)
    _reject: _LastReject = field(default_factory=_LastReject)

    @property
    def session(self) -> int:
        """The open session's number; 0 while there is none."""
        return self._session.session

    def age_ns(self, t_plc_ns: int) -> int:
        """Time since the last accepted command: what the watchdog watches. 0 without a session."""
        return t_plc_ns - self._session.accepted_ns if self.session else 0

    def receive(self, datagram: bytes, t_plc_ns: int, source: Hashable = None) -> list[PlcLinkEvent]:
        """What one datagram from `source` leads to; any bytes give events, never an exception."""
        seq, payload = 0, b""
        try:
            payload = self.framing.unwrap(datagram)
            command = decode_command(payload, self.settings.key)
            seq = command.seq
            if command.hello and (not self.session or command.session != self.session):
                return self._open_session(command, t_plc_ns, source)
            return self._process_command(command, t_plc_ns, source)
        except RemoteProtocolError as error:
            if source != self.peer and may_be_answered(payload):
                self.refused = source
            return self._refuse(error, seq, source, t_plc_ns)

    def poll(self, t_plc_ns: int) -> list[PlcLinkEvent]:
        """What silence leads to; call it every cycle, after the cycle's datagrams."""
        if not self.session:
            return []
        events: list[PlcLinkEvent] = []
        age_ns = self.age_ns(t_plc_ns)
        if age_ns > self._session.timeout_ns and not self._session.command_late:
            self._session.command_late = True
            self._session.trajectory_over = True  # also what was only prefilled
            self._counters.watchdog_trips += 1
            if self.state is PlcState.RUN:
                events += self.apply(PlcEvent.SOFT_STOP, t_plc_ns)
        if age_ns > SESSION_TIMEOUT.duration_ns:
            events += self._end_silent_session(t_plc_ns)
        return events

    def apply(self, event: PlcEvent, t_plc_ns: int) -> list[PlcLinkEvent]:
        """Move the state machine: for what only the PLC's logic knows (END, AT_REST, FAULT, LOCAL_ON, ...).

        Raises: IllegalTransitionError: the table has no such pair; nothing changed.
        """
        del t_plc_ns
        old, new = self.state, next_state(self.state, event)
        self.state = new
        if old is PlcState.RUN and new is not PlcState.RUN:
            self._session.trajectory_over = True  # motion never resumes by itself
        if old is new:
            return []
        events: list[PlcLinkEvent] = [StateChanged(old, new, event)]
        if new is PlcState.DISARMED:
            events += self._close_session(event.value)
            self._renew_nonce()
        return events

    def send(self, status: PlcStatus, t_plc_ns: int) -> bytes:
        """The next state datagram; send it to `receivers`."""
        self.state_seq = next_sequence(self.state_seq)
        state = self._build_state_message(status, t_plc_ns)
        return self.framing.wrap(encode_state(state, self.settings.key), state.seq)

    def receivers(self) -> list[Hashable]:
        """Where the newest state goes: to the peer, and once to the sender that was refused last."""
        found, self.refused = [self.peer, self.refused], None
        return [source for source in found if source is not None]

    def _build_state_message(self, status: PlcStatus, t_plc_ns: int) -> State:
        values = {name: getattr(status, name) for name in _STATUS_FIELDS}
        values["warn_bits"] |= self._link_warning_bits(t_plc_ns)
        flags = HeaderFlag.SIMULATION if status.simulation or self.settings.simulation else HeaderFlag(0)
        if status.dry_run:
            flags |= HeaderFlag.DRY_RUN
        session, counters = self._session, self._counters
        return State(
            session=session.session,
            seq=self.state_seq,
            t_send_ns=t_plc_ns,
            plc_state=self.state,
            flags=flags,
            nonce=self.nonce,
            ack_seq=session.last_seq,
            t_pc_echo_ns=session.pc_time_ns,
            rx_age_us=min(max(self.age_ns(t_plc_ns), 0) // 1000, 0xFFFF_FFFF),
            link_state=self._link_state(t_plc_ns),
            cfg_id=self.settings.cfg_id,
            reject_code=self._reject.code,
            reject_count=self._reject.count & 0xFFFF,
            reject_seq=self._reject.seq,
            reject_offset=self._reject.field_offset,
            rx_ok=counters.accepted,
            rx_lost=counters.lost,
            rx_dup=counters.duplicates,
            rx_late=counters.late,
            rx_bad=counters.malformed,
            wd_trips=counters.watchdog_trips,
            **values,
        )

    def _link_state(self, t_plc_ns: int) -> LinkState:
        if not self.session:
            return LinkState.NO_SESSION
        age_ns = self.age_ns(t_plc_ns)
        if age_ns > self._session.timeout_ns:
            return LinkState.LOST
        return LinkState.LATE if age_ns > COMMAND_LATE_TIMEOUT.duration_ns else LinkState.FRESH

    def _link_warning_bits(self, t_plc_ns: int) -> int:
        link = self._link_state(t_plc_ns)
        bits = WarnBit.NEWER_MINOR if self._session.newer_minor else WarnBit(0)
        if link is LinkState.LATE:
            bits |= WarnBit.LINK_LATE
        if link is LinkState.LOST:
            bits |= WarnBit.LINK_LOST
        return int(bits)

    def _open_session(self, hello: Command, t_plc_ns: int, source: Hashable) -> list[PlcLinkEvent]:
        """A HELLO with a number that is not the open session's."""
        if self.session or not hello.session:
            text = f"session {hello.session:#x} refused: {self.session:#x} is open, or it is 0"
            raise SessionError(RejectCode.SESSION, text, _AT["session"])
        if self.state is PlcState.BOOT:
            raise RefusedError(RejectCode.MODE_ILLEGAL, "HELLO while booting; wait for DISARMED", _AT["mode"])
        self.peer = source  # from here on the PC gets the reason, even if refused below
        self._check_cfg(hello)
        events = self.apply(PlcEvent.HELLO, t_plc_ns)
        self._session = _Session(session=hello.session, sender=source, last_seq=hello.seq)
        self._counters = _Counters()
        self._reject = _LastReject()
        self.state_seq = 0
        self._feed_watchdog(hello, t_plc_ns)
        return [SessionOpened(hello.session, source), *events]

    def _process_command(self, command: Command, t_plc_ns: int, source: Hashable) -> list[PlcLinkEvent]:
        session = self._session
        if not self.session or command.session != self.session:
            text = f"session {command.session:#x} is not the open one ({self.session:#x})"
            raise SessionError(RejectCode.SESSION, text, _AT["session"])
        if source != session.sender:
            text = f"sent from {source}, the session was opened from {session.sender}"
            raise SessionError(RejectCode.SOURCE, text, _AT["session"])
        sequenced = classify_sequence(session.last_seq, command.seq)
        if sequenced.kind is SequenceKind.DUPLICATE:
            self._counters.duplicates += 1
            return []
        if sequenced.kind is SequenceKind.LATE:
            self._counters.late += 1
            return []
        if not sequenced.is_usable:
            raise SessionError(RejectCode.SEQ_JUMP, f"sequence {command.seq} after {session.last_seq}", _AT["seq"])
        if command.hello:
            command = replace(command, mode=Mode.HEARTBEAT)  # a HELLO again is a heartbeat, whatever its mode says
        mode = command.mode
        self._check_rules(command, mode, t_plc_ns)
        self._counters.lost += sequenced.n_lost
        return self._accept_command(command, mode, t_plc_ns)

    def _check_rules(self, command: Command, mode: Mode, t_plc_ns: int) -> None:
        """Rules 5 and 6; a stop needs neither a seeing PC nor equal limits."""
        if mode not in _LEGAL[self.state]:
            text = f"mode {mode.name} in state {self.state.name}"
            raise RefusedError(RejectCode.MODE_ILLEGAL, text, _AT["mode"])
        if mode in _SAFE_MODES:
            return
        self._check_echo(command, t_plc_ns)
        self._check_cfg(command)
        if mode is Mode.ARM:
            self._check_arm(command)
        if mode in _MOTION_MODES:
            self._check_motion(command, mode)
        if self._is_spent(command, mode):
            return
        objection = self.command_check(command, self.state)
        if objection is not None:
            text = f"mode {mode.name} refused by the PLC's own check"
            raise RefusedError(objection.code, text, objection.field_offset)

    def _check_motion(self, command: Command, mode: Mode) -> None:
        """Numbers of trajectories only rise, and one number keeps to one mode."""
        session = self._session
        if command.traj_id < max(session.traj_id, 1):
            text = f"trajectory {command.traj_id} after {session.traj_id}"
            raise RefusedError(RejectCode.TRAJ_ID, text, _AT["traj_id"])
        if command.traj_id == session.traj_id and session.servo_mode is not (mode is Mode.SERVO):
            text = f"mode {mode.name} with the number of another mode's trajectory"
            raise RefusedError(RejectCode.MODE_ILLEGAL, text, _AT["mode"])

    def _check_echo(self, command: Command, t_plc_ns: int) -> None:
        unarmed = self.state not in ARMED_STATES
        if unarmed and command.ack_plc_seq == 0 and command.mode is not Mode.ARM:
            return  # the PC has not seen a state of this session yet
        age_ns = t_plc_ns - command.t_plc_echo_ns
        if not 0 <= age_ns <= ECHO_STALE_TIMEOUT.duration_ns:
            text = f"the PC's newest state is {age_ns / 1e6:.0f} ms old, limit 250 ms"
            raise SessionError(RejectCode.ECHO_STALE, text, _AT["t_plc_echo_ns"])

    def _check_cfg(self, command: Command) -> None:
        if command.cfg_id != self.settings.cfg_id:
            text = f"cfg_id {command.cfg_id:#010x}, here {self.settings.cfg_id:#010x}"
            raise RefusedError(RejectCode.CFG, text, _AT["cfg_id"])

    def _check_arm(self, command: Command) -> None:
        if command.arm_nonce != self.nonce:
            text = f"nonce {command.arm_nonce:#x} is not the present one"
            raise RefusedError(RejectCode.NONCE, text, _AT["arm_nonce"])
        if self.state is PlcState.LINKED and self._session.n_good_commands < GOOD_COMMANDS_TO_ARM:
            text = f"{self._session.n_good_commands} good commands, {GOOD_COMMANDS_TO_ARM} needed"
            raise RefusedError(RejectCode.LINK_NOT_PROVEN, text, _AT["mode"])

    def _is_spent(self, command: Command, mode: Mode) -> bool:
        """Whether this is a repetition of a trajectory that is over: it keeps the link alive and does nothing else."""
        return mode in _MOTION_MODES and command.traj_id == self._session.traj_id and self._session.trajectory_over

    def _accept_command(self, command: Command, mode: Mode, t_plc_ns: int) -> list[PlcLinkEvent]:
        """An accepted command: feed the watchdog, move the state machine, hand it up."""
        self._feed_watchdog(command, t_plc_ns)
        if mode in _MOTION_MODES:
            return self._take_motion(command, mode, t_plc_ns)
        effect = _EFFECTS.get(mode, PlcAction.KEEPALIVE)
        if effect in _STOPS:
            self._session.trajectory_over = True  # also what was only prefilled: the stop was meant for it
        accepted: list[PlcLinkEvent] = [CommandAccepted(command, effect)]
        event = _EVENTS.get(effect)
        return accepted if event is None else [*self.apply(event, t_plc_ns), *accepted]

    def _take_motion(self, command: Command, mode: Mode, t_plc_ns: int) -> list[PlcLinkEvent]:
        if self.state is PlcState.STOPPING or self._is_spent(command, mode):
            return [CommandAccepted(command, PlcAction.KEEPALIVE)]
        if self.state is PlcState.RUN and command.traj_id != self._session.traj_id:
            return [*self.apply(PlcEvent.SOFT_STOP, t_plc_ns), CommandAccepted(command, PlcAction.KEEPALIVE)]
        self._session.traj_id, self._session.servo_mode = command.traj_id, mode is Mode.SERVO
        self._session.trajectory_over = False
        events: list[PlcLinkEvent] = []
        if self.state is PlcState.HOLD and CommandFlag.START in command.cmd_flags:
            events = self.apply(PlcEvent.START, t_plc_ns)
        return [*events, CommandAccepted(command, PlcAction.SERVO if mode is Mode.SERVO else PlcAction.LOAD)]

    def _feed_watchdog(self, command: Command, t_plc_ns: int) -> None:
        session = self._session
        session.last_seq = command.seq
        session.accepted_ns = t_plc_ns
        session.pc_time_ns = command.t_send_ns
        session.n_good_commands += 1
        session.command_late = False
        session.newer_minor = command.ver_minor > VERSION_MINOR
        asked_ns = command.timeout_us * 1000
        session.timeout_ns = (
            min(max(asked_ns, COMMAND_LATE_TIMEOUT.duration_ns), COMMAND_LOST_TIMEOUT.duration_ns)
            if asked_ns
            else COMMAND_LOST_TIMEOUT.duration_ns
        )
        self._counters.accepted += 1

    def _refuse(self, error: RemoteProtocolError, seq: int, source: Hashable, t_plc_ns: int) -> list[PlcLinkEvent]:
        """Note a refusal. A PC that has gone blind is stopped: the one rule whose failure moves the state."""
        self._counters.malformed += 1
        self._reject.code, self._reject.seq, self._reject.field_offset = error.code, seq, error.offset
        self._reject.count += 1
        events: list[PlcLinkEvent] = [CommandRejected(error.code, seq, source, error.text, error.offset)]
        if error.code is RejectCode.ECHO_STALE and self.state is PlcState.RUN:
            events += self.apply(PlcEvent.SOFT_STOP, t_plc_ns)
        return events

    def _end_silent_session(self, t_plc_ns: int) -> list[PlcLinkEvent]:
        """One second of silence: the session ends, except while a ramp is still under way."""
        events = self.apply(PlcEvent.VOID, t_plc_ns)
        if self.state in (PlcState.STOPPING, PlcState.RUN) or not self.session:
            return events
        return events + self._close_session(PlcEvent.VOID.value)

    def _close_session(self, reason: str) -> list[PlcLinkEvent]:
        closed = self._session.session
        self._session = _Session()
        return [SessionVoid(closed, reason)] if closed else []

    def _renew_nonce(self) -> None:
        drawn = self.draw_nonce() & 0xFFFF_FFFF
        self.nonce = drawn if drawn not in (0, self.nonce) else self.nonce % 0xFFFF_FFFF + 1
