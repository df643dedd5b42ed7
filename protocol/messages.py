"""The messages as frozen data: always 8 axes, SI units, field names as on the wire."""

from dataclasses import dataclass

from protocol.codes import CommandFlag, HeaderFlag, Interp, LinkState, Mode, PlcState
from protocol.layout import N_AXIS_SLOTS, VERSION_MINOR

Axes = tuple[float, ...]
_NO_HEADER_FLAGS = HeaderFlag(0)
_NO_COMMAND_FLAGS = CommandFlag(0)
ZEROS: Axes = (0.0,) * N_AXIS_SLOTS
EMPTY_AUTH_TAG = bytes(16)


def pad_to_eight_axes(values: tuple[float, ...]) -> Axes:
    """The values of a machine's joints, filled up with zeros to 8 axes."""
    return (*values, *(0.0,) * (N_AXIS_SLOTS - len(values)))


@dataclass(frozen=True, slots=True)
class Knot:
    """One point of the reference: time from the start, position [rad], velocity [rad/s], acceleration [rad/s^2]."""

    t_ns: int
    q: Axes = ZEROS
    qd: Axes = ZEROS
    qdd: Axes = ZEROS


@dataclass(frozen=True, slots=True)
class Command:
    """PC to PLC. `hello` marks a HELLO (same layout, msg_type 3); `knots` holds 0..6 from index `knot_first` on."""

    session: int
    seq: int
    t_send_ns: int
    mode: Mode = Mode.HEARTBEAT
    hello: bool = False
    flags: HeaderFlag = _NO_HEADER_FLAGS
    arm_nonce: int = 0
    ack_plc_seq: int = 0
    t_plc_echo_ns: int = 0
    axis_mask: int = 0
    cfg_id: int = 0
    traj_id: int = 0
    knot_first: int = 0
    interp: Interp = Interp.NONE
    cmd_flags: CommandFlag = _NO_COMMAND_FLAGS
    timeout_us: int = 0
    speed_override: float = 1.0
    knots: tuple[Knot, ...] = ()
    auth_tag: bytes = EMPTY_AUTH_TAG
    ver_minor: int = VERSION_MINOR


@dataclass(frozen=True, slots=True)
class PlcStatus:
    """The part of a state that the PLC's own logic knows; the link adds session, sequence, echo and counters."""

    plc_cycle: int = 0
    plc_cycle_us: int = 1000
    mode_active: Mode = Mode.HEARTBEAT
    axis_mask: int = 0
    fault_bits: int = 0
    warn_bits: int = 0
    traj_id: int = 0
    knot_playing: int = 0
    knot_last: int = 0
    t_play_ns: int = 0
    buffer_us: int = 0
    underruns: int = 0
    q: Axes = ZEROS
    qd: Axes = ZEROS
    q_ref: Axes = ZEROS
    qd_ref: Axes = ZEROS
    valve_cmd: Axes = ZEROS
    p_a: Axes = ZEROS
    p_b: Axes = ZEROS
    axis_status: tuple[int, ...] = (0,) * N_AXIS_SLOTS
    p_supply: float = 0.0
    p_tank: float = 0.0
    t_oil: float = 0.0
    speed_scale: float = 1.0
    simulation: bool = False
    dry_run: bool = False


@dataclass(frozen=True, slots=True)
class State:
    """PLC to PC, every 10 ms. Pressures [Pa], oil temperature [degC], valve command -1..1."""

    session: int
    seq: int
    t_send_ns: int
    plc_state: PlcState
    flags: HeaderFlag = _NO_HEADER_FLAGS
    nonce: int = 0
    ack_seq: int = 0
    t_pc_echo_ns: int = 0
    rx_age_us: int = 0
    plc_cycle: int = 0
    plc_cycle_us: int = 0
    link_state: LinkState = LinkState.NO_SESSION
    mode_active: Mode = Mode.HEARTBEAT
    axis_mask: int = 0
    fault_bits: int = 0
    warn_bits: int = 0
    cfg_id: int = 0
    reject_code: int = 0
    reject_count: int = 0
    reject_seq: int = 0
    traj_id: int = 0
    knot_playing: int = 0
    knot_last: int = 0
    t_play_ns: int = 0
    buffer_us: int = 0
    underruns: int = 0
    rx_ok: int = 0
    rx_lost: int = 0
    rx_dup: int = 0
    rx_late: int = 0
    rx_bad: int = 0
    wd_trips: int = 0
    q: Axes = ZEROS
    qd: Axes = ZEROS
    q_ref: Axes = ZEROS
    qd_ref: Axes = ZEROS
    valve_cmd: Axes = ZEROS
    p_a: Axes = ZEROS
    p_b: Axes = ZEROS
    axis_status: tuple[int, ...] = (0,) * N_AXIS_SLOTS
    p_supply: float = 0.0
    p_tank: float = 0.0
    t_oil: float = 0.0
    speed_scale: float = 1.0
    reject_offset: int = 0
    auth_tag: bytes = EMPTY_AUTH_TAG
    ver_minor: int = VERSION_MINOR
