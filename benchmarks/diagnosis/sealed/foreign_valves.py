"""The foreign plant's PLC and valves, compiled: controller, spool, flow set point, and what the oil is asked to do.

Exudyn integrates arm, cylinders and oil; before each of its steps this says how far every edge of the valves is open.
Effects enter where their definitions say; names and columns of `benchmarks.diagnosis.sealed.faults`.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from benchmarks.diagnosis.sealed import faults as f
from benchmarks.diagnosis.sealed import foreign_geometry as g
from benchmarks.diagnosis.sealed import foreign_machine as m
from benchmarks.diagnosis.sealed import foreign_numbers as k
from machine.rotations import Array

STEP_S = 1e-3  # of Exudyn's integrator
STEPS = 5  # in a PLC cycle
PARTS = 4  # of a step, for the spool
RESTICK = 0.2  # of the breakaway command (the effect's definition)
LEAST_DROP_PA = 2e4  # over an edge, where an added flow is turned into an opening

# Columns of `Setup.joint`
KP, PT1, COUNT, SPEED, AREA_A, AREA_B = range(6)
# Columns of the state, one row a joint
LAGGED, U, HELD, SLOW, SPOOL, SPOOL_RATE, MOVING, WIND, FORCE = range(9)


class Setup(NamedTuple):
    """Everything constant, as arrays the compiled step can take."""

    joint: Array  # (3, 6)
    wrong: Array  # (3, COLUMNS): what is wrong
    encoder: Array  # (3, 5): bias, scale, eccentric amplitude, order, phase
    flow_limit: float
    low: Array
    step: Array
    lever: Array
    load: Array  # (4,): weights' torque about lift, over its largest: cos, sin of lift, of lift + tilt; then tilt's
    ref: Array
    shock: Array
    given: Array  # (0 or m, 3)


class Rows(NamedTuple):
    """What is logged, one row a PLC cycle."""

    enc: Array
    u: Array
    smooth: Array  # encoders before they count
    tree_q: Array
    pressures: Array


def load_rows() -> Array:
    """Torque of the nominal weights about lift and tilt (2, 4) over its largest in the joints' ranges.

    Model: t_lift = r0 cos q2 + r1 sin q2 + r2 cos(q2 + q3) + r3 sin(q2 + q3); tilt's has the last two terms only.
    """
    (_, _), (m2, c2), (m3, c3) = m.bodies()
    weight = k.GRAVITY
    forward, up = c3[2], c3[0] + g.A3  # of the tilt boom's mass from its pivot, boom along the horizon
    tilt = [-m3 * weight * forward, m3 * weight * up]
    lift = [-weight * (m2 * (g.A2 + c2[0]) + m3 * g.A2), weight * m2 * c2[1]]
    rows = np.array([[*lift, *tilt], [0.0, 0.0, *tilt]])
    low, high = np.deg2rad(np.array(k.RANGES_DEG[1:])).T
    q2, q3 = np.meshgrid(np.linspace(low[0], high[0], 96), np.linspace(low[1], high[1], 96))
    terms = np.stack([np.cos(q2), np.sin(q2), np.cos(q2 + q3), np.sin(q2 + q3)])
    return rows / np.abs(np.einsum("rt,tab->rab", rows, terms)).max(axis=(1, 2))[:, None]


def setup(faults: f.Faults, encoder: Array, ref: Array, shock: Array, given: Array) -> Setup:
    """Numbers of the machine and of what is wrong with it."""
    joint = np.zeros((3, 6))
    joint[:, KP], joint[:, PT1], joint[:, SPEED] = k.KP, k.PT1_S, k.SPEED_FULL
    joint[:, COUNT] = 2.0 * np.pi / k.COUNTS
    joint[:, AREA_A], joint[:, AREA_B] = k.AREA_A, (k.AREA_A, k.AREA_B, k.AREA_B)
    one = g.levers()
    arrays = (np.ascontiguousarray(x) for x in (ref, shock, given))
    return Setup(
        joint, faults.joint, encoder, float(faults.flow_limit), one.low, one.step, one.table, load_rows(), *arrays
    )


@njit(cache=True)
def _lever(setup, j: int, q: float) -> float:
    a = (q - setup.low[j]) / setup.step[j]
    i = min(max(int(a), 0), setup.lever.shape[1] - 2)
    a -= i
    return (1.0 - a) * setup.lever[j, i] + a * setup.lever[j, i + 1]


@njit(cache=True)
def cycle(setup, state: Array, rows, row: int, q: Array, p: Array) -> None:
    """The PLC's cycle: read encoders, command the valves, log."""
    seconds = STEPS * STEP_S
    for j in range(3):
        w, c, e, at = setup.wrong[j], setup.joint[j], setup.encoder[j], q[2 * j]
        reading = at * (1.0 + e[1]) + e[0] + e[2] * np.sin(e[3] * at + e[4]) + w[f.GEAR] * np.sin(w[f.GEAR_ORDER] * at)
        rows.smooth[row, j] = reading
        reading = np.round(reading / c[COUNT]) * c[COUNT]
        tau = c[PT1] * (1.0 + w[f.KP_LAG])
        share = 1.0 - np.exp(-seconds / tau) if tau > 0.0 else 1.0
        wanted = c[KP] * (1.0 + w[f.KP_GAIN]) * (setup.ref[row, j] - reading)
        state[j, LAGGED] += share * (wanted - state[j, LAGGED])
        state[j, U] = min(max(state[j, LAGGED], -w[f.U_LIMIT]), w[f.U_LIMIT])
        if setup.given.shape[0]:
            state[j, U] = setup.given[row, j]
        state[j, WIND] = 0.99 * state[j, WIND] + setup.shock[row, j]
        rows.enc[row, j], rows.u[row, j] = reading, state[j, U]
    rows.tree_q[row] = q[:7]
    rows.pressures[row, :6] = p


@njit(cache=True)
def _spool(c: Array, w: Array, s: Array) -> None:
    """Hysteresis, lag and the spool's own second order over one step, into s."""
    dt, omega = STEP_S / PARTS, 2.0 * np.pi * k.VALVE_HZ
    half = k.HYSTERESIS + w[f.HYSTERESIS]
    share = 1.0 - np.exp(-dt / w[f.LAG]) if w[f.LAG] > 0.0 else 1.0
    s[HELD] = min(max(s[HELD], s[U] - half), s[U] + half)
    for _ in range(PARTS):
        s[SLOW] += share * (s[HELD] - s[SLOW])
        s[SPOOL_RATE] += dt * (omega * omega * (s[SLOW] - s[SPOOL]) - 2.0 * k.VALVE_DAMPING * omega * s[SPOOL_RATE])
        s[SPOOL_RATE] = min(max(s[SPOOL_RATE], -w[f.SPOOL_RATE]), w[f.SPOOL_RATE])
        s[SPOOL] = min(max(s[SPOOL] + dt * s[SPOOL_RATE], -1.0), 1.0)


@njit(cache=True)
def _opened(w: Array, s: Array, load: float, minutes: float) -> float:
    """The valve's opening, of full, behind spool, stiction, dead band and flow gains."""
    x = s[SPOOL]
    if s[MOVING] != 0.0 and (x * s[MOVING] <= 0.0 or abs(x) <= RESTICK * w[f.BREAKAWAY]):
        s[MOVING] = 0.0
    if s[MOVING] == 0.0 and abs(x) > w[f.BREAKAWAY]:
        s[MOVING] = 1.0 if x > 0.0 else -1.0
    band = k.DEAD_BAND + w[f.DEADBAND]
    if s[MOVING] == 0.0 or abs(x) <= band:
        return 0.0
    sign = 1.0 if x > 0.0 else -1.0
    out = sign * (abs(x) - band) / (1.0 - band) * (1.0 + w[f.FLOW]) * (1.0 + w[f.WARMING] * minutes)
    if x > 0.0:
        out *= 1.0 + w[f.ASYMMETRY]
    return out * max(1.0 + sign * w[f.DROOP] * load, 0.0)


@njit(cache=True)
def _root(drop: float) -> float:
    return np.sqrt(abs(drop)) * (1.0 if drop >= 0.0 else -1.0)


@njit(cache=True)
def _edge(flow: float, p: float) -> float:
    """Opening of one edge, in Exudyn's sense (+ to the supply, - to the tank), that lets this flow [m3/s] through."""
    drop = k.P_SUPPLY - p if flow > 0.0 else p - k.P_TANK
    return flow / (k.VALVE_FLOW * _root(max(drop, LEAST_DROP_PA)))


@njit(cache=True)
def _set_point(c: Array, s: Array, speed: float, p_a: float, p_b: float) -> float:
    """Opening that gives a cylinder speed [m/s] at the load that the slow pressure measurement tells.

    Model: steady flow through both edges, v = o K sqrt((A pS - B pT - F) / (A^3 + B^3)) out,
           v = o K sqrt((F + B pS - A pT) / (A^3 + B^3)) in.
    """
    s[FORCE] += STEP_S / k.COMPENSATOR_S * (p_a * c[AREA_A] - p_b * c[AREA_B] - s[FORCE])
    force, cubes = k.COMPENSATED * s[FORCE], c[AREA_A] ** 3 + c[AREA_B] ** 3
    if speed > 0.0:
        spare = c[AREA_A] * k.P_SUPPLY - c[AREA_B] * k.P_TANK - force
        return speed * (1.0 + k.FLOW_ERROR[0]) / (k.VALVE_FLOW * np.sqrt(max(spare, 1e3) / cubes))
    spare = force + c[AREA_B] * k.P_SUPPLY - c[AREA_A] * k.P_TANK
    return speed * (1.0 + k.FLOW_ERROR[1]) / (k.VALVE_FLOW * np.sqrt(max(spare, 1e3) / cubes))


@njit(cache=True)
def step(setup, state: Array, number: int, q: Array, p: Array, out: Array) -> float:
    """Openings of both edges of every valve (6,) for one step of the integrator, into out; the supply's pressure."""
    now = number * STEP_S
    supply = k.P_SUPPLY + k.RIPPLE_PA * np.sin(2.0 * np.pi * k.RIPPLE_HZ * now)
    sums = np.array([np.cos(q[2]), np.sin(q[2]), np.cos(q[2] + q[4]), np.sin(q[2] + q[4])])
    load, wanted, demand = np.zeros(3), np.zeros(3), 0.0
    load[1], load[2] = (setup.load[0] * sums).sum(), (setup.load[1] * sums).sum()
    for j in range(3):
        _spool(setup.joint[j], setup.wrong[j], state[j])
        wanted[j] = _opened(setup.wrong[j], state[j], load[j], now / 60.0)
        demand += abs(wanted[j])
    served = setup.flow_limit / demand if demand > setup.flow_limit else 1.0
    for j in range(3):
        c, p_a, p_b = setup.joint[j], p[2 * j], p[2 * j + 1]
        lever = _lever(setup, j, q[2 * j])
        o = _set_point(c, state[j], wanted[j] * served * c[SPEED] * lever, p_a, p_b)
        pushed = lever * (setup.wrong[j, f.LEAK] * load[j] + state[j, WIND])  # past the valve [m/s]
        if o >= 0.0:
            flow_a, flow_b = o * _root(supply - p_a), -o * _root(p_b - k.P_TANK)
        else:
            flow_a, flow_b = o * _root(p_a - k.P_TANK), -o * _root(supply - p_b)
        out[2 * j] = _edge(k.VALVE_FLOW * flow_a + c[AREA_A] * pushed, p_a)
        out[2 * j + 1] = _edge(k.VALVE_FLOW * flow_b - c[AREA_B] * pushed, p_b)
    return supply
