"""A PLC of fifty lines for tests of the link alone: a knot ring and playback on straight lines, no dynamics."""

from itertools import pairwise

from protocol.codes import CommandFlag, Mode, PlcState, RejectCode
from protocol.framing import Framing, RawFraming
from protocol.limits import AxisLimits, LimitTable, axis_mask, cfg_id
from protocol.messages import ZEROS, Axes, Command, Knot, PlcStatus
from protocol.objection import Objection, object_to, object_to_knot
from protocol.plc_events import CommandAccepted, PlcAction, PlcLinkEvent
from protocol.plc_link import PlcLink, PlcLinkSettings
from protocol.plc_states import PlcEvent

MS = 1_000_000
RAMP_NS = 100 * MS
TABLE = LimitTable(tuple(AxisLimits(name, -2.0, 2.0, 0.5, 2.0) for name in ("a", "b", "c")))


class ToyPlc:
    """Call `cycle` every millisecond or so; `outbox` fills with (datagram, peer)."""

    def __init__(self, table: LimitTable = TABLE, framing: Framing | None = None) -> None:
        self.table = table
        nonces = iter(range(1001, 1_000_000))
        self.link = PlcLink(
            PlcLinkSettings(cfg_id(table), True), framing or RawFraming(), lambda: next(nonces), self.check
        )
        self.ring: dict[int, Knot] = {}
        self.traj_id = self.end_index = 0
        self.t_play_ns = 0
        self.q_ref: Axes = ZEROS
        self.track: list[tuple[int, Axes]] = []  # (t_play, q_ref) of every cycle in RUN
        self.events: list[PlcLinkEvent] = []
        self.enable = True
        self._t_ns: int | None = None
        self._t_state_ns = self._t_stop_ns = 0

    def check(self, command: Command, state: PlcState) -> Objection | None:
        if command.mode is Mode.ARM and not self.enable:
            return object_to(RejectCode.ENABLE, "mode")
        first = command.mode is Mode.TRAJECTORY and state is PlcState.HOLD and command.knot_first == 0
        if first and command.knots[0].q != self.q_ref:
            return object_to_knot(RejectCode.START, 0, "q")
        return None

    def receive(self, datagram: bytes, t_ns: int, source: object = "pc") -> None:
        for event in self.link.receive(datagram, t_ns, source):
            self.events.append(event)
            if isinstance(event, CommandAccepted) and event.effect is PlcAction.LOAD:
                self._load(event.command)

    def _load(self, command: Command) -> None:
        if command.traj_id != self.traj_id:
            self.ring, self.traj_id, self.end_index, self.t_play_ns = {}, command.traj_id, 0, 0
        self.ring |= {command.knot_first + i: knot for i, knot in enumerate(command.knots)}
        if CommandFlag.LAST_IS_END in command.cmd_flags:
            self.end_index = command.knot_first + len(command.knots) - 1

    @property
    def knot_last(self) -> int:
        last = 0
        while last + 1 in self.ring:
            last += 1
        return last

    @property
    def knot_playing(self) -> int:
        return max(
            (i for i in range(self.knot_last + 1) if i in self.ring and self.ring[i].t_ns <= self.t_play_ns), default=0
        )

    def cycle(self, t_ns: int) -> list[tuple[bytes, object]]:
        dt_ns, self._t_ns = t_ns - (self._t_ns or t_ns), t_ns
        if self.link.state is PlcState.BOOT:
            self.link.apply(PlcEvent.BOOTED, t_ns)
        self.events += self.link.poll(t_ns)
        if self.link.state is PlcState.RUN:
            self._t_stop_ns = t_ns
            self._play(dt_ns, t_ns)
        elif self.link.state is PlcState.STOPPING and t_ns - self._t_stop_ns > RAMP_NS:
            self.events += self.link.apply(PlcEvent.AT_REST, t_ns)
        receivers = self.link.receivers() if t_ns - self._t_state_ns >= 10 * MS else []
        if not receivers:
            return []
        self._t_state_ns = t_ns
        datagram = self.link.send(self.status(), t_ns)
        return [(datagram, receiver) for receiver in receivers]

    def _play(self, dt_ns: int, t_ns: int) -> None:
        end_ns = self.ring[self.knot_last].t_ns
        self.t_play_ns = min(self.t_play_ns + dt_ns, end_ns)
        for i, j in pairwise(range(self.knot_last + 1)):
            a, b = self.ring[i], self.ring[j]
            if a.t_ns <= self.t_play_ns <= b.t_ns:
                s = (self.t_play_ns - a.t_ns) / (b.t_ns - a.t_ns)
                self.q_ref = b.q if s == 1.0 else tuple(x + s * (y - x) for x, y in zip(a.q, b.q, strict=True))
        self.track.append((self.t_play_ns, self.q_ref))
        if self.t_play_ns == end_ns:
            at_end = self.end_index and self.knot_last == self.end_index
            self.events += self.link.apply(PlcEvent.END if at_end else PlcEvent.SOFT_STOP, t_ns)

    def status(self) -> PlcStatus:
        ahead_ns = self.ring[self.knot_last].t_ns - self.t_play_ns if self.ring else 0
        return PlcStatus(
            axis_mask=axis_mask(self.table),
            traj_id=self.traj_id,
            knot_playing=self.knot_playing,
            knot_last=self.knot_last,
            t_play_ns=self.t_play_ns,
            buffer_us=ahead_ns // 1000,
            q=self.q_ref,
            q_ref=self.q_ref,
        )


def smooth_knots(q_start: Axes, q_end: Axes, duration_s: float, spacing_s: float = 0.05) -> tuple[Knot, ...]:
    """A quintic from rest to rest, sampled."""
    n = round(duration_s / spacing_s)
    knots = []
    for i in range(n + 1):
        s = i / n
        p, v, a = 10 * s**3 - 15 * s**4 + 6 * s**5, 30 * s**2 - 60 * s**3 + 30 * s**4, 60 * s - 180 * s**2 + 120 * s**3
        step = [b - a_ for a_, b in zip(q_start, q_end, strict=True)]
        q = q_start if i == 0 else tuple(x + d * p for x, d in zip(q_start, step, strict=True))
        qd = tuple(d * v / duration_s for d in step)
        qdd = tuple(d * a / duration_s**2 for d in step)
        knots.append(Knot(round(i * spacing_s * 1e9), q, qd, qdd))
    return tuple(knots)
