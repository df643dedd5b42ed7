"""The machine without a clock: PC end and PLC joined in memory, as fast as it goes. Deterministic for a seed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machine.rotations import Array
from protocol.client_events import ClientEvent, GateRefused, TrajectoryEnded
from protocol.client_link import ClientLink
from protocol.codes import PlcState
from protocol.framing import RawFraming
from protocol.messages import Knot
from protocol.timeouts import COMMAND_PERIOD
from sim_plc.machine_loop import MS, MachineLoop
from sim_plc.world import World, rng_for

T_START_NS = 1_000_000 * MS
_ARM_MS = 3000
_SOURCE = ("virtual", 0)


class VirtualRunError(RuntimeError):
    """The virtual machine did not do what was asked; the text says what it did instead."""


@dataclass(frozen=True, slots=True)
class VirtualTrace:
    """A row every 10 ms: times (m,) [s] from the start, joints (m, n) [rad], valves (m, n), poses (m, 4, 4)."""

    t_s: Array
    q_encoder: Array
    q_true: Array
    q_ref: Array
    valves: Array
    Ts_base_tcp: Array
    states: tuple[PlcState, ...]


class VirtualMachine:
    """One machine, its PLC and a PC end in virtual time; no datagram is lost or late."""

    def __init__(self, world: World) -> None:
        draws = rng_for(world.seed, "nonce")
        framing = RawFraming()
        self.machine = MachineLoop(world, framing, T_START_NS, lambda: int(draws.integers(1, 1 << 32)))
        self.client = ClientLink(self.machine.plc.settings.limit_table, framing, session=1)
        self._events: list[ClientEvent] = []
        self._traj_id = 0
        self._rows: list[tuple[float, Array, Array, Array, Array, Array, PlcState]] = []

    @property
    def q_ref(self) -> Array:
        """Where the reference is: a trajectory must begin there, at rest."""
        return self.machine.plc.reference.q.copy()

    def step(self, n_ms: int) -> None:
        """Let n_ms pass."""
        machine, client = self.machine, self.client
        for _ in range(n_ms):
            t_ns = machine.t_plc_ns
            if t_ns % COMMAND_PERIOD.duration_ns == 0:
                self._events += client.poll(t_ns)
                datagram = client.send(t_ns)
                if datagram is not None:
                    machine.plc.receive(datagram, t_ns, _SOURCE)
            state = machine.run_cycle()
            if state is not None:
                self._events += client.receive(state, t_ns)
            if t_ns % (10 * MS) == 0:
                self._note(t_ns)

    def arm(self) -> None:
        """Connect and arm.

        Raises: VirtualRunError: not armed within 3 s.
        """
        self.client.request_arm()
        for _ in range(_ARM_MS // 20):
            self.step(20)
            if self.machine.plc.state is PlcState.HOLD:
                return
        raise VirtualRunError(f"not armed after {_ARM_MS} ms: {self.client.last_reject or self.machine.plc.state.name}")

    def play(self, knots: Sequence[Knot]) -> TrajectoryEnded:
        """Play a trajectory from the present reference to its end, or to whatever ends it.

        Raises: VirtualRunError: it was refused, with the reasons.
        """
        self._traj_id += 1
        refusals = self.client.request_run(self._traj_id, knots, self.machine.t_plc_ns)
        if refusals:
            raise VirtualRunError("; ".join(refusal.as_line for refusal in refusals))
        self._events.clear()
        while True:
            self.step(20)
            for event in self._events:
                if isinstance(event, GateRefused):
                    raise VirtualRunError(event.text)
                if isinstance(event, TrajectoryEnded):
                    return event
            self._events.clear()

    def trace(self) -> VirtualTrace:
        """Everything noted so far."""
        t_s, q, q_true, q_ref, valves, poses, states = zip(*self._rows, strict=True)
        arrays = (np.array(t_s), *(np.stack(column) for column in (q, q_true, q_ref, valves, poses)))
        return VirtualTrace(*arrays, states=states)

    def _note(self, t_ns: int) -> None:
        plant, plc = self.machine.plant, self.machine.plc
        self._rows.append(
            (
                (t_ns - T_START_NS) * 1e-9,
                plant.q_encoder_rad,
                plant.q_output_rad,
                plc.reference.q.copy(),
                plc.valves.copy(),
                plant.T_base_tcp(),
                plc.state,
            )
        )


def run_virtual(world: World, trajectories: Sequence[Sequence[Knot]], settle_s: float = 1.0) -> VirtualTrace:
    """Arm, play the trajectories one after the other, let the machine settle after each; what happened.

    The first trajectory begins at `world.q_start_rad`, each further one where the one before has ended.
    Raises: VirtualRunError: a trajectory was refused or did not reach its end.
    """
    virtual = VirtualMachine(world)
    virtual.arm()
    for number, knots in enumerate(trajectories, start=1):
        ended = virtual.play(knots)
        if not ended.reached:
            raise VirtualRunError(f"trajectory {number} of {len(trajectories)} ended early: {ended.reason}")
        virtual.step(round(settle_s * 1e3))
    return virtual.trace()
