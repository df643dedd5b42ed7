"""The PLC's part of the state message, put together every 10 ms."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from machine.rotations import Array
from protocol.codes import AxisBit, Mode, WarnBit
from protocol.messages import Axes, PlcStatus, pad_to_eight_axes
from sim_plc.plc.knot_ring import KnotRing
from sim_plc.plc.monitor import Monitor
from sim_plc.plc.reference import Motion, Reference
from sim_plc.plc.sample import PlantSample
from sim_plc.plc.settings import PlcSettings

_MODES = {
    Motion.FOLLOW: Mode.HEARTBEAT,
    Motion.HOLD: Mode.HOLD,
    Motion.PLAY: Mode.TRAJECTORY,
    Motion.PATH_STOP: Mode.STOP,
    Motion.JOINT_STOP: Mode.STOP,
    Motion.SERVO: Mode.SERVO,
}
_BY_OVERRIDE = (Motion.HOLD, Motion.SERVO)


@dataclass(slots=True)
class PlcCounters:
    """Counted since the start; `trajectory_starved` refers to the present trajectory."""

    n_cycles: int = 0
    n_underruns: int = 0
    trajectory_starved: bool = False


def status_of(
    settings: PlcSettings,
    counters: PlcCounters,
    ring: KnotRing,
    reference: Reference,
    monitor: Monitor,
    valves: Array,
    sample: PlantSample,
    dry_run: bool,
) -> PlcStatus:
    """The status of this cycle; a reading that is not finite is sent as 0 with the axis' ENCODER_FAULT bit.

    An encoder that jumped keeps that bit until RESET.
    """
    warnings = monitor.warnings | (WarnBit.UNDERRUN if counters.trajectory_starved else WarnBit(0))
    return PlcStatus(
        plc_cycle=counters.n_cycles & 0xFFFF_FFFF,
        plc_cycle_us=settings.cycle_ns // 1000,
        mode_active=_MODES[reference.motion],
        axis_mask=(1 << settings.n) - 1,
        fault_bits=int(monitor.latched),
        warn_bits=int(warnings),
        traj_id=ring.traj_id,
        knot_playing=reference.knot_playing,
        knot_last=max(ring.last, 0),
        t_play_ns=reference.t_play_ns,
        buffer_us=round(reference.buffer_s * 1e6),
        underruns=counters.n_underruns,
        q=_finite_axis_values(sample.q_rad),
        qd=_finite_axis_values(sample.qd_rad_s),
        q_ref=_finite_axis_values(reference.q),
        qd_ref=_finite_axis_values(reference.qd),
        valve_cmd=_finite_axis_values(valves),
        p_a=_finite_axis_values(sample.p_a_pa),
        p_b=_finite_axis_values(sample.p_b_pa),
        axis_status=(*_axis_words(settings, monitor, sample.q_rad, reference.q, valves), *(0,) * (8 - settings.n)),
        p_supply=sample.p_supply_pa,
        p_tank=sample.p_tank_pa,
        t_oil=sample.t_oil_c,
        speed_scale=reference.speed_override if reference.motion in _BY_OVERRIDE else reference.rate,
        simulation=True,
        dry_run=dry_run,
    )


def _finite_axis_values(values: Array) -> Axes:
    return pad_to_eight_axes(tuple(np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0).tolist()))


def _axis_words(settings: PlcSettings, monitor: Monitor, q: Array, q_ref: Array, valves: Array) -> tuple[int, ...]:
    """axis_status of every joint in use."""
    readable = np.isfinite(q)
    words = np.full(settings.n, int(AxisBit.IN_USE))
    words += int(AxisBit.AT_Q_MIN) * (readable & (q <= settings.q_min))
    words += int(AxisBit.AT_Q_MAX) * (readable & (q >= settings.q_max))
    words += int(AxisBit.VALVE_SATURATED) * (np.abs(valves) >= 1.0)
    jumped = (monitor.jumped >> np.arange(settings.n)) & 1 == 1
    words += int(AxisBit.ENCODER_FAULT) * (~readable | jumped)
    words += int(AxisBit.LAG) * (readable & (np.abs(q_ref - q) > settings.lag_warn))
    return tuple(words.tolist())


# The paper's joint controllers: P (eq. 6), and PT-1 (eq. 25) on the joints that carry the weight.


@njit(cache=True)
def valve_commands(q_ref: Array, q: Array, kp: Array, pt1_share: Array, fade: float, lagged: Array, out: Array) -> None:
    """One cycle of all joints into `out` (n,); `lagged` (n,) is kept from cycle to cycle."""
    for j in range(q.shape[0]):
        u = kp[j] * (q_ref[j] - q[j])  # eq. 6
        lagged[j] += pt1_share[j] * (u - lagged[j])  # eq. 25 over one cycle; a share of 1 is plain P
        out[j] = min(max(lagged[j], -1.0), 1.0) * fade


class JointControl:
    """Valve commands (n,) [fraction of full command] from the reference and the encoders.

    Model:   u = kp (q_ref - q), followed by 1 / (tau s + 1) where tau > 0 (exact for an input held over the cycle);
             then clipped to -1..1, and times the fade (1 but during a ramp).
    Source:  the paper, eqs. 6 and 25.
    """

    def __init__(self, settings: PlcSettings) -> None:
        self._settings = settings
        self._lagged = np.zeros(settings.n)
        self.valves = np.zeros(settings.n)

    def neutral(self) -> Array:
        """Valves closed, PT-1 states forgotten."""
        self._lagged[:] = 0.0
        self.valves[:] = 0.0
        return self.valves

    def control(self, q_ref: Array, q: Array, fade: float) -> Array:
        """Valve commands of this cycle, times fade; a view that the next cycle changes."""
        settings = self._settings
        valve_commands(q_ref, q, settings.kp_frac_per_rad, settings.pt1_share, fade, self._lagged, self.valves)
        return self.valves
