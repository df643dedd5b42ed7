"""The delivered ST program and the simulated PLC side by side: same inputs, and every output compared."""

import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from importlib.resources import files
from typing import Protocol

import numpy as np
from st_sessions import Pc
from st_wire import FAULTS, Fault, sealed

from machine.description import Machine, parse_machine_toml
from protocol import layout
from protocol.codec import decode_state
from protocol.errors import FramingError
from protocol.framing import EAP_OVERHEAD_BYTES, EapFraming, RawFraming
from protocol.limits import LimitTable, limits_of
from protocol.messages import Command, State
from protocol.plc_events import CommandRejected
from sim_plc.plc.local_panel import LocalPanel
from sim_plc.plc.logic import PlcLogic
from sim_plc.plc.sample import PlantSample

MS = 1_000_000
TICK_NS = 10 * MS
Q_START = np.deg2rad([10.0, 40.0, -80.0, 5.0, -40.0, 3.0])
PC, STRANGER = 0xC0A80001, 0xC0A80002


def machine_with_cycle(cycle_s: float) -> Machine:
    """The crane with another PLC cycle: 10 ms makes a datagram cost one cycle in the tests."""
    text = (files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8")
    return replace(parse_machine_toml(text), plc_cycle_s=cycle_s)


MACHINE = machine_with_cycle(0.01)
TABLE: LimitTable = limits_of(MACHINE.joints)


class StructuredTextPlc(Protocol):
    """What the harness needs of FB_HmPlc in the runner."""

    def set_inputs(self, entropy: int, enable: bool, lever: bool, estop: bool) -> None:
        """The inputs of this cycle."""
        ...

    def receive(self, payload: bytes, source: int, t_ns: int) -> None:
        """One datagram's payload."""
        ...

    def refuse_frame(self) -> None:
        """What TwinCAT tells of a frame that is not the subscriber's."""
        ...

    def cycle(self, sample: PlantSample, t_ns: int) -> tuple[float, ...]:
        """One cycle; valve commands of 8 axes."""
        ...

    def build_state(self, t_ns: int) -> bytes:
        """The state datagram's payload."""
        ...

    def peer(self) -> int | None:
        """Where states go."""
        ...

    def answers(self) -> bool:
        """Whether the last datagram's sender is answered, because it was refused."""
        ...


@dataclass(slots=True)
class Readings:
    """The plant that both PLCs read: joints that follow the valves, and what a test spoils."""

    q: np.ndarray = field(default_factory=Q_START.copy)
    speed: np.ndarray = field(default_factory=lambda: np.zeros(6))
    qd: np.ndarray = field(default_factory=lambda: np.zeros(6))  # what a test adds to the speed
    supply_pa: float = 19e6
    oil_c: float = 40.0
    stuck: bool = False

    def move(self, valves: np.ndarray) -> None:
        """One tick of the nominal actuators."""
        gains = np.array([joint.velocity_gain_rad_s for joint in MACHINE.joints])
        self.speed = np.zeros(6) if self.stuck else valves * gains
        self.q = self.q + self.speed * (TICK_NS * 1e-9)

    def sample(self, rng: np.random.Generator) -> PlantSample:
        """Readings of this cycle; pressures are REALs on a PLC."""
        p_a, p_b = (rng.integers(0, 200, 6).astype(np.float32).astype(float) * 1e5 for _ in range(2))
        return PlantSample(self.q.copy(), self.speed + self.qd, p_a, p_b, self.supply_pa, self.oil_c)


@dataclass(slots=True)
class Tally:
    """What a differential run has seen; `mismatches` must stay empty."""

    ticks: int = 0
    datagrams: int = 0
    rejects: Counter[str] = field(default_factory=Counter)
    states: Counter[str] = field(default_factory=Counter)
    motions: Counter[str] = field(default_factory=Counter)
    faults: Counter[str] = field(default_factory=Counter)
    mismatches: list[str] = field(default_factory=list)

    def summary(self) -> dict[str, object]:
        """For the evidence file and the printed report."""
        return {
            "datagrams": self.datagrams,
            "state_datagrams_compared": self.ticks,
            "mismatches": len(self.mismatches),
            "reject_codes": dict(sorted(self.rejects.items())),
            "states": dict(sorted(self.states.items())),
            "motions": dict(sorted(self.motions.items())),
            "fault_kinds": dict(sorted(self.faults.items())),
        }


def state_fields(payload: bytes) -> dict[str, object]:
    """Every field of a state datagram by name, arrays element by element."""
    found: dict[str, object] = {}
    for block in (layout.HEADER_LAYOUT, layout.STATE_BODY_LAYOUT):
        for f in block.fields:
            values = struct.unpack_from("<" + f.format, payload, f.offset)
            names = [f.name] if len(values) == 1 else [f"{f.name}[{i}]" for i in range(len(values))]
            found |= dict(zip(names, values, strict=True))
    return found


def differences(python: bytes, st: bytes) -> list[str]:
    """The fields in which two state datagrams differ, with both values."""
    ours, theirs = state_fields(python), state_fields(st)
    differ = [
        f"{name}: python {ours[name]!r}, st {theirs[name]!r}"
        for name in ours
        if _bits(ours[name]) != _bits(theirs[name])
    ]
    return [text for text in differ if not text.startswith("crc")] or ["crc"]


def _bits(value: object) -> object:
    return struct.pack("<d", value) if isinstance(value, float) else value


class Pair:
    """Both PLCs, one tick at a time."""

    def __init__(
        self,
        st: StructuredTextPlc,
        seed: int,
        *,
        key: bytes = b"",
        auto: bool = True,
        dry_run: bool = False,
        eap: bool = False,
    ) -> None:
        self.st, self.tally, self.plant = st, Tally(), Readings()
        self._rng = np.random.default_rng([seed, 1])
        self._entropy = 1
        self.panel = LocalPanel("auto" if auto else "panel")
        ids = ("192.168.0.1.1.1", "192.168.0.2.1.1")
        self._plc_end = EapFraming.for_plc(*ids) if eap else RawFraming()
        self._pc_end = EapFraming.for_client(*ids) if eap else RawFraming()
        self._overhead = EAP_OVERHEAD_BYTES if eap else 0
        self.key = key
        self.plc = PlcLogic(MACHINE, self._plc_end, lambda: self._entropy, self.panel, key, dry_run)
        self.t_ns = 40_000 * MS
        self._newest: bytes = b""
        self._panel_to_st()

    def wrap(self, payload: bytes, seq: int) -> bytes:
        """The datagram around a payload, as the PC sends it."""
        return self._pc_end.wrap(payload, seq)

    def deliver(self, datagram: bytes, source: int = PC) -> None:
        """One datagram to both."""
        self.tally.datagrams += 1
        self._panel_to_st()
        self.plc.link.refused = None
        for event in self.plc.receive(datagram, self.t_ns, source):
            if isinstance(event, CommandRejected):
                self.tally.rejects[event.code.name] += 1
        try:
            payload = self._plc_end.unwrap(datagram)
        except FramingError:  # TwinCAT's own I/O would refuse this frame
            self.st.refuse_frame()
        else:
            self.st.receive(payload, source, self.t_ns)
            if (self.plc.link.refused == source) is not self.st.answers():
                self.tally.mismatches.append(f"datagram {self.tally.datagrams}: only one answers its refused sender")

    def tick(self) -> State:
        """One cycle and one state of both, compared."""
        self._panel_to_st()
        sample = self.plant.sample(self._rng)
        valves = self.plc.run_cycle(self.t_ns, sample)
        st_valves = self.st.cycle(sample, self.t_ns)
        python = self.plc.send(self.t_ns)[self._overhead :]
        st = self.st.build_state(self.t_ns)
        self._compare(python, st, (*valves.tolist(), 0.0, 0.0), st_valves)
        self.plant.move(valves)
        self.t_ns += TICK_NS
        self._entropy = int(self._rng.integers(0, 2**32))
        state = decode_state(python, self.key)
        self.tally.states[state.plc_state.name] += 1
        self.tally.motions[self.plc.reference.motion.name] += 1
        return state

    def _panel_to_st(self) -> None:
        panel = self.panel
        self.st.set_inputs(self._entropy, panel.enabled, panel.lever_taken, panel.estop_pressed)

    def _compare(self, python: bytes, st: bytes, valves: tuple[float, ...], st_valves: tuple[float, ...]) -> None:
        self.tally.ticks += 1
        found = differences(python, st) if python != st else []
        if valves != st_valves:
            found.append(f"valves: python {valves}, st {st_valves}")
        if self.plc.link.peer != self.st.peer():
            found.append(f"peer: python {self.plc.link.peer}, st {self.st.peer()}")
        if found:
            where = f"tick {self.tally.ticks}, datagram {self.tally.datagrams}, {self.plc.state.name}"
            self.tally.mismatches.append(f"{where}: " + "; ".join(found[:6]))


class Drill:
    """A PC's script played into a pair through a network that loses, doubles, delays and spoils."""

    def __init__(self, pair: Pair, pc: Pc, rng: np.random.Generator, fault_frac: float) -> None:
        self.pair, self.pc, self._rng, self._frac = pair, pc, rng, fault_frac
        self._delayed: list[tuple[int, bytes, int]] = []  # tick due, datagram, source
        self._tick = 0
        self._blind = 0  # ticks for which states do not reach the PC
        self.extra: list[tuple[Fault, Command]] = []  # sent spoilt before the next command

    def run(self, script: Iterator[Command | None]) -> None:
        """All of a script, tick by tick."""
        for command in script:
            self._arrivals()
            for fault, spoilt in self.extra:
                self._spoilt(fault, self.pc.encoded(spoilt), spoilt.seq)
            self.extra.clear()
            if command is not None:
                self._send(command)
            self._step()

    def _step(self) -> None:
        state = self.pair.tick()
        self._tick += 1
        self._blind = max(self._blind - 1, 0)
        if self._blind == 0:
            self.pc.state = state
        self.pc.t_ns = self.pair.t_ns + 7_000_000_000

    def _arrivals(self) -> None:
        due = [entry for entry in self._delayed if entry[0] <= self._tick]
        self._delayed = [entry for entry in self._delayed if entry[0] > self._tick]
        for _, datagram, source in due:
            self.pair.deliver(datagram, source)

    def _send(self, command: Command) -> None:
        payload = self.pc.encoded(command)
        datagram = self.pair.wrap(payload, command.seq)
        if self._rng.random() >= self._frac:
            self.pair.deliver(datagram)
        elif self._rng.random() < 0.3:
            self._on_the_way(datagram)
        else:
            fault = FAULTS[int(self._rng.integers(len(FAULTS)))]
            self._spoilt(fault, payload, command.seq)
            if self._rng.random() < 0.6:
                self.pair.deliver(datagram)

    def _spoilt(self, fault: Fault, payload: bytes, seq: int) -> None:
        self.pair.tally.faults[fault.name] += 1
        bad = fault.spoil(payload, self._rng)
        self.pair.deliver(self.pair.wrap(sealed(bad, self.pair.key) if fault.seal else bad, seq))

    def _on_the_way(self, datagram: bytes) -> None:
        kind = str(self._rng.choice(["loss", "duplicate", "delay", "late", "wrong source", "blind", "frame"]))
        self.pair.tally.faults[kind] += 1
        later = self._tick + int(self._rng.integers(1, 9))
        if kind == "duplicate":
            self.pair.deliver(datagram)
        if kind in ("duplicate", "wrong source"):
            self.pair.deliver(datagram, STRANGER if kind == "wrong source" else PC)
        elif kind in ("delay", "late"):
            self._delayed.append((later, datagram, PC))
        elif kind == "blind":
            self._blind = int(self._rng.integers(1, 40))
            self.pair.deliver(datagram)
        elif kind == "frame":
            self.pair.deliver(b"\x00" + datagram[1:])
