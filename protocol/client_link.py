"""The PC's end of the link: one session from HELLO to its end. Sans-IO; a new connection is a new object.

The shell hands in datagrams (`receive`), asks every 20 ms for the next one (`send`) and lets time pass (`poll`).
A request is repeated in every command until the PLC's state shows it fulfilled, so no single datagram matters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from protocol.client_events import (
    ClientEvent,
    ClientPhase,
    DatagramDropped,
    GateRefused,
    LinkClosed,
    RejectSeen,
    StateReceived,
    TailAnswered,
    TrajectoryEnded,
)
from protocol.client_run import MOVING_STATES, Run, StopReference
from protocol.client_state import ClientCounters, ClockOffset, PendingRequest, RequestKind, SentCommands, other_pc_text
from protocol.codec import decode_state, encode_command
from protocol.codes import CommandFlag, Interp, Mode, PlcState, RejectCode
from protocol.errors import LocalProtocolError, RemoteProtocolError
from protocol.framing import Framing
from protocol.gate import GateView, Refusal, check_tail, check_trajectory, gate
from protocol.limits import LimitTable, axis_mask, cfg_id
from protocol.messages import ZEROS, Axes, Command, Knot, State
from protocol.playback import Playback, Window
from protocol.sequence import SequenceKind, classify_sequence, is_at_or_after, next_sequence
from protocol.servo_target import ServoTarget
from protocol.timeouts import (
    COMMAND_LOST_TIMEOUT,
    HELLO_PERIOD,
    LINK_CLOSE_TIMEOUT,
    SERVO_LOST_TIMEOUT,
    STATE_LATE_TIMEOUT,
    STATE_LOST_TIMEOUT,
    TAIL_LEAD_NS,
    TRAJECTORY_START_TIMEOUT,
)

_PHASES = {
    PlcState.BOOT: ClientPhase.DISARMED,
    PlcState.DISARMED: ClientPhase.DISARMED,
    PlcState.LINKED: ClientPhase.LINKED,
    PlcState.HOLD: ClientPhase.ARMED,
    PlcState.RUN: ClientPhase.RUNNING,
    PlcState.STOPPING: ClientPhase.STOPPING,
    PlcState.FAULT: ClientPhase.FAULT,
    PlcState.LOCAL: ClientPhase.LOCAL,
}
_NO_FLAGS = CommandFlag(0)
_INTERP = {Mode.TRAJECTORY: Interp.QUINTIC, Mode.SERVO: Interp.LINEAR}


@dataclass(slots=True)
class ClientLink:
    """One session with one PLC. `session` is a fresh random non-zero number; `t_mono_ns` the PC's monotonic clock."""

    limit_table: LimitTable
    framing: Framing
    session: int
    speed_override: float = 1.0
    key: bytes = b""  # with a key commands are signed, and only signed states are taken
    state: State | None = None  # newest usable one
    clock_offset: ClockOffset = field(default_factory=ClockOffset)
    counters: ClientCounters = field(default_factory=ClientCounters)
    last_reject: str = ""
    closed: bool = False
    linked: bool = False
    _t_state_ns: int = 0
    _seq: int = 0
    _t_hello_ns: int | None = None
    _request: PendingRequest = field(default_factory=PendingRequest)
    _stop: StopReference | None = None
    _run: Run | None = None
    _sent: SentCommands = field(default_factory=SentCommands)
    _pending: list[ClientEvent] = field(default_factory=list)

    # --- what the shell may look at -------------------------------------------------------------------------------

    def age_ns(self, t_mono_ns: int) -> int:
        """Age of the newest state; very large before the first."""
        return t_mono_ns - self._t_state_ns if self.state else 1 << 62

    def phase(self, t_mono_ns: int) -> ClientPhase:
        """How far the connection has come."""
        if self.closed or self.state is None or self.age_ns(t_mono_ns) > STATE_LOST_TIMEOUT.duration_ns:
            return ClientPhase.OFFLINE
        if self.linked or self.state.plc_state in (PlcState.FAULT, PlcState.LOCAL):
            return _PHASES[self.state.plc_state]
        return ClientPhase.DISARMED

    @property
    def busy(self) -> bool:
        """Whether a trajectory or a stop is under way."""
        moving = self.linked and self.state is not None and self.state.plc_state in MOVING_STATES
        return self._run is not None or self._stop is not None or moving

    # --- requests ---------------------------------------------------------------------------------------------------

    def request_arm(self) -> None:
        """Arm as soon as the link is proven. A request ends with the session, or by `cancel_request`."""
        self._request.request_kind = RequestKind.ARM

    def request_reset(self) -> None:
        """Ask for a latched fault to be cleared; never restarts motion."""
        self._request.request_kind = RequestKind.RESET

    def request_disarm(self) -> None:
        """Ramp down if moving, then leave the armed state; the session ends with it."""
        self._request.request_kind = RequestKind.DISARM

    def cancel_request(self) -> None:
        """Stop asking for arm or reset; a disarm that was requested goes on until it is done."""
        self._request.cancel()

    def request_run(
        self, traj_id: int, knots: Sequence[Knot], t_mono_ns: int, judged: bool = False
    ) -> tuple[Refusal, ...]:
        """Play a trajectory from the present reference; refusals (nothing is sent then) or nothing.

        `judged`: the caller has run check_trajectory already, so it is not run again here. The gate judges every
        knot when it is sent, start and end too, whatever was said before.

        Raises: LocalProtocolError: not holding, or another motion is under way.
        """
        q_ref = self._require_armed_idle(traj_id, t_mono_ns).q_ref
        refusals = () if judged else check_trajectory(knots, q_ref, self.limit_table)
        if not refusals:
            self._run = Run(Playback(traj_id, tuple(knots)), next_sequence(self._seq), t_mono_ns)
        return refusals

    def request_tail(self, traj_id: int, first: int, knots: Sequence[Knot], t_mono_ns: int) -> tuple[Refusal, ...]:
        """Replace the running trajectory from knot `first` on; refusals (nothing changes then) or nothing.

        The new knots join the trajectory's own knot before them, never the measured joints. TailAnswered says whether
        the PLC took them.

        Raises: LocalProtocolError: that trajectory does not run (yet), or the splice is too near.
        """
        run, state = self._run, self.state
        ours = run is not None and run.traj_id == traj_id and not run.tail_pending and not self._stop
        if run is None or state is None or not ours or not isinstance(run.motion, Playback):
            raise LocalProtocolError(f"trajectory {traj_id} is not running alone: nothing to correct; plan a new one")
        if not run.started:  # the PLC plays nothing yet: a tail now would be its whole trajectory, from nowhere
            raise LocalProtocolError(f"trajectory {traj_id} has not begun to move: nothing to correct yet; wait for it")
        playback = run.motion
        if not 1 <= first <= playback.last:
            raise LocalProtocolError(f"trajectory {traj_id}: knot {first} cannot be replaced, give 1..{playback.last}")
        t_play_ns = state.t_play_ns + self.age_ns(t_mono_ns)
        splice_ns = min(playback.knots[first].t_ns, knots[0].t_ns) if knots else 0
        if splice_ns < t_play_ns + TAIL_LEAD_NS:
            left_ms = (splice_ns - t_play_ns) / 1e6
            raise LocalProtocolError(
                f"trajectory {traj_id}: the new tail begins {left_ms:.0f} ms ahead, "
                f"at least {TAIL_LEAD_NS / 1e6:.0f} ms are needed; begin later"
            )
        refusals = check_tail(knots, playback.knots[first - 1], self.limit_table)
        if not refusals:
            replaced = playback.with_tail(first, tuple(knots))
            if replaced.splice_knot_index is None:  # knot by knot what is played anyway
                self._pending.append(TailAnswered(traj_id, True, "taken"))
            else:
                run.replace_tail(replaced)
        return refusals

    def request_servo(self, traj_id: int, t_mono_ns: int) -> None:
        """Begin servo mode at the present reference; then `set_servo_target` at least every 60 ms.

        Raises: LocalProtocolError: not holding, or another motion is under way.
        """
        state = self._require_armed_idle(traj_id, t_mono_ns)
        target = ServoTarget(traj_id, state.q_ref, t_set_ns=t_mono_ns)
        self._run = Run(target, next_sequence(self._seq), t_mono_ns)

    def set_servo_target(self, q: Axes, qd: Axes, t_mono_ns: int) -> None:
        """Where the reference shall be, and how fast that moves [rad, rad/s]; the gate judges it when it is sent.

        Raises: LocalProtocolError: servo mode is not under way.
        """
        self._servo().set(q, qd, t_mono_ns)

    def finish_servo(self) -> None:
        """Come to rest on the newest target and hold. Raises: LocalProtocolError: servo mode is not under way."""
        self._servo().ending = True

    def request_stop(self, reason: str, quick: bool = False) -> None:
        """Ramp down and hold, along the path or (quick) every joint as fast as it may: sent until it is done."""
        if self._stop is None or (quick and not self._stop.quick):
            self._stop = StopReference(reason, next_sequence(self._seq), quick)

    def _require_armed_idle(self, traj_id: int, t_mono_ns: int) -> State:
        phase = self.phase(t_mono_ns)
        if phase is not ClientPhase.ARMED or self.busy or self.state is None:
            raise LocalProtocolError(
                f"trajectory {traj_id}: PLC link is {phase.value}, must be armed and idle; arm or wait"
            )
        return self.state

    def _servo(self) -> ServoTarget:
        if self._run is None or not isinstance(self._run.motion, ServoTarget):
            raise LocalProtocolError("servo mode is not under way; request it first")
        return self._run.motion

    # --- input ------------------------------------------------------------------------------------------------------

    def receive(self, datagram: bytes, t_mono_ns: int) -> list[ClientEvent]:
        """What one datagram leads to; any bytes give events, never an exception."""
        if self.closed:
            return []
        try:
            state = decode_state(self.framing.unwrap(datagram), self.key)
        except RemoteProtocolError as error:
            self.counters.malformed += 1
            return [DatagramDropped(error.code, error.text)]
        if state.session == self.session:
            return self._own_state(state, t_mono_ns)
        if self.linked:
            return self._foreign_state(state, t_mono_ns)
        return self._unlinked_state(state, t_mono_ns)

    def poll(self, t_mono_ns: int) -> list[ClientEvent]:
        """What the passing of time leads to."""
        events, self._pending = self._pending, []
        run = self._run
        if run and not run.started and t_mono_ns - run.t_asked_ns > TRAJECTORY_START_TIMEOUT.duration_ns:
            self.request_stop("the PLC did not start the motion within 1 s")
        if run and isinstance(run.motion, ServoTarget) and run.motion.is_caller_silent(t_mono_ns):
            self.request_stop(f"no servo target for {SERVO_LOST_TIMEOUT.duration_ns // 1_000_000} ms")
        if not self.linked or self.closed:
            return events
        age_ns = self.age_ns(t_mono_ns)
        if age_ns > STATE_LOST_TIMEOUT.duration_ns and run:
            self.request_stop(f"no state from the PLC for {STATE_LOST_TIMEOUT.duration_ns // 1_000_000} ms")
        if age_ns > LINK_CLOSE_TIMEOUT.duration_ns:
            events += self._close("no state from the PLC for 1 s")
        return events

    def send(self, t_mono_ns: int) -> bytes | None:
        """The next datagram, or None if nothing is due."""
        if self.closed:
            return None
        if not self.linked:
            return self._hello_datagram_if_due(t_mono_ns)
        return self._encode_next_datagram(self._apply_gate(self._select_next_command(t_mono_ns), t_mono_ns))

    # --- states -----------------------------------------------------------------------------------------------------

    def _own_state(self, state: State, t_mono_ns: int) -> list[ClientEvent]:
        if self.linked and self.state:
            sequenced = classify_sequence(self.state.seq, state.seq)
            if sequenced.kind is SequenceKind.JUMP:
                self.counters.malformed += 1
                return [DatagramDropped(RejectCode.SEQ_JUMP, f"state {state.seq} after {self.state.seq}")]
            if not sequenced.is_usable:
                self.counters.duplicate_or_late += 1
                return []
            self.counters.lost += sequenced.n_lost
        self.linked = True
        if state.t_pc_echo_ns:
            t_plc_receive_ns = state.t_send_ns - state.rx_age_us * 1000
            self.clock_offset.add(state.t_pc_echo_ns, t_plc_receive_ns, state.t_send_ns, t_mono_ns)
        events = [*self._take(state, t_mono_ns), *self._rejects(state)]
        return events + self._update_motion_progress(state)

    def _foreign_state(self, state: State, t_mono_ns: int) -> list[ClientEvent]:
        """Another session's state while ours was open: late from before it, or the PLC has ended ours."""
        if self.state and state.t_send_ns <= self.state.t_send_ns:
            self.counters.duplicate_or_late += 1
            return []
        disarmed = self._request.is_disarm
        events = self._take(state, t_mono_ns)
        return events + self._close("disarmed" if disarmed else "the PLC has ended the session; connect and arm again")

    def _unlinked_state(self, state: State, t_mono_ns: int) -> list[ClientEvent]:
        """The PLC is there, but not in session with us (yet): show it, and why it refused our HELLO.

        A state from before the newest one is late; after a silence it is a PLC that was switched off and on, whose
        clock begins again.
        """
        silent = self.age_ns(t_mono_ns) > STATE_LOST_TIMEOUT.duration_ns
        if self.state and not silent and state.t_send_ns <= self.state.t_send_ns:
            self.counters.duplicate_or_late += 1
            return []
        return [*self._take(state, t_mono_ns), *self._rejects(state)]

    def _take(self, state: State, t_mono_ns: int) -> list[ClientEvent]:
        self.counters.received += 1
        self.state, self._t_state_ns = state, t_mono_ns
        return [StateReceived(state, t_mono_ns)]

    @property
    def other_pc(self) -> str:
        """Which other PC the newest state shows; empty while it shows none."""
        return "" if self.state is None else other_pc_text(self.state, self.session, self.linked)

    def _rejects(self, state: State) -> list[ClientEvent]:
        if state.reject_count == self.counters.rejected:
            return []
        self.counters.rejected = state.reject_count
        if not state.reject_code:
            return []
        self.last_reject = self.other_pc or self._sent.explain(state.reject_code, state.reject_seq, state.reject_offset)
        events: list[ClientEvent] = [RejectSeen(state.reject_code, state.reject_seq, self.last_reject)]
        run = self._run
        if run and run.drop_refused_tail(state.reject_code, state.reject_seq):
            events.append(TailAnswered(run.traj_id, False, self.last_reject))
        return events

    # --- progress of what was requested -------------------------------------------------------------------------------

    def _update_motion_progress(self, state: State) -> list[ClientEvent]:
        self._request.look(state)
        events: list[ClientEvent] = []
        run, stop = self._run, self._stop
        if run:
            if run.look(state):
                events.append(TailAnswered(run.traj_id, True, "taken"))
            over = run.is_over(state, stop)
            events += self._end_run(*over, state) if over else []
        elif state.plc_state is PlcState.RUN:  # its run was given up here, or the PLC makes a mistake
            self.request_stop("the PLC plays a motion that is not under way here")
        if (
            stop
            and not self._run
            and state.plc_state not in MOVING_STATES
            and is_at_or_after(state.ack_seq, stop.first_seq)
        ):
            self._stop = None
        return events

    def _end_run(self, reached: bool, reason: str, state: State) -> list[ClientEvent]:
        run, self._run = self._run, None
        return [TrajectoryEnded(run.traj_id, reached, reason, state.t_send_ns)] if run else []

    def _close(self, reason: str) -> list[ClientEvent]:
        events = self._end_run(False, reason, self.state) if self.state else []
        self.closed, self._stop, self._request = True, None, PendingRequest()
        return [*events, LinkClosed(reason)]

    # --- output -------------------------------------------------------------------------------------------------------

    def _hello_datagram_if_due(self, t_mono_ns: int) -> bytes | None:
        if self._t_hello_ns is not None and t_mono_ns - self._t_hello_ns < HELLO_PERIOD.duration_ns:
            return None
        self._t_hello_ns = t_mono_ns
        return self._encode_next_datagram(self._build_command(t_mono_ns, Mode.HEARTBEAT, hello=True))

    def _select_next_command(self, t_mono_ns: int) -> Command:
        """The command to send if the gate passes it; the most cautious case is decided first."""
        state, age_ns = self.state, self.age_ns(t_mono_ns)
        if state is None or self._stop or age_ns > STATE_LOST_TIMEOUT.duration_ns:
            return self._build_command(t_mono_ns, Mode.QUICK_STOP if self._stop and self._stop.quick else Mode.STOP)
        if self._request.is_disarm:
            return self._build_command(t_mono_ns, Mode.DISARM)
        if age_ns > STATE_LATE_TIMEOUT.duration_ns:
            return self._build_command(t_mono_ns, Mode.HEARTBEAT)
        if self._run and state.plc_state in (PlcState.HOLD, PlcState.RUN):
            return self._motion(self._run, state, t_mono_ns)
        return self._build_command(t_mono_ns, self._request.mode(state, t_mono_ns))

    def _motion(self, run: Run, state: State, t_mono_ns: int) -> Command:
        if isinstance(run.motion, Playback):
            window = run.motion.window(state)
            run.note_sent(next_sequence(self._seq), window)
            return self._build_command(t_mono_ns, Mode.TRAJECTORY, window)
        flags = CommandFlag.START | (CommandFlag.LAST_IS_END if run.motion.ending else _NO_FLAGS)
        window = Window(0, (run.motion.knot(t_mono_ns, self.limit_table),), None, flags)
        return self._build_command(t_mono_ns, Mode.SERVO, window)

    def _build_command(self, t_mono_ns: int, mode: Mode, window: Window | None = None, hello: bool = False) -> Command:
        own = self.state if self.linked else None
        return Command(
            session=self.session,
            seq=next_sequence(self._seq),
            t_send_ns=t_mono_ns,
            mode=mode,
            hello=hello,
            arm_nonce=own.nonce if own else 0,
            ack_plc_seq=own.seq if own else 0,
            t_plc_echo_ns=own.t_send_ns if own else 0,
            axis_mask=axis_mask(self.limit_table),
            cfg_id=cfg_id(self.limit_table),
            timeout_us=COMMAND_LOST_TIMEOUT.duration_ns // 1000,
            speed_override=self.speed_override,
            traj_id=self._run.traj_id if self._run and window else 0,
            knot_first=window.knot_first if window else 0,
            interp=_INTERP.get(mode, Interp.NONE),
            cmd_flags=window.command_flags if window else _NO_FLAGS,
            knots=window.knots if window else (),
        )

    def _apply_gate(self, command: Command, t_mono_ns: int) -> Command:
        state = self.state
        view = GateView(
            plc_state=state.plc_state if state else PlcState.BOOT,
            state_age_ns=self.age_ns(t_mono_ns),
            session=state.session if state else 0,
            nonce=state.nonce if state else 0,
            q_ref=state.q_ref if state else ZEROS,
            knot_before=self._knot_before(command),
        )
        verdict = gate(command, view, self.limit_table)
        if verdict.refusals:
            text = "; ".join(refusal.as_line for refusal in verdict.refusals)
            self._pending.append(GateRefused(text))
            self.request_stop(f"motion gate: {text}")
        return verdict.command_to_send

    def _knot_before(self, command: Command) -> Knot | None:
        if self._run is None or command.knot_first == 0 or not isinstance(self._run.motion, Playback):
            return None
        return self._run.motion.knots[command.knot_first - 1]

    def _encode_next_datagram(self, command: Command) -> bytes:
        payload = encode_command(command, self.key)
        self._sent.note_sent(command.seq, payload)
        datagram = self.framing.wrap(payload, command.seq)
        self._seq = command.seq
        self.counters.sent += 1
        return datagram
