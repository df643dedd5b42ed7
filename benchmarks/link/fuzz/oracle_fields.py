"""The fields of both messages as the oracles read them: at the offsets of docs/plc-link.md."""

import struct
from dataclasses import dataclass
from typing import Any

KnotFields = tuple[int, tuple[float, ...], tuple[float, ...], tuple[float, ...]]  # t_ns, q, qd, qdd
_KNOT = struct.Struct("<Q24d")
_COMMAND = struct.Struct("<IIQ IIQ HHI II BBHI d")  # from offset 16: session ... speed_override
_STATE_HEAD = struct.Struct("<IIQ IIQ I")  # from 16: session, seq, t_send, nonce, ack_seq, t_pc_echo, rx_age_us
_AXES = struct.Struct("<8d")


@dataclass(frozen=True, slots=True)
class CommandFields:
    """A command or HELLO."""

    hello: bool
    knots: tuple[KnotFields, ...]
    session: int
    seq: int
    t_send_ns: int
    arm_nonce: int
    ack_plc_seq: int
    t_plc_echo_ns: int
    mode: int
    axis_mask: int
    cfg_id: int
    traj_id: int
    knot_first: int
    knot_count: int
    interp: int
    cmd_flags: int
    timeout_us: int
    speed_override: float


def command_fields(payload: bytes) -> CommandFields:
    """A command that keeps to rules 1 and 2."""
    body = _COMMAND.unpack_from(payload, 16)
    knots = tuple(_knot(payload, 80 + 200 * k) for k in range(min(payload[64], 6)))
    return CommandFields(payload[6] == 3, knots, *body)


def _knot(payload: bytes, offset: int) -> KnotFields:
    t_ns, *numbers = _KNOT.unpack_from(payload, offset)
    return t_ns, tuple(numbers[:8]), tuple(numbers[8:16]), tuple(numbers[16:])


@dataclass(frozen=True, slots=True)
class StateFields:
    """What the oracles use of a state."""

    session: int = 0
    seq: int = 0
    t_send_ns: int = 0
    nonce: int = 0
    ack_seq: int = 0
    t_pc_echo_ns: int = 0
    rx_age_us: int = 0
    plc_state: int = 0
    link_state: int = 0
    fault_bits: int = 0
    cfg_id: int = 0
    reject_code: int = 0
    reject_seq: int = 0
    reject_offset: int = 0
    traj_id: int = 0
    knot_playing: int = 0
    knot_last: int = 0
    t_play_ns: int = 0
    rx_ok: int = 0
    wd_trips: int = 0
    q_ref: tuple[float, ...] = (0.0,) * 8
    qd_ref: tuple[float, ...] = (0.0,) * 8


def state_fields(payload: bytes) -> StateFields:
    """A state that keeps to rules 1 and 2."""

    def at(offset: int, size: int) -> int:
        return int.from_bytes(payload[offset : offset + size], "little")

    values: tuple[Any, ...] = (
        *_STATE_HEAD.unpack_from(payload, 16), payload[58], payload[59], at(64, 8), at(80, 4), at(84, 2), at(88, 4),
        at(560, 4), at(92, 4), at(96, 4), at(100, 4), at(104, 8), at(120, 4), at(140, 4),
        _AXES.unpack_from(payload, 272), _AXES.unpack_from(payload, 336),
    )  # fmt: skip
    return StateFields(*values)
