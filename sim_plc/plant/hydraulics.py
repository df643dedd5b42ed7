"""Servo valve, orifices, chambers and pump: right sides and steps of the oil, one joint at a time."""

import numpy as np
from numba import njit

OIL_VAPOUR_PRESSURE_PA = 2e3  # absolute: the oil cannot be pulled below this


@njit(cache=True, error_model="numpy")
def spool_step(
    x: float, xd: float, u: float, omega: float, damping: float, rate_limit: float, dt: float
) -> tuple[float, float]:
    """Spool position and speed after dt.

    Model:   x'' = wn^2 (u - x) - 2 z wn x', |x'| limited, |x| <= 1; semi-implicit.
    """
    xd = xd + dt * (omega * omega * (u - x) - 2.0 * damping * omega * xd)
    xd = min(max(xd, -rate_limit), rate_limit)
    x = x + dt * xd
    if x > 1.0:
        return 1.0, min(xd, 0.0)
    if x < -1.0:
        return -1.0, max(xd, 0.0)
    return x, xd


@njit(cache=True, error_model="numpy")
def spool_opening(x: float, dead_band: float) -> float:
    """Effective opening of a spool with overlap: 0 inside +-dead_band, +-1 at full stroke."""
    if x > dead_band:
        return (x - dead_band) / (1.0 - dead_band)
    if x < -dead_band:
        return (x + dead_band) / (1.0 - dead_band)
    return 0.0


@njit(cache=True, error_model="numpy")
def orifice_pressure_root(pressure_drop: float, laminar: float) -> float:
    """Signed root of the pressure drop with a finite slope at zero: dp / sqrt(|dp| + p_lam) [sqrt Pa]."""
    return pressure_drop / np.sqrt(abs(pressure_drop) + laminar)


@njit(cache=True, error_model="numpy")
def valve_flows(
    s: float, gain: float, p_a: float, p_b: float, p_supply: float, p_tank: float, laminar: float
) -> tuple[float, float, float]:
    """Flows into chamber A, into chamber B and out of the supply [m3/s]; the inlet check valve lets nothing back.

    Model:   s > 0: qA = Kv s f(pS - pA), qB = -Kv s f(pB - pT); s < 0 mirrored.
    """
    if s > 0.0:
        q_in = gain * s * max(orifice_pressure_root(p_supply - p_a, laminar), 0.0)
        return q_in, -gain * s * orifice_pressure_root(p_b - p_tank, laminar), q_in
    if s < 0.0:
        q_in = -gain * s * max(orifice_pressure_root(p_supply - p_b, laminar), 0.0)
        return gain * s * orifice_pressure_root(p_a - p_tank, laminar), q_in, q_in
    return 0.0, 0.0, 0.0


@njit(cache=True, error_model="numpy")
def pump_flow(p_supply: float, p_set: float, droop: float, flow_max: float) -> float:
    """Flow of a pressure-compensated pump [m3/s]: none at the set pressure, all of it `droop` below."""
    return flow_max * min(max((p_set - p_supply) / droop, 0.0), 1.0)


# Play: an output that follows its input only at the edges of a gap.


@njit(cache=True, error_model="numpy")
def play_operator(output: float, value: float, half_width: float) -> float:
    """New output of the play operator; half_width = 0 is the identity.

    Model:   out <- min(max(out, in - b/2), in + b/2).
    """
    if output < value - half_width:
        return value - half_width
    if output > value + half_width:
        return value + half_width
    return output
