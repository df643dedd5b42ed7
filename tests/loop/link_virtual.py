"""The real PC end and the real PLC program in virtual time, a fault channel each way, and what the reference did."""

import random

import numpy as np

from benchmarks.link.drill.drill import drill_machine
from benchmarks.link.drill.drill_plant import IdealPlant
from protocol.client_events import ClientPhase, TrajectoryEnded
from protocol.client_link import ClientLink
from protocol.codes import PlcState
from protocol.framing import RawFraming
from protocol.limits import limits_of
from protocol.messages import Axes, Knot
from sim_plc.plc.logic import PlcLogic
from sim_plc.relay.faults import FaultChannel, Faults

MS = 1_000_000
MACHINE = drill_machine(1)
TABLE = limits_of(MACHINE.joints)
Q_START = tuple(np.deg2rad([10.0, 40.0, -80.0, 5.0, -40.0, 3.0]).tolist())
NONE = Faults()
Played = list[tuple[int, Axes, Axes]]  # playback time, q_ref, qd_ref of every cycle in RUN


class VirtualLink:
    """A PLC cycle of 1 ms a step. `phase_ms`: when within 20 ms the PC sends."""

    def __init__(self, to_plc: Faults, to_pc: Faults, seed: int, phase_ms: int = 0) -> None:
        nonces = random.Random(seed)
        self.plc = PlcLogic(MACHINE, RawFraming(), lambda: nonces.getrandbits(32))
        self.client = ClientLink(TABLE, RawFraming(), session=seed + 1)
        self.plant = IdealPlant(MACHINE, np.array(Q_START))
        self.faults = to_plc, to_pc
        self.to_plc = FaultChannel(Faults(), random.Random(f"{seed} to plc"))
        self.to_pc = FaultChannel(Faults(), random.Random(f"{seed} to pc"))
        self.t_ns, self.phase_ns = 0, phase_ms * MS
        self.played: Played = []
        self.ended: list[TrajectoryEnded] = []

    def step(self) -> None:
        self.t_ns += MS
        t_plc_ns = self.t_ns + 1_000_000 * MS
        for datagram in self.to_plc.pop(self.t_ns):
            self.plc.receive(datagram, t_plc_ns, "pc")
        running = self.plc.state is PlcState.RUN
        self.plant.step(self.plc.run_cycle(t_plc_ns, self.plant.sample(True)), 1)
        if running:
            self.played.append((self.plc.reference.t_play_ns, self.plc.q_ref, self.plc.qd_ref))
        if self.t_ns % (10 * MS) == 0 and self.plc.link.peer is not None:
            self.to_pc.push(self.plc.send(t_plc_ns), self.t_ns)
        for datagram in self.to_pc.pop(self.t_ns):
            self._note(self.client.receive(datagram, self.t_ns))
        if self.t_ns % (20 * MS) == self.phase_ns:
            self._note(self.client.poll(self.t_ns))
            datagram = self.client.send(self.t_ns)
            if datagram is not None:
                self.to_plc.push(datagram, self.t_ns)

    def _note(self, events: list) -> None:  # type: ignore[type-arg]
        self.ended += [event for event in events if isinstance(event, TrajectoryEnded)]

    def arm(self) -> "VirtualLink":
        """Connected and armed over a clean network; the faults begin now."""
        self.client.request_arm()
        for _ in range(2000):
            self.step()
            if self.client.phase(self.t_ns) is ClientPhase.ARMED:
                self.to_plc.faults, self.to_pc.faults = self.faults
                return self
        raise AssertionError("not armed")

    def play(self, knots: tuple[Knot, ...], traj_id: int = 1) -> TrajectoryEnded:
        assert self.client.request_run(traj_id, knots, self.t_ns) == ()
        until_ns = self.t_ns + knots[-1].t_ns + 3000 * MS
        while not self.ended and self.t_ns < until_ns:
            self.step()
        return self.ended.pop()


def playback(
    knots: tuple[Knot, ...],
    to_plc: Faults = NONE,
    to_pc: Faults = NONE,
    seed: int = 0,
    phase_ms: int = 0,
) -> tuple[Played, TrajectoryEnded, VirtualLink]:
    """One trajectory through these faults: what was played, how it ended, and the ends of the link."""
    link = VirtualLink(to_plc, to_pc, seed, phase_ms).arm()
    return link.played, link.play(knots), link
