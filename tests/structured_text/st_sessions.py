"""Seeded sessions of a PC that does everything the link allows: arms, plays, corrects, servoes, stops, goes silent."""

from collections.abc import Generator
from dataclasses import dataclass, field, replace

import numpy as np

from protocol.codec import encode_command
from protocol.codes import CommandFlag, Interp, Mode, PlcState
from protocol.layout import KNOTS_PER_COMMAND
from protocol.limits import LimitTable, axis_mask, cfg_id
from protocol.messages import Command, Knot, State, pad_to_eight_axes

MS = 1_000_000
Ticks = Generator[Command | None, None, None]
_PLAIN = CommandFlag(0)


def quintic(start: Knot, q_end: np.ndarray, duration_s: float, spacing_ms: int) -> list[Knot]:
    """Knots from a moving start (not repeated) to rest at q_end; axis by axis the quintic that meets both ends."""
    n, count = len(q_end), max(round(duration_s * 1e3 / spacing_ms), 2)
    T = count * spacing_ms * 1e-3
    q0, v0, a0 = (np.array(x[:n]) for x in (start.q, start.qd, start.qdd))
    c0, c1, c2 = q0, v0 * T, 0.5 * a0 * T * T
    r0, r1, r2 = q_end - c0 - c1 - c2, -c1 - 2 * c2, -2 * c2
    c3, c4, c5 = 10 * r0 - 4 * r1 + 0.5 * r2, -15 * r0 + 7 * r1 - r2, 6 * r0 - 3 * r1 + 0.5 * r2
    knots = []
    for i in range(1, count + 1):
        x = i / count
        q = c0 + x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * c5))))
        qd = (c1 + x * (2 * c2 + x * (3 * c3 + x * (4 * c4 + x * 5 * c5)))) / T
        qdd = (2 * c2 + x * (6 * c3 + x * (12 * c4 + x * 20 * c5))) / T**2
        last = i == count
        zero = np.zeros(n)
        rest = (q_end, zero, zero) if last else (q, qd, qdd)
        knots.append(Knot(start.t_ns + i * spacing_ms * MS, *(pad_to_eight_axes(tuple(v.tolist())) for v in rest)))
    return knots


@dataclass(slots=True)
class Pc:
    """A PC whose scripts yield one command (or silence) per tick; between ticks `state` is brought up to date."""

    rng: np.random.Generator
    table: LimitTable
    session: int
    seq: int
    key: bytes = b""
    state: State | None = None
    t_ns: int = 0
    traj_id: int = 0
    timeout_us: int = 0
    knots: list[Knot] = field(default_factory=list)

    def encoded(self, command: Command) -> bytes:
        """The datagram of a command that a script has yielded."""
        return encode_command(command, self.key)

    def command(self, mode: Mode = Mode.HEARTBEAT, **fields: object) -> Command:
        """The next command of the session, right in everything a script does not say otherwise."""
        self.seq = (self.seq + 1) % 2**32
        seen = self.state if self.state is not None and self.state.session == self.session else None
        base = Command(
            session=self.session,
            seq=self.seq,
            t_send_ns=self.t_ns + 123,
            mode=mode,
            arm_nonce=self.state.nonce if self.state else 0,
            ack_plc_seq=seen.seq if seen else 0,
            t_plc_echo_ns=seen.t_send_ns if seen else 0,
            cfg_id=cfg_id(self.table),
            axis_mask=axis_mask(self.table),
            timeout_us=self.timeout_us,
        )
        return replace(base, **fields)  # pyright: ignore[reportArgumentType]

    def is_in(self, *states: PlcState) -> bool:
        """Whether the newest state seen is one of these."""
        return self.state is not None and self.state.plc_state in states

    # --- scripts ----------------------------------------------------------------------------------------------------

    def silent(self, ticks: int) -> Ticks:
        """Nothing at all."""
        for _ in range(ticks):
            yield None

    def beat(self, ticks: int, mode: Mode = Mode.HEARTBEAT) -> Ticks:
        """The same mode again and again."""
        for _ in range(ticks):
            yield self.command(mode)

    def connect(self) -> Ticks:
        """HELLO until a state carries our session."""
        for _ in range(60):
            yield self.command(hello=True)
            if self.state is not None and self.state.session == self.session:
                return

    def arm(self, early: bool = False) -> Ticks:
        """Prove the link, then ask to be armed."""
        yield from self.beat(3 if early else 26)
        for _ in range(30):
            yield self.command(Mode.ARM)
            if self.is_in(PlcState.HOLD):
                return

    def ready(self) -> Ticks:
        """Whatever has happened: one try to get (back) to HOLD, if the machine lets us."""
        if self.is_in(PlcState.FAULT):
            yield from self.beat(2, Mode.RESET)
        for _ in range(40):
            if not self.is_in(PlcState.RUN, PlcState.STOPPING):
                break
            yield self.command(Mode.STOP)
        if self.state is None or self.state.session != self.session or self.is_in(PlcState.DISARMED):
            self.session, self.traj_id = int(self.rng.integers(1, 2**32)), 0
            yield from self.connect()
        if self.is_in(PlcState.LINKED):
            yield from self.arm()

    def plan(self, duration_s: float, spacing_ms: int, reach: float = 0.05) -> None:
        """A new trajectory from q_ref to somewhere near, under the next number."""
        n = len(self.table.axes)
        q0 = np.array(self.state.q_ref[:n]) if self.state else np.zeros(n)
        start = Knot(0, pad_to_eight_axes(tuple(q0.tolist())))
        middle = np.array([0.5 * (a.q_min + a.q_max) for a in self.table.axes])
        q1 = q0 + reach * np.where(
            self.rng.random(n) < 0.8, np.sign(middle - q0), -np.sign(middle - q0)
        ) * self.rng.random(n)
        self.knots = [start, *quintic(start, q1, duration_s, spacing_ms)]
        self.traj_id += int(self.rng.integers(1, 3))

    def window(self, flags: CommandFlag = _PLAIN, first: int | None = None, **fields: object) -> Command:
        """The command with the next knots that the PLC does not have, or has not played."""
        state, count = self.state, len(self.knots)
        known = state is not None and state.traj_id == self.traj_id
        if first is None:
            first = min(max(state.knot_last - 1, 0), max(count - 4, 0)) if known and state is not None else 0
        knots = tuple(self.knots[first : first + KNOTS_PER_COMMAND])
        if first + len(knots) >= count:
            flags |= CommandFlag.LAST_IS_END
        known_fields: dict[str, object] = {"traj_id": self.traj_id, "knot_first": first, "knots": knots}
        known_fields |= {"interp": Interp.QUINTIC, "cmd_flags": flags} | fields
        return self.command(Mode.TRAJECTORY, **known_fields)

    def prefill(self, ticks: int) -> Ticks:
        """Knots without START: held, not played."""
        for _ in range(ticks):
            yield self.window()

    def play(self, ticks: int = 400, start: bool = True, speed: float = 1.0) -> Ticks:
        """Start, send knots until the PLC stands again."""
        begun = False
        flags = CommandFlag.START if start else _PLAIN
        for _ in range(ticks):
            yield self.window(flags, speed_override=speed)
            running = self.is_in(PlcState.RUN, PlcState.STOPPING)
            if begun and not running:
                return
            begun = begun or running

    def starve(self, ticks: int) -> Ticks:
        """Start, then only heartbeats: the knots run out."""
        yield self.window(CommandFlag.START)
        yield self.window(CommandFlag.START)
        yield from self.beat(ticks)

    def correct(self) -> Ticks:
        """While it plays, replace the tail by another way to another end."""
        for _ in range(12):
            yield self.window(CommandFlag.START)
        if not self.is_in(PlcState.RUN) or self.state is None:
            return
        keep = min(self.state.knot_playing + int(self.rng.integers(4, 8)), len(self.knots) - 3)
        if keep < 1:
            return
        end = np.array(self.knots[-1].q[: len(self.table.axes)]) + 0.01 * self.rng.standard_normal(len(self.table.axes))
        self.knots = [*self.knots[: keep + 1], *quintic(self.knots[keep], end, 0.9, 50)]
        for _ in range(8):
            yield self.window(CommandFlag.TAIL_REPLACES | CommandFlag.START, first=keep)
        yield from self.play()

    def target(self, q: np.ndarray, qd: np.ndarray, flags: CommandFlag = CommandFlag.START) -> Command:
        """One servo command."""
        knot = Knot(0, pad_to_eight_axes(tuple(q.tolist())), pad_to_eight_axes(tuple(qd.tolist())))
        fields: dict[str, object] = {"traj_id": self.traj_id, "knots": (knot,), "interp": Interp.LINEAR}
        return self.command(Mode.SERVO, cmd_flags=flags, **fields)

    def servo(self, ticks: int, end: bool = True, step: float = 0.0012) -> Ticks:
        """Chase a wandering target; the last command says that it is the last."""
        if self.state is None:
            return
        n = len(self.table.axes)
        q = np.array(self.state.q_ref[:n])
        heading = self.rng.standard_normal(n) * step
        self.traj_id += 1
        for i in range(ticks):
            if end and i > ticks - 30:
                yield self.target(q, np.zeros(n), CommandFlag.START | CommandFlag.LAST_IS_END)
                if self.is_in(PlcState.HOLD):
                    return
                continue
            heading = 0.9 * heading + 0.1 * step * self.rng.standard_normal(n)
            q = q + heading
            yield self.target(q, heading * 100)
