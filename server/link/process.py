"""The link process: 50 commands a second to the PLC at absolute deadlines, states back to the server; nothing else.

It dies with its parent. Every ending goes the same way: STOP is sent for at most 0.5 s, then the PLC's watchdog
takes over.
"""

import gc
import os
import secrets
import selectors
import signal
from collections import deque
from multiprocessing.connection import Connection
from types import FrameType

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
from protocol.client_link import ClientLink
from protocol.codes import HeaderFlag, PlcState, RejectCode, reject_text
from protocol.errors import LocalProtocolError
from protocol.limits import LimitTable
from protocol.messages import State
from protocol.plc_states import ARMED_STATES
from protocol.timeouts import EXIT_STOP_TIMEOUT, SESSION_TIMEOUT
from recording.clock import SUSPENDED_REASON, SuspendWatch, mono_ns
from server.link.contracts import (
    ArmRequest,
    BindFailed,
    CorrectRequest,
    DisarmRequest,
    HealthReport,
    HoldRequest,
    LinkHealth,
    LinkPhase,
    LinkRequest,
    MotionEnded,
    ResetRequest,
    RunRefused,
    RunRequest,
    SilenceRequest,
    SteerRequest,
    StopRequest,
    TailReport,
)
from server.link.lateness import Deadline, Lateness, LatenessFigures, Outbox, raise_priority
from server.link.samples import knots_from, refusals_text, sample_of
from server.link.settings import LinkSettings, framing_of
from server.link.udp_end import Address, Resolver, UdpEnd

_HEALTH_NS = 100_000_000
_RESOLVE_NS = 1_000_000_000
_REJECTS_KEPT = 10
_OTHER_PC_NS = (
    2 * SESSION_TIMEOUT.duration_ns
)  # by then a session that ended is void, and a PC that wants one has asked again
_HOLD_LOST = "hold-to-run: no hold confirmation reached the link in time; press it again"
_SIGHT_LOST = "closed loop: no stereo pair was evaluated in time; the server or this computer is overloaded"
_AGE_SHOWN_NS = 3_600_000_000_000  # "never" is shown as an hour


class LinkProcess:
    """The loop and what it holds. `run` returns when the process should end."""

    def __init__(self, pipe: Connection, settings: LinkSettings, table: LimitTable, parent_pid: int) -> None:
        self._pipe, self._settings, self._table, self._parent_pid = pipe, settings, table, parent_pid
        self._udp = UdpEnd((settings.local_host, settings.local_port))
        self._outbox = Outbox(pipe)
        self._resolver = Resolver(settings.plc_host, settings.plc_port)
        self._warning = raise_priority()
        self._lateness, self._figures = Lateness(), LatenessFigures()
        self._link = self._new_link()
        self._address: Address | None = None
        self._phase = ClientPhase.OFFLINE
        self._past_sent = self._past_received = self._past_lost = self._rejected = 0
        self._buffer_min_us = self._last_knot = 0
        self._rejects: deque[str] = deque(maxlen=_REJECTS_KEPT)
        self._silent_until_ns = 0
        self._other_pc, self._other_pc_ns = "", 0
        self._unread, self._unread_ns = "", 0  # datagrams from the PLC that cannot be read as states
        self._asked: ArmRequest | ResetRequest | None = None  # a request that is neither fulfilled nor lapsed
        self._asked_until_ns = 0
        self._hold, self._sight = Deadline(_HOLD_LOST), Deadline(_SIGHT_LOST)
        self._next_health_ns = self._next_resolve_ns = 0
        self._suspend = SuspendWatch()
        self._leaving: str | None = None

    def stop_and_end(self, reason: str) -> None:
        """Stop the machine if it moves, then end; safe to call from a signal handler."""
        self._leaving = self._leaving or reason

    def run(self) -> None:
        """The loop: wait for a datagram, a request or the next deadline, whichever comes first."""
        period_ns = round(1e9 / self._settings.command_hz)
        with selectors.SelectSelector() as selector:  # select waits to the microsecond, epoll to the millisecond
            selector.register(self._udp, selectors.EVENT_READ, self._drain)
            selector.register(self._pipe, selectors.EVENT_READ, self._take_requests)
            deadline_ns = mono_ns() + period_ns
            give_up_ns: int | None = None
            while give_up_ns is None or (self._link.busy and mono_ns() < give_up_ns):
                wait_s = max(0, deadline_ns - mono_ns()) / 1e9
                ready = selector.select(wait_s)
                if self._suspend.was_suspended():  # before any request or datagram from before the suspend
                    self.stop_and_end(SUSPENDED_REASON)
                for key, _ in ready:
                    if self._leaving:
                        self._forget_pipe(selector)
                    if not (self._leaving and key.fileobj is self._pipe):
                        key.data()
                now_ns = mono_ns()
                if self._leaving and give_up_ns is None:
                    give_up_ns = now_ns + EXIT_STOP_TIMEOUT.duration_ns
                    self._ask_for_nothing_but_a_stop(self._leaving)
                if now_ns >= deadline_ns:
                    self._tick(now_ns, deadline_ns)
                    missed = (now_ns - deadline_ns) // period_ns
                    deadline_ns += (missed + 1) * period_ns  # no burst after a stall
        self._udp.close()

    def _ask_for_nothing_but_a_stop(self, reason: str) -> None:
        self._asked = None
        self._link.cancel_request()
        if self._phase in (ClientPhase.RUNNING, ClientPhase.STOPPING, ClientPhase.ARMED) or self._link.busy:
            self._link.request_stop(reason)

    def _forget_pipe(self, selector: selectors.BaseSelector) -> None:
        """A pipe at its end is always readable: look away from it."""
        if self._pipe in (key.fileobj for key in selector.get_map().values()):
            selector.unregister(self._pipe)

    def _new_link(self) -> ClientLink:
        session = secrets.randbelow(0xFFFF_FFFF) + 1
        settings = self._settings
        return ClientLink(
            self._table, framing_of(settings), session, speed_override=settings.speed_override, key=settings.key
        )

    # --- time -------------------------------------------------------------------------------------------------------

    def _tick(self, now_ns: int, deadline_ns: int) -> None:
        self._watch_parent()
        if self._asked is not None and now_ns > self._asked_until_ns:
            self._asked = None
            self._link.cancel_request()
        self._watch_deadlines(now_ns)
        self._handle(self._link.poll(now_ns), now_ns)
        self._find_plc(now_ns)
        silent = now_ns < self._silent_until_ns
        datagram = self._link.send(now_ns) if self._address and not silent else None
        if datagram and self._address:
            self._udp.send(datagram, self._address)
            self._lateness.add(mono_ns() - deadline_ns)
        self._outbox.flush()
        if now_ns >= self._next_health_ns or self._link.phase(now_ns) is not self._phase:
            self._report_health(now_ns)

    def _watch_parent(self) -> None:
        if os.getppid() != self._parent_pid or self._outbox.broken:
            self.stop_and_end("the server has ended")

    def _watch_deadlines(self, now_ns: int) -> None:
        """What the button and the camera prove comes through the server; when it stops coming, motion stops, too."""
        for deadline in (self._hold, self._sight):
            if deadline.just_missed(now_ns):
                self._link.request_stop(deadline.missed_text)

    def _find_plc(self, now_ns: int) -> None:
        """The address may change only while no session is open."""
        if self._link.linked:
            return
        self._address = self._resolver.address
        if now_ns >= self._next_resolve_ns and self._link.phase(now_ns) is ClientPhase.OFFLINE:
            self._next_resolve_ns = now_ns + _RESOLVE_NS
            self._resolver.refresh()

    # --- input ------------------------------------------------------------------------------------------------------

    def _drain(self) -> None:
        for datagram, t_mono_ns, source in self._udp.drain():
            if self._address and source[0] == self._address[0]:
                self._handle(self._link.receive(datagram, t_mono_ns), t_mono_ns)

    def _take_requests(self) -> None:
        try:
            while self._pipe.poll():
                self._request(self._pipe.recv())
        except (EOFError, OSError):
            self.stop_and_end("the server has ended")

    def _request(self, request: LinkRequest) -> None:
        match request:
            case ArmRequest(valid_s=valid_s) | ResetRequest(valid_s=valid_s):
                self._asked, self._asked_until_ns = request, mono_ns() + round(valid_s * 1e9)
                self._ask()
            case RunRequest():
                self._start(request)
            case StopRequest(reason=reason, quick=quick):
                self._asked = None
                self._link.cancel_request()  # a disarm goes on: it stops, too
                self._link.request_stop(reason, quick)
            case CorrectRequest():
                self._correct_trajectory(request)
            case HoldRequest(until_ns=until_ns):
                self._hold.set(until_ns)
            case SteerRequest(until_ns=until_ns):
                self._sight.set(until_ns)
            case SilenceRequest(duration_s=duration_s):
                self._silent_until_ns = mono_ns() + round(duration_s * 1e9)
            case DisarmRequest():
                self._asked = None
                self._link.request_disarm()

    def _ask(self) -> None:
        """Hand the pending request to the link."""
        match self._asked:
            case ArmRequest():
                self._link.request_arm()
            case ResetRequest():
                self._link.request_reset()
            case None:
                pass

    def _start(self, request: RunRequest) -> None:
        for deadline in (self._hold, self._sight):
            if deadline.missed:
                self._outbox.report(RunRefused(request.traj_id, deadline.missed_text))
                return
        try:
            knots = knots_from(request.knots)
            refusals = self._link.request_run(request.traj_id, knots, mono_ns(), judged=True)
        except LocalProtocolError as error:
            self._outbox.report(RunRefused(request.traj_id, str(error)))
            return
        if refusals:
            self._outbox.report(RunRefused(request.traj_id, refusals_text(refusals)))
            return
        self._buffer_min_us, self._last_knot = 0, len(knots) - 1

    def _correct_trajectory(self, request: CorrectRequest) -> None:
        try:
            knots = knots_from(request.knots)
            refusals = self._link.request_tail(request.traj_id, request.first_knot, knots, mono_ns())
        except LocalProtocolError as error:
            self._outbox.report(TailReport(request.traj_id, False, str(error)))
            return
        if refusals:
            self._outbox.report(TailReport(request.traj_id, False, refusals_text(refusals)))
            return
        self._last_knot = request.first_knot + len(knots) - 1

    # --- events -----------------------------------------------------------------------------------------------------

    def _handle(self, events: list[ClientEvent], t_mono_ns: int) -> None:
        for event in events:
            match event:
                case StateReceived(state=state, t_mono_ns=t_received_ns):
                    self._outbox.add_sample(sample_of(state, t_received_ns, len(self._table.axes)))
                    self._note_buffer(state)
                    self._note_other_pc(t_received_ns)
                    self._note_fulfilled(state)
                case TrajectoryEnded(traj_id=traj_id, reached=reached, reason=reason, t_plc_ns=t_plc_ns):
                    self._report_health(t_mono_ns)
                    self._outbox.report(MotionEnded(traj_id, reached, reason, t_plc_ns))
                case TailAnswered(traj_id=traj_id, taken=taken, text=text):
                    self._outbox.report(TailReport(traj_id, taken, text))
                case RejectSeen(code=RejectCode.SESSION, text=text):  # another PC's command
                    self._other_pc, self._other_pc_ns = self._link.other_pc or text, t_mono_ns
                    self._rejected += 1
                    self._rejects.append(text)
                case RejectSeen(text=text, seq=seq):
                    self._rejected += 1
                    self._rejects.append(f"{text} (command {seq})")
                case GateRefused(text=text):
                    self._rejected += 1
                    self._rejects.append(f"motion gate: {text}")
                case LinkClosed():
                    self._renew()
                case DatagramDropped(code=code, text=text):
                    self._unread_ns = t_mono_ns
                    self._unread = f"the PLC answers, but rejects this PC: {reject_text(code)} [{text}]"

    def _note_buffer(self, state: State) -> None:
        """Only while knots are still to come: towards its end every trajectory empties the ring."""
        if state.plc_state is PlcState.RUN and state.knot_last < self._last_knot:
            self._buffer_min_us = min(self._buffer_min_us or state.buffer_us, state.buffer_us)

    def _note_other_pc(self, t_received_ns: int) -> None:
        """A foreign session in a state is there now; a refusal stays in every state that follows, whenever it was."""
        if not self._link.linked and self._link.other_pc:
            self._other_pc, self._other_pc_ns = self._link.other_pc, t_received_ns

    def _note_fulfilled(self, state: State) -> None:
        """A request that is fulfilled is not repeated in the next session."""
        armed = self._link.linked and state.plc_state in ARMED_STATES
        done = armed if isinstance(self._asked, ArmRequest) else state.plc_state is not PlcState.FAULT
        self._asked = None if done else self._asked

    def _renew(self) -> None:
        """A closed link is replaced; a request to arm or to reset that has not lapsed goes on."""
        counters = self._link.counters
        self._past_sent += counters.sent
        self._past_received += counters.received
        self._past_lost += counters.lost
        self._link = self._new_link()
        self._ask()

    def _report_health(self, now_ns: int) -> None:
        if now_ns >= self._next_health_ns:
            self._next_health_ns = now_ns + _HEALTH_NS
            self._figures = self._lateness.figures()
        self._phase = self._link.phase(now_ns)
        self._outbox.report(HealthReport(self._health(now_ns), self._link.clock_offset.offset_ns))

    def _why_unread(self, now_ns: int) -> str:
        """Why the PLC's datagrams are of no use, where no other ones come; a damaged one between good ones is loss."""
        is_all = self._phase is ClientPhase.OFFLINE and now_ns - self._unread_ns < _OTHER_PC_NS
        return self._unread if is_all else ""

    def _health(self, now_ns: int) -> LinkHealth:
        counters, figures = self._link.counters, self._figures
        age_ns, state = self._link.age_ns(now_ns), self._link.state
        return LinkHealth(
            phase=LinkPhase(self._phase.value),
            age_ms=min(age_ns, _AGE_SHOWN_NS) / 1e6,
            sent=self._past_sent + counters.sent,
            received=self._past_received + counters.received,
            lost=self._past_lost + counters.lost,
            rejected=self._rejected,
            lateness_p50_us=figures.p50_us,
            lateness_p99_us=figures.p99_us,
            lateness_max_us=figures.max_us,
            round_trip_ms=self._link.clock_offset.delay_ns / 1e6,
            last_reject=self._rejects[-1] if self._rejects else "",
            session=self._link.session if self._link.linked else 0,
            warning=self._warning,
            buffer_min_us=self._buffer_min_us,
            receive_timestamps="kernel" if self._udp.kernel_stamps else "process",
            error=self._resolver.error or self._why_unread(now_ns),
            dry_run=state is not None and HeaderFlag.DRY_RUN in state.flags,
            cfg_id=state.cfg_id if state is not None else 0,
            other_pc=self._other_pc if now_ns - self._other_pc_ns < _OTHER_PC_NS else "",
            recent_rejects=tuple(self._rejects),
            round_trip_min_ms=self._link.clock_offset.delay_min_ns / 1e6,
        )


def link_process_main(pipe: Connection, settings: LinkSettings, table: LimitTable, parent_pid: int) -> None:
    """The entry point of the spawned process; `parent_pid` is whose child it must remain."""
    try:
        process = LinkProcess(pipe, settings, table, parent_pid)
    except OSError as error:
        where = f"udp {settings.local_host}:{settings.local_port}"
        pipe.send(BindFailed(f"[plc] local_host, local_port: {where}: {error.strerror or error}"))
        return

    def on_signal(number: int, frame: FrameType | None) -> None:
        del frame
        process.stop_and_end(f"link process got {signal.Signals(number).name}")

    signal.signal(signal.SIGTERM, on_signal)
    gc.freeze()  # nothing that exists now will go; later collections stay short
    process.run()
