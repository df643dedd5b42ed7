"""What must hold in every PLC cycle, whatever the network does; each breach is noted with its time.

Limits, in shares of the machine's qd_max and qdd_max:
- speed, and acceleration as difference of qd_ref between cycles: at most 1.10, the margin that the PLC's own check of
  the knots leaves to the quintic between them;
- a straight stop, and servo mode: acceleration at most 1, they are not bound to any knots;
- no step in q_ref: it moves by the mean of both speeds, up to what an acceleration changes within one cycle.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from numba import njit

from machine.rotations import Array
from protocol.codes import FaultBit, PlcState
from protocol.plc_events import CommandAccepted, PlcAction, PlcLinkEvent, StateChanged
from protocol.plc_states import ARMED_STATES
from protocol.timeouts import COMMAND_LOST_TIMEOUT
from sim_plc.plc.logic import PlcLogic
from sim_plc.plc.reference import Motion

BETWEEN = 1.10  # what the PLC's check of the knots allows between them
_TINY = 1e-9
_REST_STEP = 2e-6  # rad/s: knots "at rest" may move this fast, and are then settled
_MOTIONS = tuple(Motion)
_PLAYED = (Motion.PLAY, Motion.SERVO)
_RAMPS = (Motion.PATH_STOP, Motion.JOINT_STOP)
_MAY_RAMP = (PlcState.FAULT, PlcState.LOCAL)  # a ramp that began while armed ends here
_IMMEDIATE = FaultBit.SENSOR | FaultBit.ESTOP  # no ramp: the valves go neutral at once
_NO_FAULT = FaultBit(0)
SPEED, REPORTED, ACCELERATION, STEP = range(4)  # columns of `Watch.worst`


@njit(cache=True)
def measure(
    now: tuple[Array, Array, Array],
    q: Array,
    qd: Array,
    qd_max: Array,
    qdd_max: Array,
    dt: float,
    slack: float,
    row: Array,
) -> None:
    """Largest shares of the limits of this cycle, into row (4,), where it is larger than what is there.

    Model:   |qd| / qd_max, |qdd| / qdd_max as the reference tells it, |qd - qd_before| / (qdd_max dt), and
             (|q - q_before - (qd + qd_before) dt / 2| - slack) / (qdd_max dt^2); slack [rad].
    """
    q_now, qd_now, qdd_now = now
    for j in range(q_now.shape[0]):
        row[0] = max(row[0], abs(qd_now[j]) / qd_max[j])
        row[1] = max(row[1], abs(qdd_now[j]) / qdd_max[j])
        row[2] = max(row[2], (abs(qd_now[j] - qd[j]) - 2e-6) / (qdd_max[j] * dt))
        drift = abs(q_now[j] - q[j] - 0.5 * (qd_now[j] + qd[j]) * dt)
        row[3] = max(row[3], (drift - slack - 2e-6 * dt) / (qdd_max[j] * dt * dt))


@dataclass(frozen=True, slots=True)
class Breach:
    """An invariant that did not hold."""

    name: str
    t_s: float
    text: str


@dataclass(slots=True)
class Ramp:
    """A ramp under way: what is left of its bound."""

    cycles_left: int
    bound_s: float
    cycles: int = 0


@dataclass(slots=True)
class Longest:
    """The longest times met [ms], and the largest share of its bound that a ramp has taken."""

    run_in_silence_ms: float = 0.0  # in RUN since the last accepted command
    rest_in_silence_ms: float = 0.0  # from the last accepted command to rest, where silence ended it and no stall
    ramp_ms: float = 0.0
    ramp_share: float = 0.0

    def add(self, other: "Longest") -> None:
        """Keep the longer ones."""
        for name in (each.name for each in fields(self)):
            setattr(self, name, round(max(getattr(self, name), getattr(other, name)), 3))


@dataclass(slots=True)
class Watch:
    """Looks at one PLC after every datagram and every cycle. A restarted PLC gets a new one."""

    plc: PlcLogic
    breaches: list[Breach]
    worst: Array  # (number of motions, 4): see the columns above
    cycles_in: Counter[str]
    asked: set[tuple[int, int]]  # (session, traj_id) that the operator asked for
    ended_at: dict[tuple[int, int], tuple[float, ...]]  # where the reference was when it had played to the end
    started: set[tuple[int, int]] = field(default_factory=set)
    accepted_ns: int | None = None
    longest: Longest = field(default_factory=Longest)
    faults_seen: Counter[str] = field(default_factory=Counter)
    t_s: float = 0.0
    _before: Motion = Motion.FOLLOW
    _state_before: PlcState = PlcState.BOOT
    _q: Array = field(default_factory=lambda: np.zeros(0))
    _qd: Array = field(default_factory=lambda: np.zeros(0))
    _qd_max: Array = field(default_factory=lambda: np.zeros(0))
    _ramp: Ramp | None = None
    _underruns: int = 0
    _may_run: bool = False
    _latched: FaultBit = _NO_FAULT
    _row: Array = field(default_factory=lambda: np.zeros(4))
    _key: tuple[int, int] = (0, 0)
    _t_cycle_ns: int = 0
    _stalled: bool = False  # the PLC itself has stood still since the last accepted command

    def __post_init__(self) -> None:
        n = self.plc.settings.n
        self._q, self._qd = np.zeros(n), np.zeros(n)
        axes = self.plc.settings.limit_table.axes
        self._qd_max = np.array([axis.qd_max for axis in axes])

    def events(self, events: Sequence[PlcLinkEvent], t_plc_ns: int) -> None:
        """What a datagram has led to."""
        started = False
        for event in events:
            if isinstance(event, StateChanged) and event.new is PlcState.RUN:
                started = True
            elif isinstance(event, CommandAccepted):
                self.accepted_ns, self._stalled = t_plc_ns, False
                if started:
                    self._start(event)
                    started = False

    def cycle(self, t_plc_ns: int, valves: Array) -> None:
        """What the cycle has led to."""
        plc, reference = self.plc, self.plc.reference
        motion, state = reference.motion, plc.state
        self.cycles_in[state.name] += 1
        self._stalled |= t_plc_ns - self._t_cycle_ns > plc.settings.cycle_ns
        self._t_cycle_ns = t_plc_ns
        if motion is Motion.FOLLOW:
            if self._before is not Motion.FOLLOW or valves.any():
                self._followed(valves)
        else:
            self._moved(motion, state)
        if state is PlcState.RUN:
            self._ran(t_plc_ns)
        self._may_run = False
        if motion in _RAMPS:
            self._ramped(motion)
        elif self._ramp is not None:
            self._rested(self._ramp, t_plc_ns)
            self._ramp = None
        if plc.monitor.latched != self._latched:
            self._note_faults(plc.monitor.latched)
        self._before, self._state_before, self._underruns = motion, state, plc.underruns
        self._q[:] = reference.q
        self._qd[:] = reference.qd

    def at_end(self) -> None:
        """After the last silence: nothing is armed, nothing moves, no session is open."""
        plc = self.plc
        if plc.state not in (PlcState.DISARMED, PlcState.FAULT, PlcState.LOCAL, PlcState.BOOT):
            self._breach("silence does not disarm", f"still {plc.state.name}")
        if plc.reference.motion is not Motion.FOLLOW or plc.reference.qd.any() or plc.valves.any():
            self._breach("silence does not end motion", plc.reference.motion.value)
        if plc.link.session:
            self._breach("silence does not end the session", f"{plc.link.session:#x}")

    # --- one cycle ---------------------------------------------------------------------------------------------------

    def _breach(self, name: str, text: str) -> None:
        self.breaches.append(Breach(name, round(self.t_s, 4), text))

    def _start(self, event: CommandAccepted) -> None:
        """Motion begins: asked for, for the first time, with a number higher than any before."""
        key = self._key = (event.command.session, event.command.traj_id)
        if event.effect not in (PlcAction.LOAD, PlcAction.SERVO):
            self._breach("motion starts by itself", f"{event.effect.name} started it")
        if key in self.started or any(s == key[0] and i > key[1] for s, i in self.started):
            self._breach("motion resumes", f"trajectory {key[1]} again")
        if key not in self.asked:
            self._breach("motion nobody asked for", f"session {key[0]:#x}, trajectory {key[1]}")
        self.started.add(key)
        self._may_run = True

    def _followed(self, valves: Array) -> None:
        """Not controlled: valves neutral; and it may only become so at rest, or by a fault that allows no ramp."""
        if valves.any():
            self._breach("valves without control", f"{valves.round(4).tolist()}")
        if self.plc.reference.qd.any():
            self._breach("reference moves without control", f"{self.plc.reference.qd.tolist()}")
        limit = self.plc.settings.qdd_stop * self.plc.settings.cycle_s + _REST_STEP
        dropped = self._before is not Motion.FOLLOW and bool(np.any(np.abs(self._qd) > limit))
        if dropped and not self.plc.monitor.latched & _IMMEDIATE:
            self._breach("control dropped in motion", f"at {np.abs(self._qd).max():.3f} rad/s")

    def _moved(self, motion: Motion, state: PlcState) -> None:
        before, reference = self._before, self.plc.reference
        if before is not Motion.FOLLOW:
            self._measure(motion if motion is not Motion.HOLD else before)
        if motion is Motion.HOLD:
            if state is not PlcState.HOLD:
                self._breach("holding in a state that does not hold", state.name)
            still = before in (Motion.HOLD, Motion.FOLLOW)  # arming holds where the joints were seen last
            if still and not np.array_equal(reference.q, self._q):
                self._breach("reference moves while holding", f"{(reference.q - self._q).tolist()}")
            if before is Motion.PLAY and self.plc.ring.complete:
                self.ended_at[self._key] = self.plc.q_ref
        elif motion in _PLAYED:
            if state is not PlcState.RUN:
                self._breach("an unarmed PLC moves", f"{motion.value} in {state.name}")
        elif before not in (*_PLAYED, *_RAMPS) and not self._may_run:  # begun and stopped within one cycle is no breach
            self._breach("a ramp from rest", f"{motion.value} after {before.value}")
        if state not in ARMED_STATES and (motion not in _RAMPS or state not in _MAY_RAMP):
            self._breach("an unarmed PLC moves", f"{motion.value} in {state.name}")

    def _measure(self, motion: Motion) -> None:
        settings, row = self.plc.settings, self._row
        row[:] = 0.0
        reference = self.plc.reference
        now = (reference.q, reference.qd, reference.qdd)
        # a trajectory may begin that far from q_ref
        slack = settings.limit_table.start_tolerance_rad if self._before is Motion.HOLD else 0.0
        ramped = self._before in _RAMPS or (self._before in _PLAYED and not self._at_last_knot())
        if ramped and reference.motion is Motion.HOLD:
            slack = self._ramp_end_jump()
        measure(now, self._q, self._qd, self._qd_max, settings.qdd_stop, settings.cycle_s, slack, row)
        np.maximum(self.worst[_MOTIONS.index(motion)], row, out=self.worst[_MOTIONS.index(motion)])
        top = (1.0 if motion in (Motion.JOINT_STOP, Motion.SERVO) else BETWEEN) + _TINY
        if row[SPEED] > BETWEEN:
            self._breach("too fast", f"{row[SPEED]:.4f} of qd_max in {motion.value}")
        if row[ACCELERATION] > (BETWEEN if self._before is Motion.PLAY else top):
            self._breach("too hard", f"{row[ACCELERATION]:.4f} of qdd_max in {motion.value} after {self._before.value}")
        if row[STEP] > 0.5 * BETWEEN + _TINY:
            self._breach("step in q_ref", f"{row[STEP]:.4f} qdd_max dt^2 in {motion.value} after {self._before.value}")

    def _at_last_knot(self) -> bool:
        """Whether the reference has played to the end (and did not ramp down within one cycle)."""
        if self._before is Motion.SERVO:
            return self.plc.reference.servo.ending
        return self.plc.ring.complete and self.plc.reference.path_left_s <= _TINY

    def _ramp_end_jump(self) -> float:
        """At the end of a ramp the reference is set to where the joints are, and nowhere else."""
        joints, reference = self.plc.joints, self.plc.reference
        if not np.array_equal(reference.q, joints):
            self._breach("a ramp ends elsewhere than at the joints", f"{(reference.q - joints).tolist()}")
        return float(np.abs(reference.q - self._q).max())

    def _ran(self, t_plc_ns: int) -> None:
        if self._state_before is not PlcState.RUN and not self._may_run:
            self._breach("motion resumes", f"RUN after {self._state_before.name} without a start")
        silent_ns = t_plc_ns - self.accepted_ns if self.accepted_ns is not None else 1 << 60
        if silent_ns > COMMAND_LOST_TIMEOUT.duration_ns:
            self._breach("silence does not stop", f"RUN {silent_ns / 1e6:.0f} ms after the last accepted command")
        self.longest.run_in_silence_ms = max(self.longest.run_in_silence_ms, silent_ns / 1e6)

    def _ramped(self, motion: Motion) -> None:
        """A ramp lasts no longer than max |qd| / qdd_stop of reference and joints where it began, and two cycles.

        One for want of knots is bound to the path that is left: at most four times qd_max / qdd_max.
        """
        settings = self.plc.settings
        if self._ramp is None or (motion is Motion.JOINT_STOP and self._before is Motion.PATH_STOP):
            fastest = np.maximum(np.abs(self._qd), np.abs(self.plc.reference.qd_joints))
            bound_s = float(np.max(fastest / settings.qdd_stop)) + 2.0 * settings.cycle_s
            if self.plc.underruns > self._underruns:
                bound_s = 4.0 * float(np.max(self._qd_max / settings.qdd_stop))
            elif self._ramp is not None:
                bound_s = max(bound_s, self._ramp.cycles_left * settings.cycle_s)
            self._ramp = Ramp(math.ceil(bound_s / settings.cycle_s), bound_s)
        self._ramp.cycles_left -= 1
        self._ramp.cycles += 1
        if self._ramp.cycles_left < 0:
            self._breach("ramp too long", f"{motion.value}, bound {self._ramp.bound_s:.3f} s")

    def _rested(self, ramp: Ramp, t_plc_ns: int) -> None:
        cycle_s, longest = self.plc.settings.cycle_s, self.longest
        longest.ramp_ms = max(longest.ramp_ms, (ramp.cycles + 1) * cycle_s * 1e3)
        longest.ramp_share = max(longest.ramp_share, (ramp.cycles + 1) * cycle_s / ramp.bound_s)
        silent_ns = t_plc_ns - self.accepted_ns if self.accepted_ns is not None else 0
        if silent_ns > COMMAND_LOST_TIMEOUT.duration_ns and not self._stalled:
            longest.rest_in_silence_ms = max(longest.rest_in_silence_ms, silent_ns / 1e6)

    def _note_faults(self, latched: FaultBit) -> None:
        for bit in FaultBit:
            if bit in latched and bit not in self._latched:
                self.faults_seen[bit.name or ""] += 1
        self._latched = latched
