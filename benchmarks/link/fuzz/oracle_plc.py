"""What the PLC must make of a datagram: docs/plc-link.md, "Receive rules", judged on bytes and on the PLC's own states.

It follows the PLC by its state datagrams and remembers what those do not tell: source, trajectory, knots.
"""

from collections.abc import Hashable, Iterator
from dataclasses import dataclass, field

from benchmarks.link.fuzz.oracle_bytes import Subscription, command_breach, unframed
from benchmarks.link.fuzz.oracle_fields import CommandFields, StateFields, command_fields
from benchmarks.link.fuzz.oracle_knots import servo_target
from benchmarks.link.fuzz.oracle_ring import RingShadow
from benchmarks.link.fuzz.verdict import SILENT, TAKEN, Breach, Verdict, refused
from protocol.codes import Mode, PlcState, RejectCode
from protocol.limits import LimitTable, axis_mask

_ECHO_NS = 250_000_000
_JUMP = 1000
_START, _LINEAR, _QUINTIC = 2, 1, 3
_STOPS = {Mode.STOP, Mode.QUICK_STOP, Mode.DISARM}
_MOTIONS = (Mode.TRAJECTORY, Mode.SERVO)
_SPENDING = _STOPS | {Mode.HOLD}  # also what was only prefilled
_LOOKING = {Mode.HEARTBEAT, Mode.HOLD} | _STOPS
_MODES_TAKEN: dict[int, set[Mode]] = {  # "State | Modes taken"
    PlcState.BOOT: set(),
    PlcState.DISARMED: set(),
    PlcState.LINKED: _LOOKING | {Mode.ARM},
    PlcState.HOLD: _LOOKING | {Mode.ARM, Mode.TRAJECTORY, Mode.SERVO},
    PlcState.RUN: _LOOKING | {Mode.TRAJECTORY, Mode.SERVO},
    PlcState.STOPPING: _LOOKING | {Mode.TRAJECTORY, Mode.SERVO},
    PlcState.FAULT: _LOOKING | {Mode.RESET},
    PlcState.LOCAL: _LOOKING,
}


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What only somebody at the machine knows."""

    enable_given: bool = True
    fault_present: bool = False
    out_of_range: bool = False
    swinging: bool = False
    ramping: bool = False  # the reference does not follow the joints: held, moving, or still on a fault's ramp


@dataclass(slots=True)
class PlcOracle:
    """One PLC as seen from outside. `seen` is the newest state; `judge`, then `take` what was taken."""

    table: LimitTable
    cfg_id: int
    key: bytes
    eap: Subscription | None
    seen: StateFields = field(default_factory=StateFields)
    around: Surroundings = field(default_factory=Surroundings)
    source: Hashable = None
    traj_id: int = 0
    servo: bool = False
    spent: bool = False
    ring: RingShadow = field(init=False)

    def __post_init__(self) -> None:
        self.ring = RingShadow(self.table)

    # --- following the PLC --------------------------------------------------------------------------------------------

    def saw(self, seen: StateFields) -> None:
        """A newer state: a motion that has ended, or a silent PC, makes the trajectory old."""
        left_run = self.seen.plc_state == PlcState.RUN != seen.plc_state
        if left_run or (seen.session and seen.wd_trips > self.seen.wd_trips):
            self.spent = True
        if not seen.session:
            self.traj_id, self.servo, self.spent = 0, False, False
        self.seen = seen

    def take(self, payload: bytes, source: Hashable) -> PlcState:
        """Remember what was taken; the state that the PLC must be in now."""
        command = command_fields(payload)
        before = PlcState(self.seen.plc_state)
        if self._opens(command):
            self.source, self.traj_id, self.servo, self.spent = source, 0, False, False
            self.ring.clear()
            return PlcState.LINKED if before is PlcState.DISARMED else before
        mode = Mode.HEARTBEAT if command.hello else Mode(command.mode)
        if mode in _SPENDING:
            self.spent = True
        if mode in _MOTIONS:
            return self._take_motion(command, mode, before)
        return _after(before, mode)

    def _take_motion(self, command: CommandFields, mode: Mode, before: PlcState) -> PlcState:
        if before is PlcState.STOPPING or self._is_over(command):
            return before
        if before is PlcState.RUN and command.traj_id != self.traj_id:
            return PlcState.STOPPING
        if mode is Mode.SERVO:
            if command.traj_id != self.ring.traj_id:
                self.ring.clear(command.traj_id)
        else:
            self.ring.load(command, self.seen)
        self.traj_id, self.servo, self.spent = command.traj_id, mode is Mode.SERVO, False
        return PlcState.RUN if command.cmd_flags & _START else before

    def _is_over(self, command: CommandFields) -> bool:
        return self.spent and command.traj_id == self.traj_id

    # --- judging ------------------------------------------------------------------------------------------------------

    def judge(self, datagram: bytes, source: Hashable, t_plc_ns: int) -> Verdict:
        """What must become of a datagram; the first rule that it breaks counts."""
        payload = unframed(datagram, self.eap)
        if isinstance(payload, Breach):
            return refused(payload)
        breach = command_breach(payload, self.key)
        if breach is not None:
            return refused(breach)
        command = command_fields(payload)
        if self._opens(command):
            breach = self._against_hello(command)
            return TAKEN if breach is None else refused(breach)
        if not self.seen.session or command.session != self.seen.session:
            return refused(Breach(RejectCode.SESSION, 16))
        if source != self.source:
            return refused(Breach(RejectCode.SOURCE, 16))
        distance = (command.seq - self.seen.ack_seq) & 0xFFFF_FFFF
        if distance == 0 or distance >= 0x1_0000_0000 - _JUMP:
            return SILENT
        if distance > _JUMP:
            return refused(Breach(RejectCode.SEQ_JUMP, 20))
        return self._judge_wish(command, t_plc_ns)

    def _opens(self, command: CommandFields) -> bool:
        return command.hello and (not self.seen.session or command.session != self.seen.session)

    def _against_hello(self, command: CommandFields) -> Breach | None:
        if self.seen.session or not command.session:
            return Breach(RejectCode.SESSION, 16)
        if self.seen.plc_state == PlcState.BOOT:
            return Breach(RejectCode.MODE_ILLEGAL, 48)
        return None if command.cfg_id == self.cfg_id else Breach(RejectCode.CFG, 52)

    def _judge_wish(self, command: CommandFields, t_plc_ns: int) -> Verdict:
        """Rules 5 to 7."""
        mode = Mode.HEARTBEAT if command.hello else Mode(command.mode)
        if mode not in _MODES_TAKEN[self.seen.plc_state]:
            return refused(Breach(RejectCode.MODE_ILLEGAL, 48))
        if mode in _STOPS:
            return TAKEN
        breach = next(self._against_wish(command, mode, t_plc_ns), None)
        if breach is not None:
            return refused(breach)
        if mode in _MOTIONS and not self._without_effect(command):
            return self._judge_motion(command, mode)
        if mode is Mode.ARM and self.seen.plc_state == PlcState.LINKED:
            return _verdict(list(self._against_arming()))
        not_yet = mode is Mode.RESET and (self.around.fault_present or self.around.ramping)
        return refused(Breach(RejectCode.FAULT_PRESENT, 48)) if not_yet else TAKEN

    def _against_wish(self, command: CommandFields, mode: Mode, t_plc_ns: int) -> Iterator[Breach]:
        """Echo, limits, nonce, proof of the link, number of the trajectory: in this order."""
        armed = self.seen.plc_state in (PlcState.HOLD, PlcState.RUN, PlcState.STOPPING)
        nothing_seen_yet = not armed and command.ack_plc_seq == 0 and mode is not Mode.ARM
        if not nothing_seen_yet and not 0 <= t_plc_ns - command.t_plc_echo_ns <= _ECHO_NS:
            yield Breach(RejectCode.ECHO_STALE, 40)
        if command.cfg_id != self.cfg_id:
            yield Breach(RejectCode.CFG, 52)
        if mode is Mode.ARM:
            if command.arm_nonce != self.seen.nonce:
                yield Breach(RejectCode.NONCE, 32)
            if self.seen.plc_state == PlcState.LINKED and self.seen.rx_ok < 25:
                yield Breach(RejectCode.LINK_NOT_PROVEN, 48)
        if mode in _MOTIONS:
            if command.traj_id == 0 or command.traj_id < self.traj_id:
                yield Breach(RejectCode.TRAJ_ID, 56)
            if command.traj_id == self.traj_id and self.servo is not (mode is Mode.SERVO):
                yield Breach(RejectCode.MODE_ILLEGAL, 48)

    def _without_effect(self, command: CommandFields) -> bool:
        """A motion that nothing is taken of: over, while stopping, or another one while one runs."""
        state = self.seen.plc_state
        other = state == PlcState.RUN and command.traj_id != self.traj_id
        return state == PlcState.STOPPING or other or self._is_over(command)

    def _against_arming(self) -> Iterator[Breach]:
        around = self.around
        if not around.enable_given:
            yield Breach(RejectCode.ENABLE, 48)
        if around.fault_present or self.seen.fault_bits:
            yield Breach(RejectCode.FAULT_PRESENT, 48)
        if around.out_of_range:
            yield Breach(RejectCode.LIMIT_Q, 48)
        if around.swinging or around.ramping:
            yield Breach(RejectCode.LAG, 48)

    def _judge_motion(self, command: CommandFields, mode: Mode) -> Verdict:
        if command.axis_mask != axis_mask(self.table):
            return refused(Breach(RejectCode.AXIS_MASK, 50))
        if not 0.0 <= command.speed_override <= 1.0:
            return refused(Breach(RejectCode.OVERRIDE, 72))
        if command.interp != (_LINEAR if mode is Mode.SERVO else _QUINTIC):
            return refused(Breach(RejectCode.INTERP, 65))
        if mode is Mode.TRAJECTORY:
            return _verdict(list(self.ring.breaches(command, self.seen)))
        if len(command.knots) != 1:
            return refused(Breach(RejectCode.VALUE, 64))
        return _verdict(list(servo_target(command.knots[0], self.seen.q_ref, self.table)))


def _verdict(breaches: list[Breach]) -> Verdict:
    """Refused if one is sure; else taken, though a refusal for what rounding decides is right too."""
    verdict = refused(*breaches)
    return verdict if any(breach.sure for breach in breaches) else Verdict(TAKEN.kind, verdict.may)


def _after(before: PlcState, mode: Mode) -> PlcState:
    """The state after a command without knots."""
    if mode is Mode.ARM and before is PlcState.LINKED:
        return PlcState.HOLD
    if mode is Mode.RESET:
        return PlcState.DISARMED
    if mode is Mode.DISARM and before in (PlcState.LINKED, PlcState.HOLD):
        return PlcState.DISARMED
    if before is PlcState.RUN and (mode in _STOPS or mode is Mode.HOLD):
        return PlcState.STOPPING
    return before
