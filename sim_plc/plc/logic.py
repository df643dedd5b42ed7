"""The PLC program's cycle: datagrams in, state machine, reference, joint controllers, valve commands and states out."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass

from machine.description import Machine
from protocol.codes import AxisBit, FaultBit, Mode, PlcState, RejectCode, WarnBit
from protocol.framing import Framing
from protocol.limits import axis_mask, cfg_id, limits_of
from protocol.messages import Command, PlcStatus, axes8
from protocol.plc_events import Accepted, Effect, PlcLinkEvent, StateChanged
from protocol.plc_link import PlcLink, PlcLinkSettings
from protocol.plc_states import PlcEvent
from sim_plc.plc.control import JointControllers
from sim_plc.plc.reference import PlaybackStatus, Ramp, RingPlayback, ramp_from
from sim_plc.plc.ring import KnotRing

SOFT_STOP_FRAC = 0.7  # share of qdd_max used by a normal stop; a quick stop uses all of it
LAG_ARM_RAD = 0.05  # the reference starts at the joint, so more is a sensor fault
LAG_FAULT_RAD = 0.7  # beyond any velocity lag |qd| / (kp velocity_gain) of this machine: the joint does not follow
ARMED = (PlcState.HOLD, PlcState.RUN, PlcState.STOPPING)


@dataclass(frozen=True, slots=True)
class PlantSample:
    """What the PLC's inputs tell in one cycle."""

    q_rad: tuple[float, ...]
    qd_rad_s: tuple[float, ...]
    p_a_pa: tuple[float, ...]
    p_b_pa: tuple[float, ...]
    p_supply_pa: float
    t_oil_c: float


class PlcLogic:
    """One PLC. `cycle` is called every PLC cycle with the PLC's own clock; `local_enable` is the key at the machine."""

    def __init__(
        self, machine: Machine, framing: Framing, draw_nonce: Callable[[], int], local_enable: bool = True
    ) -> None:
        self._machine = machine
        self._n = len(machine.joints)
        self._table = limits_of(machine.joints)
        self._mask = axis_mask(self._table)
        settings = PlcLinkSettings(cfg_id=cfg_id(self._table), simulation=True)
        self.link = PlcLink(settings, framing, draw_nonce, self._check)
        self.local_enable = local_enable
        self._ring = KnotRing(self._table)
        self._playback = RingPlayback(self._ring)
        self._controllers = JointControllers(machine.joints, machine.plc_cycle_s)
        self._cycle_ns = round(machine.plc_cycle_s * 1e9)
        self._ramp: Ramp | None = None
        self._q_ref = [0.0] * self._n
        self._qd_ref = [0.0] * self._n
        self._valves = [0.0] * self._n
        self._sample: PlantSample | None = None
        self._cycles = 0
        self._underruns = 0
        self._faults = FaultBit(0)
        self._ended_traj = 0
        self._quick = False

    @property
    def state(self) -> PlcState:
        """The PLC's state."""
        return self.link.state

    @property
    def q_ref(self) -> tuple[float, ...]:
        """The reference of the joint controllers [rad]."""
        return tuple(self._q_ref)

    @property
    def qd_ref(self) -> tuple[float, ...]:
        """Its velocity [rad/s]."""
        return tuple(self._qd_ref)

    def receive(self, datagram: bytes, t_plc_ns: int, source: Hashable = None) -> None:
        """Take one datagram; any bytes may come."""
        self._handle(self.link.receive(datagram, t_plc_ns, source), t_plc_ns)

    def cycle(self, t_plc_ns: int, sample: PlantSample) -> list[float]:
        """One cycle: valve commands (n,), fraction of full command."""
        self._cycles += 1
        self._sample = sample
        if self.state is PlcState.BOOT:
            self._handle(self.link.apply(PlcEvent.BOOTED, t_plc_ns), t_plc_ns)
        self._handle(self.link.poll(t_plc_ns), t_plc_ns)
        self._watch_lag(t_plc_ns, sample)
        self._move_reference(t_plc_ns, sample)
        self._valves = self._controllers.valves(self._q_ref, sample.q_rad) if self._active else [0.0] * self._n
        return self._valves

    def send(self, t_plc_ns: int) -> bytes:
        """The state datagram of this moment."""
        return self.link.send(self._status(), t_plc_ns)

    @property
    def _active(self) -> bool:
        return self.state in ARMED or (self.state is PlcState.FAULT and self._ramp is not None)

    def take_fault(self, bit: FaultBit, t_plc_ns: int) -> None:
        """Latch a fault: ramp down, then valves neutral."""
        self._faults |= bit
        self._handle(self.link.apply(PlcEvent.FAULT, t_plc_ns), t_plc_ns)

    def set_local(self, taken: bool, t_plc_ns: int) -> None:
        """The local lever is taken or released."""
        event = PlcEvent.LOCAL_ON if taken else PlcEvent.LOCAL_OFF
        self._handle(self.link.apply(event, t_plc_ns), t_plc_ns)

    def _handle(self, events: list[PlcLinkEvent], t_plc_ns: int) -> None:
        for event in events:
            match event:
                case StateChanged():
                    self._enter(event, t_plc_ns)
                case Accepted(command=command, effect=Effect.LOAD):
                    self._load(command)
                case Accepted(effect=Effect.QUICK_STOP) if self.state is PlcState.STOPPING and not self._quick:
                    self._quick = True
                    self._begin_ramp(t_plc_ns, 1.0)
                case Accepted(effect=Effect.RESET):
                    self._faults = FaultBit(0)
                case _:
                    pass

    def _enter(self, change: StateChanged, t_plc_ns: int) -> None:
        old, new = change.old, change.new
        if new is PlcState.HOLD and old is PlcState.LINKED:
            self._hold_here()
        elif new is PlcState.RUN:
            self._playback.restart()
        elif new in (PlcState.STOPPING, PlcState.FAULT) and old in ARMED:
            self._quick = change.event is PlcEvent.QUICK_STOP
            self._begin_ramp(t_plc_ns, 1.0 if self._quick else SOFT_STOP_FRAC)
        elif new in (PlcState.DISARMED, PlcState.LOCAL):
            self._ramp = None

    def _hold_here(self) -> None:
        """Arming: the reference is where the joints are."""
        self._controllers.reset()
        if self._sample is not None:
            self._q_ref = list(self._sample.q_rad)
        self._qd_ref = [0.0] * self._n

    def _begin_ramp(self, t_plc_ns: int, share: float) -> None:
        stops = tuple(joint.qdd_max_rad_s2 * share for joint in self._machine.joints)
        self._ramp = ramp_from(self._q_ref, self._qd_ref, t_plc_ns, stops)

    def _load(self, command: Command) -> None:
        self._ring.load(command)

    def _check(self, command: Command, state: PlcState) -> RejectCode:
        """The program's own last word on a command; changes nothing."""
        match command.mode:
            case Mode.ARM:
                return self._check_arm()
            case Mode.RESET:
                return RejectCode.NONE if not self._lagging() else RejectCode.FAULT_PRESENT
            case Mode.TRAJECTORY:
                if command.axis_mask != self._mask:
                    return RejectCode.AXIS_MASK
                return self._ring.check(command, axes8(tuple(self._q_ref)), self._playback.playing)
            case _:
                return RejectCode.NONE

    def _check_arm(self) -> RejectCode:
        if not self.local_enable:
            return RejectCode.ENABLE
        if self._faults:
            return RejectCode.FAULT_PRESENT
        return RejectCode.NONE if self._sample is not None else RejectCode.LAG

    def _lagging(self) -> bool:
        if self._sample is None:
            return True
        pairs = zip(self._q_ref, self._sample.q_rad, strict=True)
        return any(abs(reference - q) > LAG_FAULT_RAD for reference, q in pairs)

    def _watch_lag(self, t_plc_ns: int, sample: PlantSample) -> None:
        if self.state in ARMED and self._lagging():
            self.take_fault(FaultBit.LAG, t_plc_ns)

    def _move_reference(self, t_plc_ns: int, sample: PlantSample) -> None:
        state = self.state
        if state is PlcState.RUN:
            self._play(t_plc_ns)
        elif self._ramp is not None and state in (PlcState.STOPPING, PlcState.FAULT):
            at_rest, self._q_ref, self._qd_ref = self._ramp.at(t_plc_ns)
            if at_rest:
                self._ramp = None
                self._handle(self.link.apply(PlcEvent.AT_REST, t_plc_ns), t_plc_ns)
        elif state not in ARMED:
            self._q_ref, self._qd_ref = list(sample.q_rad), [0.0] * self._n

    def _play(self, t_plc_ns: int) -> None:
        status, q, qd = self._playback.advance(self._cycle_ns, self._n)
        if status is not PlaybackStatus.UNDERRUN:
            self._q_ref, self._qd_ref = q, qd
        if status is PlaybackStatus.ENDED:
            self._qd_ref = [0.0] * self._n
            self._handle(self.link.apply(PlcEvent.END, t_plc_ns), t_plc_ns)
        elif status is PlaybackStatus.UNDERRUN:
            self._underruns += 1
            self._handle(self.link.apply(PlcEvent.SOFT_STOP, t_plc_ns), t_plc_ns)

    def _status(self) -> PlcStatus:
        zeros = (0.0,) * self._n
        sample = self._sample or PlantSample(zeros, zeros, zeros, zeros, 0.0, 0.0)
        ring, playback = self._ring, self._playback
        return PlcStatus(
            plc_cycle=self._cycles & 0xFFFF_FFFF,
            plc_cycle_us=self._cycle_ns // 1000,
            mode_active=Mode.TRAJECTORY if self.state is PlcState.RUN else Mode.HOLD,
            axis_mask=self._mask,
            fault_bits=int(self._faults),
            warn_bits=int(WarnBit(0)),
            traj_id=ring.traj_id,
            knot_playing=playback.playing,
            knot_last=max(ring.last, 0),
            t_play_ns=playback.t_play_ns,
            buffer_us=playback.buffer_ns // 1000,
            underruns=self._underruns,
            q=axes8(sample.q_rad),
            qd=axes8(sample.qd_rad_s),
            q_ref=axes8(tuple(self._q_ref)),
            qd_ref=axes8(tuple(self._qd_ref)),
            valve_cmd=axes8(tuple(self._valves)),
            p_a=axes8(sample.p_a_pa),
            p_b=axes8(sample.p_b_pa),
            axis_status=tuple(self._axis_status(i, sample) for i in range(8)),
            p_supply=sample.p_supply_pa,
            p_tank=1e5,
            t_oil=sample.t_oil_c,
            simulation=True,
        )

    def _axis_status(self, i: int, sample: PlantSample) -> int:
        if i >= self._n:
            return 0
        axis, bits = self._table.axes[i], AxisBit.IN_USE
        if sample.q_rad[i] <= axis.q_min:
            bits |= AxisBit.AT_Q_MIN
        if sample.q_rad[i] >= axis.q_max:
            bits |= AxisBit.AT_Q_MAX
        if abs(self._valves[i]) >= 1.0:
            bits |= AxisBit.VALVE_SATURATED
        return int(bits)
