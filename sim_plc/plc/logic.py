"""The PLC's cycle: datagrams in, state machine, reference, joint controllers, valve commands and states out. Pure."""

from collections.abc import Callable, Hashable

import numpy as np

from machine.description import Machine
from machine.rotations import Array
from protocol.codes import FaultBit, Interp, Mode, PlcState, RejectCode
from protocol.framing import Framing
from protocol.limits import axis_mask, cfg_id
from protocol.messages import Command, pad_to_eight_axes
from protocol.objection import Objection, object_to
from protocol.plc_events import CommandAccepted, PlcAction, PlcLinkEvent, SessionOpened, StateChanged
from protocol.plc_link import PlcLink, PlcLinkSettings
from protocol.plc_states import ARMED_STATES, PlcEvent
from sim_plc.plc.knot_ring import KnotRing, PlaybackView
from sim_plc.plc.local_panel import LocalPanel
from sim_plc.plc.monitor import Monitor
from sim_plc.plc.reference import Motion, Reference
from sim_plc.plc.sample import PlantSample, with_finite_readings
from sim_plc.plc.servo import check_target
from sim_plc.plc.settings import ARMING_SPEED_MAX_RAD_S, LOST_CYCLES_MAX, plc_settings
from sim_plc.plc.status import JointControl, PlcCounters, status_of


class PlcNotStartedError(RuntimeError):
    """A state was requested before the first cycle."""


class PlcLogic:
    """One PLC program. Call `run_cycle` once per cycle with the PLC's own clock, `receive` for datagrams before it."""

    def __init__(
        self,
        machine: Machine,
        framing: Framing,
        draw_nonce: Callable[[], int],
        panel: LocalPanel | None = None,
        key: bytes = b"",
        dry_run: bool = False,
    ) -> None:
        self.settings = plc_settings(machine)
        self.panel = LocalPanel() if panel is None else panel
        self._mask = axis_mask(self.settings.limit_table)
        self._dry_run = dry_run
        link_settings = PlcLinkSettings(cfg_id(self.settings.limit_table), simulation=True, key=key)
        self.link = PlcLink(link_settings, framing, draw_nonce, self._check)
        self.ring = KnotRing(self.settings.limit_table)
        self.reference = Reference(self.settings, self.ring)
        self.monitor = Monitor(self.settings)
        self._control = JointControl(self.settings)
        self._sample: PlantSample | None = None
        self._t_cycle_ns: int | None = None
        self._counters = PlcCounters()

    @property
    def state(self) -> PlcState:
        """The PLC's state."""
        return self.link.state

    @property
    def q_ref(self) -> tuple[float, ...]:
        """The joint controllers' reference [rad]."""
        return tuple(self.reference.q.tolist())

    @property
    def qd_ref(self) -> tuple[float, ...]:
        """Its velocity [rad/s]."""
        return tuple(self.reference.qd.tolist())

    @property
    def joints(self) -> Array:
        """The encoders' positions of the last cycle (n,) [rad]."""
        return np.zeros(self.settings.n) if self._sample is None else self._sample.q_rad

    @property
    def valves(self) -> Array:
        """Valve commands of the last cycle (n,); a view that the next cycle changes."""
        return self._control.valves

    @property
    def underruns(self) -> int:
        """How often the knots ran out before the end of a trajectory."""
        return self._counters.n_underruns

    def receive(self, datagram: bytes, t_plc_ns: int, source: Hashable = None) -> list[PlcLinkEvent]:
        """Take one datagram; any bytes may come. Returns what it led to, for the shell's log."""
        return self._handle_link_events(self.link.receive(datagram, t_plc_ns, source), t_plc_ns)

    def run_cycle(self, t_plc_ns: int, sample: PlantSample) -> Array:
        """One cycle: valve commands (n,) [fraction of full command]; a view that the next cycle changes."""
        self._counters.n_cycles += 1
        self._sample = sample = with_finite_readings(sample)
        if self.link.state is PlcState.BOOT:
            self._apply_link_event(PlcEvent.BOOTED, t_plc_ns)
        self._monitor_sample(sample, t_plc_ns)
        self._handle_link_events(self.link.poll(t_plc_ns), t_plc_ns)
        self._move(sample, t_plc_ns)
        if self._dry_run or self.reference.motion is Motion.FOLLOW:
            return self._control.neutral()
        return self._control.control(self.reference.q, sample.q_rad, self.reference.fade)

    def send(self, t_plc_ns: int) -> bytes:
        """The state datagram of this moment; it goes to `link.receivers()`."""
        if self._sample is None:
            raise PlcNotStartedError("PLC: no state before the first cycle")
        status = status_of(
            self.settings, self._counters, self.ring, self.reference, self.monitor, self._control.valves, self._sample,
            self._dry_run,
        )  # fmt: skip
        return self.link.send(status, t_plc_ns)

    def latch_faults(self, faults: FaultBit, t_plc_ns: int) -> None:
        """Latch faults: ramp down, then valves neutral until RESET and a new arming."""
        self.monitor.latch(faults)
        self._apply_link_event(PlcEvent.FAULT, t_plc_ns)
        if faults & (FaultBit.SENSOR | FaultBit.ESTOP) and self._sample is not None:
            self.reference.let_go()  # without encoders or oil there is no ramp: valves neutral immediately

    # --- one cycle --------------------------------------------------------------------------------------------------

    def _monitor_sample(self, sample: PlantSample, t_plc_ns: int) -> None:
        controlled = self.reference.motion is not Motion.FOLLOW
        monitor, reference = self.monitor, self.reference
        reference.qd_joints[:] = np.where(np.isfinite(sample.qd_rad_s), sample.qd_rad_s, 0.0)
        self._watch_lever(t_plc_ns)
        since_s = 0.0 if self._t_cycle_ns is None else (t_plc_ns - self._t_cycle_ns) * 1e-9
        faults = monitor.look(
            sample.q_rad, sample.qd_rad_s, reference.q, sample.p_supply_pa, sample.t_oil_c, controlled,
            self._dry_run, since_s,
        ) | self._own_faults(t_plc_ns)  # fmt: skip
        if faults and faults & ~monitor.latched:
            self.latch_faults(faults, t_plc_ns)

    def _own_faults(self, t_plc_ns: int) -> FaultBit:
        """Faults of the panel and of the PLC's own task."""
        before, self._t_cycle_ns = self._t_cycle_ns, t_plc_ns
        faults = FaultBit.ESTOP if self.panel.estop_pressed else FaultBit(0)
        if self.state in ARMED_STATES:
            if self.panel.is_enable_withdrawn:
                faults |= FaultBit.LOCAL_ENABLE_LOST
            if before is not None and t_plc_ns - before > LOST_CYCLES_MAX * self.settings.cycle_ns:
                faults |= FaultBit.CYCLE_OVERRUN
        return faults

    def _watch_lever(self, t_plc_ns: int) -> None:
        """The local lever overrules the network; it does not overrule a fault."""
        state, taken = self.state, self.panel.lever_taken
        if taken and state not in (PlcState.LOCAL, PlcState.FAULT):
            self._apply_link_event(PlcEvent.LOCAL_ON, t_plc_ns)
        elif not taken and state is PlcState.LOCAL and self.reference.motion is Motion.FOLLOW:
            self._apply_link_event(PlcEvent.LOCAL_OFF, t_plc_ns)

    def _move(self, sample: PlantSample, t_plc_ns: int) -> None:
        reference = self.reference
        if reference.motion is Motion.FOLLOW:
            if not (self.monitor.present and self.monitor.present & FaultBit.SENSOR):
                reference.follow_joints(sample.q_rad)
            return
        if reference.starving():
            self._counters.trajectory_starved = True
            self._counters.n_underruns += 1
            reference.stop_along_path()
            self._apply_link_event(PlcEvent.SOFT_STOP, t_plc_ns)
        played = reference.motion in (Motion.PLAY, Motion.SERVO)
        if reference.step(t_plc_ns):
            self._settle(sample, played)
            if self.state in (PlcState.RUN, PlcState.STOPPING):
                self._apply_link_event(PlcEvent.END if played else PlcEvent.AT_REST, t_plc_ns)
            if self.state not in ARMED_STATES:
                reference.follow_joints(sample.q_rad)

    def _settle(self, sample: PlantSample, played: bool) -> None:
        """The end of a motion: at its last knot, or after a ramp where the joints have come to rest behind it."""
        if played:
            self.reference.settle()
        else:
            self._control.neutral()
            self.reference.settle_at(sample.q_rad)

    # --- link events ------------------------------------------------------------------------------------------------

    def _apply_link_event(self, event: PlcEvent, t_plc_ns: int) -> None:
        self._handle_link_events(self.link.apply(event, t_plc_ns), t_plc_ns)

    def _handle_link_events(self, events: list[PlcLinkEvent], t_plc_ns: int) -> list[PlcLinkEvent]:
        for event in events:
            match event:
                case StateChanged(new=new):
                    self._enter_state(event.old, new, event.event)
                case CommandAccepted(command=command, effect=PlcAction.LOAD):
                    self._load(command)
                case CommandAccepted(command=command, effect=PlcAction.SERVO):
                    self._load_servo(command, t_plc_ns)
                case CommandAccepted(effect=PlcAction.QUICK_STOP):
                    self.reference.quick_stop()
                case CommandAccepted(effect=PlcAction.RESET):
                    self.monitor.clear()
                case SessionOpened():
                    self.reference.leave_path()
                    self.ring.clear()
                    self.reference.rewind()
                case _:
                    pass
        return events

    def _enter_state(self, old: PlcState, new: PlcState, event: PlcEvent) -> None:
        reference = self.reference
        if new is PlcState.HOLD and old is PlcState.LINKED:
            self._control.neutral()
            if self._sample is not None:
                reference.hold_at(self._sample.q_rad)
        elif event is PlcEvent.QUICK_STOP:
            reference.quick_stop()
        elif old is PlcState.RUN and new is not PlcState.HOLD:
            reference.stop()
        if new is PlcState.DISARMED:
            self.panel.disarmed()
        if new not in ARMED_STATES and reference.motion is Motion.HOLD and self._sample is not None:
            reference.follow_joints(self._sample.q_rad)

    def _load(self, command: Command) -> None:
        if command.traj_id != self.ring.traj_id:
            self.reference.rewind()
            self._counters.trajectory_starved = False
        self.ring.load_knots(command, self._view())
        self.reference.speed_override = command.speed_override
        if self.state is PlcState.RUN and self.reference.motion is Motion.HOLD:
            self.reference.play_from_start()

    def _load_servo(self, command: Command, t_plc_ns: int) -> None:
        if command.traj_id != self.ring.traj_id:
            self.ring.clear()
            self.ring.traj_id = command.traj_id
            self.reference.rewind()
            self._counters.trajectory_starved = False
        self.reference.servo.load_target(command, t_plc_ns)
        self.reference.speed_override = command.speed_override
        if self.state is PlcState.RUN and self.reference.motion is Motion.HOLD:
            self.reference.start_servo()

    # --- the last word on a command -----------------------------------------------------------------------------------

    def _view(self) -> PlaybackView:
        reference = self.reference
        return PlaybackView(pad_to_eight_axes(self.q_ref), reference.knot_playing, reference.t_play_ns)

    def _check(self, command: Command, state: PlcState) -> Objection | None:
        """What the PLC's own rules have against a command; changes nothing."""
        match command.mode:
            case Mode.ARM if state is PlcState.LINKED:
                return self._check_arm()
            case Mode.RESET if self._is_fault_present():
                return object_to(RejectCode.FAULT_PRESENT, "mode")
            case Mode.TRAJECTORY | Mode.SERVO:
                return self._check_motion(command, state)
            case _:
                return None

    def _is_fault_present(self) -> bool:
        """Whether a cause is still there, or the ramp that a fault began is not over."""
        ramping = self.reference.motion is not Motion.FOLLOW
        return bool(self.monitor.present) or self.panel.estop_pressed or ramping

    def _check_arm(self) -> Objection | None:
        sample, settings = self._sample, self.settings
        if not self.panel.may_arm:
            return object_to(RejectCode.ENABLE, "mode")
        if self.monitor.latched or self.monitor.present or sample is None:
            return object_to(RejectCode.FAULT_PRESENT, "mode")
        if np.any(sample.q_rad < settings.q_min) or np.any(sample.q_rad > settings.q_max):
            return object_to(RejectCode.LIMIT_Q, "mode")
        resting = (
            self.reference.motion is Motion.FOLLOW and float(np.abs(sample.qd_rad_s).max()) <= ARMING_SPEED_MAX_RAD_S
        )
        return None if resting else object_to(RejectCode.LAG, "mode")

    def _check_motion(self, command: Command, state: PlcState) -> Objection | None:
        other = command.traj_id != self.ring.traj_id
        if state is PlcState.STOPPING or (state is PlcState.RUN and other):
            return None  # the link makes a keepalive or a stop of it; no knot is taken
        if command.axis_mask != self._mask:
            return object_to(RejectCode.AXIS_MASK, "axis_mask")
        if not 0.0 <= command.speed_override <= 1.0:
            return object_to(RejectCode.OVERRIDE, "speed_override")
        if command.mode is Mode.SERVO:
            return check_target(command, pad_to_eight_axes(self.q_ref), self.settings)
        if command.interp is not Interp.QUINTIC:
            return object_to(RejectCode.INTERP, "interp")
        return self.ring.check(command, self._view())
