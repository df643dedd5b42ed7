"""The PC's end under test, with a PLC that means well beside it, brought into any of its phases."""

from dataclasses import dataclass
from random import Random

from benchmarks.link.fuzz.frames import sealed
from benchmarks.link.fuzz.honest_motion import tail, trajectory
from benchmarks.link.fuzz.honest_plc import HonestPlc
from benchmarks.link.fuzz.oracle_bytes import Subscription, unframed
from benchmarks.link.fuzz.oracle_client import ClientOracle
from benchmarks.link.fuzz.oracle_fields import command_fields
from benchmarks.link.fuzz.plc_end import PC_ID, PLC_ID, Variant
from protocol.client_events import ClientEvent, ClientPhase
from protocol.client_link import ClientLink
from protocol.codes import PlcState
from protocol.errors import LocalProtocolError
from protocol.framing import EapFraming, RawFraming
from protocol.limits import LimitTable, cfg_id

MS = 1_000_000
_LEAVING = {
    ClientPhase.FAULT: PlcState.FAULT,
    ClientPhase.LOCAL: PlcState.LOCAL,
    ClientPhase.STOPPING: PlcState.STOPPING,
}


def _subscription(net_id: str, variable: int, eap: bool) -> Subscription | None:
    return Subscription(bytes(map(int, net_id.split("."))), variable) if eap else None


@dataclass(frozen=True, slots=True)
class Turn:
    """What 20 ms without fuzzing led to."""

    events: tuple[ClientEvent, ...]
    problems: tuple[str, ...]
    sent: bytes | None


class ClientEnd:
    """One ClientLink from its beginning on."""

    def __init__(self, table: LimitTable, variant: Variant, rng: Random) -> None:
        self.variant, self.table, self._rng = variant, table, rng
        framing = EapFraming.for_client(PC_ID, PLC_ID) if variant.eap else RawFraming()
        session = rng.randrange(1, 1 << 32)
        override = rng.choice((1.0, 1.0, 0.5, 0.0))
        self.link = ClientLink(table, framing, session, override, variant.key)
        states = _subscription(PLC_ID, 0x4802, variant.eap)
        commands = _subscription(PC_ID, 0x4801, variant.eap)
        self.oracle = ClientOracle(table, cfg_id(table), variant.key, states, commands, session)
        self.plc = HonestPlc(table, rng.choice((0, 0, 0xFFFF_FFF0)))
        self.t_ns = 1_000_000 * MS + rng.randrange(1000 * MS)
        self.recorded: list[bytes] = []
        self._traj_id = 0

    @property
    def phase(self) -> ClientPhase:
        """How far the connection has come."""
        return self.link.phase(self.t_ns)

    def turn(self, hear: bool = True) -> Turn:
        """20 ms: the client polls and sends; what it sends is judged, and heard by the honest PLC."""
        self.t_ns += 20 * MS
        events = tuple(self.link.poll(self.t_ns))
        self.oracle.closed = self.link.closed
        datagram = self.link.send(self.t_ns)
        if datagram is None:
            return Turn(events, (), None)
        problems = tuple(self.oracle.against_sent(datagram, self.t_ns))
        payload = unframed(datagram, self.oracle.command_eap)
        if hear and isinstance(payload, bytes):
            self.plc.hear(command_fields(payload))
        return Turn(events, problems, datagram)

    def tell(self) -> None:
        """The honest PLC's next state arrives."""
        self.plc.tick()
        payload = sealed(self.plc.payload(), self.variant.key)
        self.recorded.append(payload)
        datagram = self.variant.client_wire().wrap(payload, self.plc.state.seq)
        verdict = self.oracle.judge(datagram, self.t_ns)
        self.link.receive(datagram, self.t_ns)
        if verdict.kind.value == "taken":
            self.oracle.take(payload, self.t_ns)

    def wish(self) -> None:
        """One of everything that may be asked of the client, at any time; it may say no."""
        rng, link, t_ns = self._rng, self.link, self.t_ns
        n = len(self.table.axes)
        try:
            match rng.randrange(10):
                case 0:
                    link.request_arm()
                case 1:
                    link.request_reset()
                case 2:
                    link.request_stop("the fuzzer", quick=rng.random() < 0.3)
                case 3 | 4:
                    self.run()
                case 5:
                    self._tail()
                case 6 | 7:
                    if rng.random() < 0.5:
                        link.request_servo(self._next_traj_id(), t_ns)
                    q_ref = self.plc.state.q_ref
                    q = tuple(x + rng.uniform(-0.15, 0.15) if j < n else 0.0 for j, x in enumerate(q_ref))
                    link.set_servo_target(q, (0.0,) * 8, t_ns)
                case 8:
                    rng.choice((link.cancel_request, link.finish_servo))()
                case _:
                    link.request_disarm()
        except LocalProtocolError:
            pass  # asked at the wrong time

    def run(self) -> None:
        """Ask for a trajectory from where the client sees the reference.

        Raises: LocalProtocolError: not now.
        """
        q_ref = self.link.state.q_ref if self.link.state else self.plc.state.q_ref
        knots = trajectory(q_ref[: len(self.table.axes)], self.table, self._rng)
        self.link.request_run(self._next_traj_id(), knots, self.t_ns)

    def _tail(self) -> None:
        motion = self.link._run.motion if self.link._run else None
        knots = getattr(motion, "knots", ())
        if len(knots) < 3:
            return
        first = self._rng.randrange(1, len(knots))
        changed = tail(knots, first, len(self.table.axes), self._rng)
        self.link.request_tail(self._traj_id, first, changed[first:], self.t_ns)

    def _next_traj_id(self) -> int:
        self._traj_id += 1
        return self._traj_id

    # --- the way into a phase -----------------------------------------------------------------------------------------

    def reach(self, target: ClientPhase) -> None:
        """Bring the client into a phase, by the way that it would take."""
        if target is ClientPhase.OFFLINE:
            return
        if target is ClientPhase.DISARMED:
            self.tell()
            return
        self.turn()
        self.tell()
        if target is ClientPhase.LINKED:
            self._turns(self._rng.randrange(30))
            return
        if target in (ClientPhase.FAULT, ClientPhase.LOCAL) and self._rng.random() < 0.5:
            self._leave(target)
            return
        self.link.request_arm()
        self._turns(32)
        if target is ClientPhase.ARMED:
            return
        try:
            self.run() if self._rng.random() < 0.75 else self.link.request_servo(self._next_traj_id(), self.t_ns)
        except LocalProtocolError:
            return
        self._turns(self._rng.randrange(1, 20))
        if target is not ClientPhase.RUNNING:
            self._leave(target)

    def _turns(self, n: int) -> None:
        for _ in range(n):
            self.turn()
            self.tell()

    def _leave(self, target: ClientPhase) -> None:
        self.plc.goes_to(_LEAVING[target])
        if target is ClientPhase.STOPPING:
            self.link.request_stop("the fuzzer")
            self.turn(hear=False)
            self.oracle.take(self._stopping_state(), self.t_ns)
            return
        self.tell()

    def _stopping_state(self) -> bytes:
        """A state in STOPPING, delivered by hand: the honest PLC would be at rest with its next one."""
        self.plc.tick()
        self.plc.goes_to(PlcState.STOPPING)
        payload = sealed(self.plc.payload(), self.variant.key)
        self.recorded.append(payload)
        self.link.receive(self.variant.client_wire().wrap(payload, self.plc.state.seq), self.t_ns)
        return payload
