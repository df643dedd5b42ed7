"""The PLC's end under test: a whole PLC program with a machine that follows, brought into any of its states."""

from collections.abc import Hashable
from dataclasses import dataclass
from random import Random

import numpy as np

from benchmarks.link.fuzz.frames import Wire, sealed
from benchmarks.link.fuzz.honest_pc import HonestPc
from benchmarks.link.fuzz.mutators import with_value
from benchmarks.link.fuzz.oracle_bytes import Subscription, state_breach
from benchmarks.link.fuzz.oracle_fields import state_fields
from benchmarks.link.fuzz.oracle_plc import PlcOracle, Surroundings
from machine.description import Machine
from protocol.codec import decode_state
from protocol.codes import FaultBit, Mode, PlcState
from protocol.framing import EAP_OVERHEAD_BYTES, EapFraming, RawFraming
from protocol.limits import cfg_id
from protocol.plc_events import CommandRejected
from sim_plc.plc.local_panel import LocalPanel
from sim_plc.plc.logic import PlcLogic
from sim_plc.plc.reference import Motion
from sim_plc.plc.sample import PlantSample

MS = 1_000_000
PC_ID, PLC_ID = "192.168.0.10.1.1", "192.168.0.20.1.1"
KEY = bytes(range(1, 33))
SOURCE = ("pc", 50111)
_T_START_NS = 100_000 * MS
_Q_SHARES = (0.5, 0.6, 0.4, 0.5, 0.5, 0.5, 0.5, 0.5)  # where in its range each joint stands
_OUTSIDE_RAD = 0.02  # past the range, but less than makes a fault of it
_HOT_C = 90.0


@dataclass(frozen=True, slots=True)
class Variant:
    """How an end is set up."""

    eap: bool
    key: bytes

    def plc_wire(self) -> Wire:
        """How commands travel to the PLC."""
        framing = EapFraming.for_client(PC_ID, PLC_ID) if self.eap else RawFraming()
        return Wire(framing.wrap, self.eap, self.key)

    def client_wire(self) -> Wire:
        """How states travel to the PC."""
        framing = EapFraming.for_plc(PC_ID, PLC_ID) if self.eap else RawFraming()
        return Wire(framing.wrap, self.eap, self.key)


VARIANTS = (Variant(False, b""), Variant(True, b""), Variant(False, KEY), Variant(True, KEY))


class BadStateError(AssertionError):
    """The PLC sent a state that breaks the format."""


class PlcEnd:
    """One PLC from its boot on. `look` after everything that may have changed it."""

    def __init__(self, machine: Machine, variant: Variant, rng: Random) -> None:
        self.variant, self._rng = variant, rng
        framing = EapFraming.for_plc(PC_ID, PLC_ID) if variant.eap else RawFraming()
        self.panel = LocalPanel(enable_mode="panel", enabled=True, _fresh=True) if rng.random() < 0.3 else LocalPanel()
        self.plc = PlcLogic(
            machine, framing, lambda: rng.randrange(1, 1 << 32), self.panel, variant.key, dry_run=rng.random() < 0.1
        )
        table = self.plc.settings.limit_table
        self.honest = HonestPc(table, rng.randrange(1, 1 << 32), rng)
        eap = Subscription(bytes(map(int, PC_ID.split("."))), 0x4801) if variant.eap else None
        self.oracle = PlcOracle(table, cfg_id(table), variant.key, eap)
        self.t_ns = self.honest.t_plc_ns = _T_START_NS + rng.randrange(1000 * MS)
        self.swinging = self.outside = self.hot = False
        shares = zip(_Q_SHARES, table.axes, strict=False)
        self._q = np.array([axis.q_min + share * (axis.q_max - axis.q_min) for share, axis in shares])
        self._sampled_q = self._q
        self.recorded: list[bytes] = []
        self.n_states = 0  # states that were judged

    @property
    def state(self) -> PlcState:
        """The PLC's state."""
        return self.plc.state

    def pass_time(self, ms: int) -> None:
        """Cycles of the PLC; the joints are where the reference is."""
        for _ in range(ms):
            self.t_ns += MS
            self.plc.run_cycle(self.t_ns, self._sample())
            self._q = self.plc.reference.q.copy()
        self.honest.t_plc_ns = self.t_ns

    def _sample(self) -> PlantSample:
        q, qd = self._q.copy(), np.zeros(len(self._q))
        self._sampled_q = q
        if self.outside:
            q[1] = self.plc.settings.q_max[1] + _OUTSIDE_RAD
        if self.swinging:
            qd[0] = 0.1
        return PlantSample(q, qd, np.zeros(len(q)), np.zeros(len(q)), 19e6, _HOT_C if self.hot else 40.0)

    def look(self) -> None:
        """Read the PLC's newest state: into the honest PC and the oracle.

        Raises: BadStateError: it breaks the format.
        """
        if self.state is not PlcState.BOOT:
            datagram = self.plc.send(self.t_ns)
            payload = datagram[EAP_OVERHEAD_BYTES:] if self.variant.eap else datagram
            breach = state_breach(payload, self.variant.key)
            self.n_states += 1
            if breach is not None:
                raise BadStateError(f"state with {breach.code.name} at {breach.offset}")
            self.honest.state = decode_state(payload, self.variant.key)
            self.oracle.saw(state_fields(payload))
        monitor, panel = self.plc.monitor, self.panel
        self.oracle.around = Surroundings(
            enable_given=panel.may_arm,
            fault_present=bool(monitor.present) or panel.estop_pressed,
            out_of_range=self._is_out_of_range(),
            swinging=self.swinging,
            ramping=self.plc.reference.motion is not Motion.FOLLOW,
        )

    def _is_out_of_range(self) -> bool:
        q, settings = self._sampled_q, self.plc.settings
        return bool(np.any(q < settings.q_min) or np.any(q > settings.q_max))

    # --- the way into a state -----------------------------------------------------------------------------------------

    def give(self, payload: bytes, source: Hashable = SOURCE) -> None:
        """An honest payload, sealed and framed; it is recorded, and the oracle follows."""
        payload = sealed(payload, self.variant.key)
        wire = self.variant.plc_wire()
        datagram = wire.wrap(payload, 0)
        self.recorded.append(payload)
        events = self.plc.receive(datagram, self.t_ns, source)
        if events and not isinstance(events[0], CommandRejected):
            self.oracle.take(payload, source)
        self.look()

    def reach(self, target: PlcState) -> None:
        """Bring the PLC into a state; from BOOT, by the way that a PC and an operator would take."""
        if target is PlcState.BOOT:
            return
        self.pass_time(1)
        self.look()
        if target is PlcState.DISARMED:
            return
        if target in (PlcState.FAULT, PlcState.LOCAL) and self._rng.random() < 0.5:
            self._leave(target)
        wraps = self._rng.random() < 0.2
        self.give(self.honest.hello(0x1_0000_0000 - self._rng.randrange(1, 60) if wraps else None))
        if self.state is not PlcState.LINKED:
            return
        self._beat(self._rng.randrange(40) if target is PlcState.LINKED else 25)
        if target is PlcState.LINKED:
            self._disturb()
            return
        self.give(self.honest.plain(Mode.ARM))
        if target is not PlcState.HOLD or self._rng.random() < 0.3:
            self._move(target)
        if target in (PlcState.FAULT, PlcState.LOCAL):
            self._leave(target)

    def _beat(self, n: int) -> None:
        """n heartbeats, a cycle apart."""
        wire, first = self.variant.plc_wire(), self.honest.plain(Mode.HEARTBEAT)
        seq = self.honest.state.ack_seq + 1
        for i in range(n):
            self.pass_time(1)
            payload = sealed(with_value(first, 20, 4, (seq + i) % (1 << 32)), wire.key)
            self.recorded.append(payload)
            self.plc.receive(wire.wrap(payload, 0), self.t_ns, SOURCE)
        self.look()

    def _move(self, target: PlcState) -> None:
        if target is PlcState.HOLD:
            self.give(self.honest.window(start=False))
            return
        servo = self._rng.random() < 0.25
        self.give(self.honest.servo() if servo else self.honest.window())
        for _ in range(self._rng.randrange(30)):
            self.pass_time(20)
            self.look()
            self.give(self.honest.servo() if servo else self.honest.window())
        if target is PlcState.STOPPING:
            self.give(self.honest.plain(self._rng.choice((Mode.STOP, Mode.QUICK_STOP, Mode.HOLD, Mode.DISARM))))

    def _leave(self, target: PlcState) -> None:
        """To FAULT or LOCAL, by what happens at the machine."""
        if target is PlcState.LOCAL:
            self.panel.lever_taken = True
        elif self._rng.random() < 0.4:
            self.hot = True
        else:
            self.plc.latch_faults(FaultBit.LAG, self.t_ns)
        self.pass_time(1)
        self.look()

    def _disturb(self) -> None:
        """Sometimes something that speaks against arming."""
        choice = self._rng.randrange(8)
        if choice == 0:
            self.swinging = True
        elif choice == 1:
            self.outside = True
        elif choice == 2 and self.panel.enable_mode == "panel":
            self.panel.release_enable()
        self.pass_time(1)
        self.look()

    def heal(self) -> None:
        """Take the disturbances away."""
        self.hot = self.swinging = self.outside = False
        self.panel.lever_taken = False
        if self.panel.enable_mode == "panel":
            self.panel.press_enable()
