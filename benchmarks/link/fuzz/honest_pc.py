"""A PC that means well: the commands that it would send now are what the fuzzer mutates."""

from random import Random
from typing import Any

from benchmarks.link.fuzz.elements import Near
from benchmarks.link.fuzz.honest_motion import tail, trajectory
from benchmarks.link.fuzz.mutators import with_value
from protocol.codec import encode_command
from protocol.codes import CommandFlag, Interp, Mode, PlcState
from protocol.layout import KNOTS_PER_COMMAND
from protocol.limits import LimitTable, axis_mask, cfg_id
from protocol.messages import ZEROS, Command, Knot, State, pad_to_eight_axes
from protocol.playback import Playback

_MODULUS = 0x1_0000_0000
_SERVO_REACH_S = 0.25


class HonestPc:
    """Makes payloads (CRC right, not signed) for the present state of a PLC; `state` is the newest one seen."""

    def __init__(self, table: LimitTable, session: int, rng: Random) -> None:
        self.table, self.session, self._rng = table, session, rng
        self.state = State(0, 0, 0, PlcState.BOOT)
        self.t_plc_ns = 0
        self.playback: Playback | None = None
        self._cfg_id = cfg_id(table)
        self._replaces = CommandFlag(0)

    def _command(self, mode: Mode, **changes: Any) -> Command:
        state = self.state
        values: dict[str, Any] = {
            "arm_nonce": state.nonce,
            "ack_plc_seq": state.seq,
            "t_plc_echo_ns": state.t_send_ns,
            "axis_mask": axis_mask(self.table),
            "cfg_id": self._cfg_id,
            "timeout_us": 250_000,
        }
        t_send_ns = self.t_plc_ns + 1_000_000_007
        return Command(self.session, (state.ack_seq + 1) % _MODULUS, t_send_ns, mode, **(values | changes))

    def hello(self, seq: int | None = None) -> bytes:
        """A HELLO; a sequence number may be given to begin with."""
        command = self._command(Mode.HEARTBEAT, hello=True, ack_plc_seq=0, t_plc_echo_ns=0)
        payload = encode_command(command)
        return payload if seq is None else with_value(payload, 20, 4, seq)

    def plain(self, mode: Mode) -> bytes:
        """A command without knots."""
        return encode_command(self._command(mode))

    def window(self, start: bool = True) -> bytes:
        """The trajectory's next knots; a new trajectory from the present reference if there is none or it is over."""
        state = self.state
        playback = self.playback
        if playback is None or (state.plc_state is PlcState.HOLD and state.traj_id >= playback.traj_id):
            self._replaces = CommandFlag(0)
            number = state.traj_id + self._rng.choice((1, 1, 1, 5))
            playback = self.playback = Playback(number % _MODULUS or 1, trajectory(state.q_ref, self.table, self._rng))
        part = playback.window(state)
        return self._motion(playback, part.knot_first, part.knots, start)

    def prefill(self) -> bytes:
        """The knots after the last ones held, whatever the PLC's state."""
        if self.playback is None:
            return self.window(start=False)
        first = min(self.state.knot_last + 1, max(len(self.playback.knots) - 1, 0))
        return self._motion(self.playback, first, self.playback.knots[first : first + KNOTS_PER_COMMAND], True)

    def tail(self) -> bytes:
        """Other knots from somewhere ahead of the playback."""
        if self.playback is None or len(self.playback.knots) < 3:
            return self.window()
        ahead = self.state.knot_playing + self._rng.choice((1, 2, 3, 4, 5, 8))
        first = min(max(ahead, 1), len(self.playback.knots) - 1)
        knots = tail(self.playback.knots, first, len(self.table.axes), self._rng)
        self.playback = Playback(self.playback.traj_id, knots)
        self._replaces = CommandFlag.TAIL_REPLACES
        return self._motion(self.playback, first, knots[first : first + KNOTS_PER_COMMAND], True)

    def servo(self) -> bytes:
        """A target near the reference, mostly within reach."""
        rng, state = self._rng, self.state
        share = rng.choice((0.0, 0.1, 0.5, 0.99, 1.0, 1.01))
        q, qd = [], []
        for axis, here in zip(self.table.axes, state.q_ref, strict=False):
            reach = _SERVO_REACH_S * axis.qd_max * share
            q.append(min(max(here + rng.uniform(-1.0, 1.0) * reach, axis.q_min), axis.q_max))
            qd.append(rng.uniform(-1.0, 1.0) * axis.qd_max * rng.choice((0.0, 0.5, 1.0)))
        running = state.plc_state in (PlcState.RUN, PlcState.STOPPING)
        command = self._command(
            Mode.SERVO,
            traj_id=(state.traj_id if running else state.traj_id + 1) % _MODULUS,
            interp=Interp.LINEAR,
            cmd_flags=rng.choice((CommandFlag.START, CommandFlag.START, CommandFlag.LAST_IS_END)),
            knots=(Knot(0, pad_to_eight_axes(tuple(q)), pad_to_eight_axes(tuple(qd))),),
        )
        return encode_command(command)

    def _motion(self, playback: Playback, first: int, knots: tuple[Knot, ...], start: bool) -> bytes:
        flags = self._replaces | (CommandFlag.START if start else CommandFlag(0))
        if first + len(knots) > playback.last:
            flags |= CommandFlag.LAST_IS_END
        command = self._command(
            Mode.TRAJECTORY,
            traj_id=playback.traj_id,
            knot_first=first % _MODULUS,
            interp=Interp.QUINTIC,
            cmd_flags=flags,
            knots=knots or (Knot(0, ZEROS),),
            speed_override=self._rng.choice((1.0, 1.0, 1.0, 0.5, 0.0)),
        )
        return encode_command(command)

    def near(self) -> Near:
        """Values that mean something at this moment, by field name."""
        state, t_ns = self.state, self.t_plc_ns
        ack, traj_id = state.ack_seq, state.traj_id
        return {
            "session": (state.session, self.session, 0, state.session + 1),
            "seq": tuple(ack + d for d in (-1001, -1000, -1, 0, 1, 2, 25, 999, 1000, 1001, 0x7FFF_FFFF, 0x8000_0000)),
            "arm_nonce": (state.nonce, state.nonce + 1, 0),
            "ack_plc_seq": (state.seq, 0, 1),
            "t_plc_echo_ns": (t_ns, t_ns + 1, t_ns - 250_000_000, t_ns - 250_000_001, t_ns - 249_999_999, 0),
            "mode": tuple(range(10)),
            "axis_mask": (axis_mask(self.table), axis_mask(self.table) >> 1, 0xFF, 0),
            "cfg_id": (self._cfg_id, self._cfg_id ^ 1, 0),
            "traj_id": (traj_id, traj_id - 1, traj_id + 1, 0, 1, 0xFFFF_FFFF),
            "knot_first": (state.knot_playing, 0, *(state.knot_last + d for d in (-6, -1, 0, 1, 2, 59, 60))),
            "knot_count": (0, 1, 2, 5, 6, 7, 255),
            "interp": (0, 1, 2, 3, 4),
            "cmd_flags": (0, 1, 2, 3, 4, 5, 6, 7, 0xFFFF),
            "timeout_us": (0, 99_999, 100_000, 120_000, 250_001, 0xFFFF_FFFF),
            "ver_minor": (0, 1, 2, 255),
            "ver_major": (0, 1, 2),
            "msg_type": (1, 3, 1, 3, 2, 4, 0),
            "t_ns": (0, state.t_play_ns, state.t_play_ns + 100_000_000, state.t_play_ns + 99_999_999),
        }

    def restamped(self, payload: bytes) -> bytes:
        """A command of another time or session, made to belong to this moment."""
        state = self.state
        stamps = (
            (16, 4, state.session or self.session), (20, 4, (state.ack_seq + 1) % _MODULUS), (32, 4, state.nonce),
            (36, 4, state.seq), (40, 8, state.t_send_ns), (52, 4, self._cfg_id),
        )  # fmt: skip
        for offset, size, value in stamps:
            payload = with_value(payload, offset, size, value)
        return payload
