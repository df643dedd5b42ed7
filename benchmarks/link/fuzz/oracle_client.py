"""What the PC's end must make of a state datagram, and what it may send after: judged from docs/plc-link.md."""

from collections.abc import Iterator
from dataclasses import dataclass

from benchmarks.link.fuzz.oracle_bytes import Subscription, command_breach, state_breach, unframed
from benchmarks.link.fuzz.oracle_fields import CommandFields, StateFields, command_fields, state_fields
from benchmarks.link.fuzz.oracle_knots import at_rest, one_knot, servo_target, start, step
from benchmarks.link.fuzz.verdict import SILENT, TAKEN, Breach, Verdict, refused
from protocol.codes import Mode, PlcState, RejectCode
from protocol.limits import LimitTable, axis_mask

_LATE_NS, _LOST_NS, _HELLO_NS = 100_000_000, 250_000_000, 100_000_000
_JUMP = 1000
_LAST_IS_END = 1
_BETWEEN = 1.10  # the PLC's bound on what lies between knots; the client holds itself to less
_NEEDS = {
    Mode.ARM: (PlcState.LINKED,),
    Mode.RESET: (PlcState.FAULT,),
    Mode.TRAJECTORY: (PlcState.HOLD, PlcState.RUN),
    Mode.SERVO: (PlcState.HOLD, PlcState.RUN),
}
_SENT = {Mode.HEARTBEAT, Mode.STOP, Mode.QUICK_STOP, Mode.DISARM, *_NEEDS}
_WHEN_LATE = {Mode.HEARTBEAT, Mode.STOP, Mode.QUICK_STOP, Mode.DISARM}
_WHEN_LOST = {Mode.STOP, Mode.QUICK_STOP}


@dataclass(slots=True)
class ClientOracle:
    """One session of the PC's end as seen from outside; `newest`: the newest state that it took."""

    table: LimitTable
    cfg_id: int
    key: bytes
    eap: Subscription | None
    command_eap: Subscription | None
    session: int
    newest: StateFields | None = None
    linked: bool = False
    closed: bool = False
    t_state_ns: int = 0
    seq: int = 0
    t_hello_ns: int | None = None

    # --- states -------------------------------------------------------------------------------------------------------

    def judge(self, datagram: bytes, t_mono_ns: int) -> Verdict:
        """What must become of a datagram that comes now."""
        if self.closed:
            return SILENT
        payload = unframed(datagram, self.eap)
        breach = payload if isinstance(payload, Breach) else state_breach(payload, self.key)
        if breach is not None:
            return refused(breach)
        if isinstance(payload, Breach):
            return refused(payload)
        session, seq, t_send_ns = state_head(payload)
        newest = self.newest
        if session != self.session:
            older = newest is not None and t_send_ns <= newest.t_send_ns
            silent = t_mono_ns - self.t_state_ns > _LOST_NS  # a PLC that was switched off and on begins a clock anew
            return SILENT if older and (self.linked or not silent) else TAKEN
        if not self.linked or newest is None:
            return TAKEN
        distance = (seq - newest.seq) & 0xFFFF_FFFF
        if distance == 0 or distance >= 0x1_0000_0000 - _JUMP:
            return SILENT
        return TAKEN if distance <= _JUMP else refused(Breach(RejectCode.SEQ_JUMP, 20))

    def take(self, payload: bytes, t_mono_ns: int) -> bool:
        """Remember what was taken; whether it ends the session."""
        fields = state_fields(payload)
        self.newest, self.t_state_ns = fields, t_mono_ns
        if fields.session == self.session:
            self.linked = True
        elif self.linked:
            self.closed = True
        return self.closed

    # --- commands -----------------------------------------------------------------------------------------------------

    def against_sent(self, datagram: bytes, t_mono_ns: int) -> list[str]:
        """Every rule that a datagram of the client breaks."""
        payload = unframed(datagram, self.command_eap)
        breach = payload if isinstance(payload, Breach) else command_breach(payload, self.key)
        if breach is not None or isinstance(payload, Breach):
            return [f"sent what the PLC refuses: {breach}"]
        command = command_fields(payload)
        problems = list(self._against_header(command, t_mono_ns))
        if command.hello:
            problems += self._against_hello(t_mono_ns)
        else:
            problems += self._against_mode(command, t_mono_ns)
        self.seq = command.seq
        return [f"sent {problem}" for problem in problems]

    def _against_header(self, command: CommandFields, t_mono_ns: int) -> Iterator[str]:
        if (command.session, command.seq) != (self.session, (self.seq + 1) & 0xFFFF_FFFF):
            yield f"session {command.session}, seq {command.seq} after {self.seq}"
        if (command.t_send_ns, command.cfg_id) != (t_mono_ns, self.cfg_id):
            yield "wrong time or cfg_id"
        if command.hello is self.linked:
            yield "HELLO in an open session" if self.linked else "a command before the session is open"
        if self.linked and self.newest is not None:
            echoed = (command.ack_plc_seq, command.t_plc_echo_ns, command.arm_nonce)
            if echoed != (self.newest.seq, self.newest.t_send_ns, self.newest.nonce):
                yield f"an echo of another state than the newest taken: {echoed}"

    def _against_hello(self, t_mono_ns: int) -> Iterator[str]:
        before, self.t_hello_ns = self.t_hello_ns, t_mono_ns
        if before is not None and t_mono_ns - before < _HELLO_NS:
            yield "HELLO again too early"

    def _against_mode(self, command: CommandFields, t_mono_ns: int) -> Iterator[str]:
        mode, state = Mode(command.mode), self.newest or StateFields()
        age_ns = t_mono_ns - self.t_state_ns
        allowed = _SENT if age_ns <= _LATE_NS else _WHEN_LATE if age_ns <= _LOST_NS else _WHEN_LOST
        if mode not in allowed:
            yield f"{mode.name} at an age of {age_ns} ns"
        if state.plc_state not in _NEEDS.get(mode, (state.plc_state,)):
            yield f"{mode.name} in PLC state {state.plc_state}"
        if mode is Mode.ARM and state.rx_ok < 25:
            yield "ARM before the link is proven"
        if mode not in (Mode.TRAJECTORY, Mode.SERVO):
            if command.knot_count or command.interp:
                yield f"knots with {mode.name}"
            return
        for breach in self._against_motion(command, mode, state):
            if breach.sure:
                yield f"{mode.name} with {breach.code.name} at {breach.offset}"

    def _against_motion(self, command: CommandFields, mode: Mode, state: StateFields) -> Iterator[Breach]:
        knots = command.knots
        if command.axis_mask != axis_mask(self.table):
            yield Breach(RejectCode.AXIS_MASK, 50)
        if not 0.0 <= command.speed_override <= 1.0:
            yield Breach(RejectCode.OVERRIDE, 72)
        if command.traj_id == 0:
            yield Breach(RejectCode.TRAJ_ID, 56)
        if mode is Mode.SERVO:
            if command.interp != 1 or len(knots) != 1:
                yield Breach(RejectCode.VALUE, 64)
            yield from servo_target(knots[0], state.q_ref, self.table)
            return
        if command.interp != 3 or not knots:
            yield Breach(RejectCode.INTERP, 65)
        if command.knot_first == 0 and state.plc_state == PlcState.HOLD:
            n = len(self.table.axes)  # of axes that there are not, a state may tell anything
            yield from start(knots[0], (*state.q_ref[:n], *(0.0,) * (8 - n)), self.table.start_tolerance_rad)
        for k, knot in enumerate(knots):
            yield from one_knot(knot, k, self.table, 0.0)
            if k:
                yield from step(knots[k - 1], knot, k, self.table, _BETWEEN)
        if command.cmd_flags & _LAST_IS_END:
            yield from at_rest(knots[-1], len(knots) - 1, RejectCode.END_NOT_AT_REST)


def state_head(payload: bytes) -> tuple[int, int, int]:
    """Session, sequence and time of sending."""
    return (
        int.from_bytes(payload[16:20], "little"),
        int.from_bytes(payload[20:24], "little"),
        int.from_bytes(payload[24:32], "little"),
    )
