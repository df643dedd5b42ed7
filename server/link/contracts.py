"""Reports of the link process to the server, and the server's requests to it: plain frozen data between processes."""

import math
from dataclasses import dataclass
from enum import Enum


class LinkPhase(Enum):
    """How far the connection to the PLC has come."""

    OFFLINE = "offline"  # no state datagram for 250 ms
    DISARMED = "disarmed"  # states arrive, no session
    LINKED = "linked"  # session open, not armed
    ARMED = "armed"  # holding; a trajectory may be sent
    RUNNING = "running"
    STOPPING = "stopping"
    FAULT = "fault"
    LOCAL = "local"


@dataclass(frozen=True, slots=True)
class PlcSample:
    """One PLC state as the server uses it. `t_mono_ns` is the PC's receive time; joints only, n values each, SI."""

    t_plc_ns: int
    t_mono_ns: int
    seq: int
    q_rad: tuple[float, ...]
    qd_rad_s: tuple[float, ...]
    q_ref_rad: tuple[float, ...]
    qd_ref_rad_s: tuple[float, ...]
    valve_frac: tuple[float, ...]
    pressure_a_pa: tuple[float, ...]
    pressure_b_pa: tuple[float, ...]
    pressure_supply_pa: float
    oil_temperature_c: float
    plc_state: str
    traj_id: int
    knot_playing: int
    t_play_ns: int
    buffer_us: int
    underruns: int
    fault_bits: int
    reject_code: int
    simulation: bool
    dry_run: bool = False


def measured_oil_c(sample: PlcSample) -> float | None:
    """The oil's temperature, where the machine measures it: a PLC without the sensor sends 0 or NaN."""
    value_c = sample.oil_temperature_c
    return value_c if math.isfinite(value_c) and value_c != 0.0 else None


@dataclass(frozen=True, slots=True)
class LinkHealth:
    """Counters and timing of the link process, for the panel and the metrics."""

    phase: LinkPhase
    age_ms: float
    sent: int
    received: int
    lost: int
    rejected: int
    lateness_p50_us: float
    lateness_p99_us: float
    lateness_max_us: float
    round_trip_ms: float  # the newest one
    last_reject: str
    session: int
    warning: str = ""  # why timing may be worse than it should be; empty: nothing to say
    buffer_min_us: int = 0  # smallest buffer depth of the newest trajectory while it ran
    receive_timestamps: str = "kernel"  # or "process": who stamped the received datagrams
    error: str = ""  # why the link cannot work at all at the moment (name not found, ...)
    dry_run: bool = False  # the PLC plays everything, but its valves stay neutral
    cfg_id: int = 0  # of the limits in the PLC, as it says
    recent_rejects: tuple[str, ...] = ()  # the newest ten: code, remedy, field and value, command number
    round_trip_min_ms: float = 0.0  # the quickest of the last half minute
    other_pc: str = ""  # that another PC has or wants the PLC's session, while that is heard
    samples_dropped: int = 0  # states that the server did not fetch in time, since the link process began


@dataclass(frozen=True, slots=True)
class MotionEnded:
    """A trajectory came to its end: reached, stopped, or why not."""

    traj_id: int
    reached: bool
    reason: str
    t_plc_ns: int


@dataclass(frozen=True, slots=True)
class ArmRequest:
    """Open a session if needed and arm; answered by phases in LinkHealth. Lapses unless repeated within `valid_s`."""

    valid_s: float = 0.6


@dataclass(frozen=True, slots=True)
class RunRequest:
    """Play this trajectory from the present reference; gate-checked first. Knots: (t_ns, q, qd, qdd)."""

    traj_id: int
    knots: tuple[tuple[int, tuple[float, ...], tuple[float, ...], tuple[float, ...]], ...]


@dataclass(frozen=True, slots=True)
class StopRequest:
    """Ramp down and hold, along the path or (quick) every joint as fast as it may; always accepted."""

    reason: str
    quick: bool = False


@dataclass(frozen=True, slots=True)
class CorrectRequest:
    """Replace the running trajectory from knot `first_knot` on; gate-checked. Answered by one TailReport."""

    traj_id: int
    first_knot: int
    knots: tuple[tuple[int, tuple[float, ...], tuple[float, ...], tuple[float, ...]], ...]


@dataclass(frozen=True, slots=True)
class SilenceRequest:
    """Send nothing for a while, as if the PC were gone; for commissioning, to see that the PLC stops by itself."""

    duration_s: float


@dataclass(frozen=True, slots=True)
class HoldRequest:
    """Motion is allowed until then only [monotonic ns, one clock for all processes]; None: it need not be held.

    Why here and not in the server alone: a server that is busy for half a second must not be what ends the motion.
    """

    until_ns: int | None


@dataclass(frozen=True, slots=True)
class SteerRequest:
    """Motion that is steered by what the camera sees may go on until then only [monotonic ns]; None: nothing steers.

    Renewed with every pair that is judged: a server that stalls can neither judge a pair nor send a stop.
    """

    until_ns: int | None


@dataclass(frozen=True, slots=True)
class ResetRequest:
    """Clear a latched fault; never restarts motion. Lapses after `valid_s`: a later fault must be looked at first."""

    valid_s: float = 3.0


@dataclass(frozen=True, slots=True)
class DisarmRequest:
    """Leave the armed state."""


@dataclass(frozen=True, slots=True)
class SamplesReport:
    """The PLC states received since the last report, oldest first.

    `dropped`: so many were lost in a full queue since the link process began.
    """

    samples: tuple[PlcSample, ...]
    dropped: int = 0


@dataclass(frozen=True, slots=True)
class BindFailed:
    """The link process cannot listen where it should, and ends: why."""

    text: str


@dataclass(frozen=True, slots=True)
class HealthReport:
    """The link's health, ten times a second and at every change of phase; t_pc = t_plc + offset (None: not known)."""

    health: LinkHealth
    plc_to_pc_offset_ns: int | None


@dataclass(frozen=True, slots=True)
class RunRefused:
    """A trajectory was refused before anything was sent."""

    traj_id: int
    reason: str


@dataclass(frozen=True, slots=True)
class TailReport:
    """A correction was taken by the PLC, or not: then the trajectory goes on as it was."""

    traj_id: int
    taken: bool
    text: str


LinkRequest = (
    ArmRequest
    | RunRequest
    | CorrectRequest
    | StopRequest
    | SilenceRequest
    | HoldRequest
    | SteerRequest
    | ResetRequest
    | DisarmRequest
)
LinkReport = SamplesReport | HealthReport | MotionEnded | RunRefused | TailReport | BindFailed
