"""A PLC that means well, as far as the PC's end can see it: the states that the fuzzer mutates."""

from dataclasses import replace

from benchmarks.link.fuzz.elements import Near
from benchmarks.link.fuzz.mutators import with_value
from benchmarks.link.fuzz.oracle_fields import CommandFields
from protocol.codec import encode_state
from protocol.codes import CommandFlag, LinkState, Mode, PlcState, RejectCode
from protocol.limits import LimitTable, axis_mask, cfg_id
from protocol.messages import State, pad_to_eight_axes

_PERIOD_NS = 10_000_000
_RAMP_TICKS = 30
_MODULUS = 0x1_0000_0000
_MOTIONS = (Mode.TRAJECTORY, Mode.SERVO)


class HonestPlc:
    """Makes state payloads (CRC right, not signed); `hear` commands, `tick` every 10 ms."""

    def __init__(self, table: LimitTable, first_seq: int) -> None:
        middle = tuple(0.5 * (axis.q_min + axis.q_max) for axis in table.axes)
        self.state = State(
            0, first_seq, 50_000_000_000, PlcState.DISARMED, nonce=77, axis_mask=axis_mask(table),
            cfg_id=cfg_id(table), q=pad_to_eight_axes(middle),
            q_ref=pad_to_eight_axes(middle), link_state=LinkState.NO_SESSION,
        )  # fmt: skip
        self._step_ns = 50_000_000
        self._ramp_ticks = 0

    def payload(self) -> bytes:
        """The newest state."""
        return encode_state(self.state)

    def tick(self) -> None:
        """The next state: 10 ms later, the motion a little further on."""
        old = self.state
        self.state = replace(old, seq=(old.seq + 1) % _MODULUS, t_send_ns=old.t_send_ns + _PERIOD_NS)
        if old.plc_state is PlcState.STOPPING:
            self._ramp_ticks -= 1
            if self._ramp_ticks <= 0:
                self._go(PlcState.HOLD)
        if old.plc_state is PlcState.RUN and old.mode_active is Mode.TRAJECTORY:
            self._play()

    def _play(self) -> None:
        t_play_ns = self.state.t_play_ns + _PERIOD_NS
        last = self.state.knot_last
        if t_play_ns >= last * self._step_ns:
            t_play_ns = last * self._step_ns
            self._go(PlcState.HOLD)
        playing = min(t_play_ns // self._step_ns, last)
        self.state = replace(self.state, t_play_ns=t_play_ns, knot_playing=playing)

    def _go(self, state: PlcState) -> None:
        self._ramp_ticks = _RAMP_TICKS if state is PlcState.STOPPING else 0
        self.state = replace(self.state, plc_state=state)

    def goes_to(self, state: PlcState) -> None:
        """What happens at the machine: FAULT, LOCAL, DISARMED."""
        self._go(state)

    def hear(self, command: CommandFields) -> None:
        """A command of the client arrives."""
        state, mode = self.state, Mode(command.mode)
        if command.hello:
            if state.session == 0:
                self.state = replace(state, session=command.session, rx_ok=0, link_state=LinkState.FRESH)
                if state.plc_state is PlcState.DISARMED:
                    self._go(PlcState.LINKED)
        elif mode is Mode.RESET or (mode is Mode.DISARM and state.plc_state in (PlcState.LINKED, PlcState.HOLD)):
            self.state = replace(state, session=0, plc_state=PlcState.DISARMED, nonce=state.nonce + 1)
        elif mode is Mode.ARM and state.plc_state is PlcState.LINKED:
            self._go(PlcState.HOLD)
        elif mode in (Mode.STOP, Mode.QUICK_STOP, Mode.HOLD, Mode.DISARM) and state.plc_state is PlcState.RUN:
            self._go(PlcState.STOPPING)
        elif mode in _MOTIONS and state.plc_state in (PlcState.HOLD, PlcState.RUN):
            self._move(command, mode)
        self.state = replace(
            self.state, ack_seq=command.seq, t_pc_echo_ns=command.t_send_ns, rx_ok=self.state.rx_ok + 1
        )

    def _move(self, command: CommandFields, mode: Mode) -> None:
        if mode is Mode.SERVO:
            self.state = replace(self.state, q_ref=command.knots[0][1])
        if command.traj_id != self.state.traj_id:
            self.state = replace(self.state, traj_id=command.traj_id, knot_last=0, knot_playing=0, t_play_ns=0)
        if mode is Mode.TRAJECTORY and len(command.knots) > 1:
            self._step_ns = max(command.knots[1][0] - command.knots[0][0], 1)
        last = max(self.state.knot_last, command.knot_first + len(command.knots) - 1)
        runs = self.state.plc_state is PlcState.RUN or bool(command.cmd_flags & CommandFlag.START)
        state = PlcState.RUN if runs else PlcState.HOLD
        self.state = replace(self.state, plc_state=state, mode_active=mode, knot_last=last)

    def near(self, session: int) -> Near:
        """Values that mean something at this moment, by field name."""
        state = self.state
        t_ns = state.t_send_ns
        steps = (-1001, -1000, -1, 0, 1, 2, 999, 1000, 1001, 0x7FFF_FFFF, 0x8000_0000)
        return {
            "session": (session, state.session, 0, session + 1),
            "seq": tuple(state.seq + step for step in steps),
            "t_send_ns": (t_ns, t_ns + 1, t_ns - 1, t_ns + _PERIOD_NS, 0),
            "nonce": (state.nonce, state.nonce + 1, 0),
            "ack_seq": (state.ack_seq, state.ack_seq + 1, 0),
            "t_pc_echo_ns": (state.t_pc_echo_ns, 0, 1),
            "plc_state": tuple(range(9)),
            "link_state": tuple(range(5)),
            "mode_active": tuple(range(10)),
            "reject_code": (*map(int, RejectCode), 60, 999),
            "reject_count": (0, 1, 2, 0xFFFF),
            "reject_seq": (state.ack_seq, state.ack_seq + 1, 0),
            "reject_offset": (0, 40, 48, 72, 88, 1304, 80, 1303, 0xFFFF_FFFF),
            "traj_id": (state.traj_id, state.traj_id + 1, 0),
            "knot_playing": (0, state.knot_playing, state.knot_last, 0xFFFF_FFFF, 64),
            "knot_last": (0, state.knot_last, state.knot_last + 1, 0xFFFF_FFFF, 63, 64),
            "t_play_ns": (0, state.t_play_ns, 1 << 63),
            "rx_ok": (0, 24, 25, 26),
            "ver_minor": (0, 1, 2, 255),
            "ver_major": (0, 1, 2),
            "msg_type": (2, 2, 1, 3, 4, 0),
        }

    def restamped(self, payload: bytes, session: int) -> bytes:
        """A state of another time or session, made to belong to this moment."""
        payload = with_value(payload, 16, 4, session)
        payload = with_value(payload, 20, 4, (self.state.seq + 1) % _MODULUS)
        return with_value(payload, 24, 8, self.state.t_send_ns + 1)
