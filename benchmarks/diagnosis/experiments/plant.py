"""The bench's own joints: valves, dead bands and loads at 0.25 ms (explicit midpoint), disturbed by an AR(1) wind.

Written from the definitions; nothing of the diagnosis' kernel, another step and another integrator. Times of other
files come in as arguments: a compiled cache sees changes of its own file only.
"""

import numpy as np
from numba import njit

from benchmarks.diagnosis.experiments.arm import ACTUATORS, CYCLE_S, DELAY_S, LOG_S, Truth
from machine.rotations import Array

STEP_S = 0.00025
COUNTS = 2**18
DEADBAND, HYSTERESIS, LAG, GAIN, DROOP = range(5)
COLUMNS = ("valve_deadband", "valve_hysteresis", "valve_lag", "flow_gain_error", "load_droop")


def faults(truth: Truth, n: int) -> Array:
    """Sizes (n, 5) by joint."""
    return np.array([[truth.of(name, j) for name in COLUMNS] for j in range(1, n + 1)])


def driven(sent: Array, sample_s: float, truth: Truth, noise: float, rng: np.random.Generator) -> Array:
    """Log rows of a run (rows, 3 n): received reference, encoder, command of each joint.

    Args: sent: reference (m, n) [rad], one every `sample_s`; the machine rests at its first row.
    """
    cycles = round(len(sent) * sample_s / CYCLE_S)
    shock = rng.normal(0.0, noise, (cycles, sent.shape[1]))
    late = DELAY_S + truth.of("transport_delay")
    per = round(sample_s / CYCLE_S)
    nominal = np.ascontiguousarray(ACTUATORS[: sent.shape[1]])
    every = round(LOG_S / CYCLE_S)
    fault = faults(truth, sent.shape[1])
    return _stepped(np.ascontiguousarray(sent), per, late, CYCLE_S, every, fault, nominal, shock)


@njit(cache=True)
def _stepped(
    sent: Array, per: int, late: float, cycle_s: float, every: int, fault: Array, nominal: Array, shock: Array
) -> Array:
    n = sent.shape[1]
    steps, count = round(cycle_s / STEP_S), 2.0 * np.pi / COUNTS
    rows = np.zeros(((shock.shape[0] - 1) // every + 1, 3 * n))
    q, x, xd, slow, play, wind = sent[0].copy(), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    for k in range(shock.shape[0]):
        at = int(np.floor((k * cycle_s - late) / (per * cycle_s) + 1e-9))
        at = min(max(at, 0), sent.shape[0] - 1)
        for j in range(n):
            enc = np.round(q[j] / count) * count
            u = min(max(nominal[j, 3] * (sent[at, j] - enc), -1.0), 1.0)
            if k % every == 0:
                rows[k // every, j], rows[k // every, n + j], rows[k // every, 2 * n + j] = sent[at, j], enc, u
            f, wn, zeta = fault[j], 2.0 * np.pi * nominal[j, 1], nominal[j, 2]
            wind[j] = 0.99 * wind[j] + shock[k, j]
            load = -np.cos(q[1]) if j == 1 else 0.0
            share = 1.0 - np.exp(-STEP_S / f[LAG]) if f[LAG] > 0.0 else 1.0
            for _ in range(steps):
                play[j] = min(max(play[j], u - f[HYSTERESIS]), u + f[HYSTERESIS])
                slow[j] += share * (play[j] - slow[j])
                half = xd[j] + 0.5 * STEP_S * (wn * wn * (slow[j] - x[j]) - 2.0 * zeta * wn * xd[j])
                middle = x[j] + 0.5 * STEP_S * xd[j]
                xd[j] += STEP_S * (wn * wn * (slow[j] - middle) - 2.0 * zeta * wn * half)
                x[j] += STEP_S * half
                opening = max(abs(x[j]) - f[DEADBAND], 0.0) / (1.0 - f[DEADBAND]) * (1.0 if x[j] > 0.0 else -1.0)
                droop = max(1.0 + f[DROOP] * load * (1.0 if opening > 0.0 else -1.0), 0.0)
                q[j] += STEP_S * (nominal[j, 0] * (1.0 + f[GAIN]) * opening * droop + wind[j])
    return rows
