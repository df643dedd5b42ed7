"""The third plant's motion: link, controller, valve and joint of the contract, with every dynamic effect in its place.

received reference -> P or PT-1 controller -> clip -> hysteresis -> lag -> second-order spool -> stiction -> dead band
-> flow gain, asymmetry, load -> pump -> leakage -> true joint -> encoder; true joint -> backlash, flexibility -> link
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from benchmarks.diagnosis.sealed.third_arm import Arm, Array, arm_of, reference_torques, torques_at

COLUMNS = 31
# Columns of the per-joint table; NEUTRAL where the neutral value is not 0
(
    GAIN, LAG, LIMIT, DEAD_BAND, HYSTERESIS, VALVE_LAG, ASYMMETRY, FLOW, DROOP, LEAK, BREAKAWAY, BACKLASH,
    BIAS, SCALE, WAVE, WAVE_ORDER, WAVE_PHASE, FLEX_GAIN, FLEX_HZ, FLEX_DAMPING, REF_STEP, REF_RATE, LAPPED,
    SPOOL_RATE, WARM, WARM_S, GEAR, GEAR_ORDER, TUG, TUG_FROM, TUG_SIDE,
) = range(COLUMNS)  # fmt: skip
NEUTRAL = {LIMIT: 1.0, REF_RATE: np.inf, SPOOL_RATE: np.inf, WARM_S: 1.0, TUG_SIDE: 1.0, FLEX_HZ: 1.0}
COLUMN = {
    ("controller_gain_error", "gain_frac"): GAIN,
    ("controller_lag_error", "lag_frac"): LAG,
    ("controller_saturation", "limit_frac"): LIMIT,
    ("valve_deadband", "half_width_frac"): DEAD_BAND,
    ("valve_hysteresis", "half_width_frac"): HYSTERESIS,
    ("valve_lag", "time_constant_s"): VALVE_LAG,
    ("valve_asymmetry", "gain_frac"): ASYMMETRY,
    ("flow_gain_error", "gain_frac"): FLOW,
    ("load_droop", "droop_frac"): DROOP,
    ("internal_leakage", "drift_rad_s"): LEAK,
    ("stiction", "breakaway_frac"): BREAKAWAY,
    ("backlash", "width_rad"): BACKLASH,
    ("encoder_bias", "bias_rad"): BIAS,
    ("encoder_scale", "scale_frac"): SCALE,
    ("encoder_eccentricity", "amplitude_rad"): WAVE,
    ("encoder_eccentricity", "order"): WAVE_ORDER,
    ("encoder_eccentricity", "phase_rad"): WAVE_PHASE,
    ("link_flexibility", "gain"): FLEX_GAIN,
    ("link_flexibility", "frequency_hz"): FLEX_HZ,
    ("link_flexibility", "damping"): FLEX_DAMPING,
    ("reference_quantisation", "step_rad"): REF_STEP,
    ("reference_rate_limit", "rate_rad_s"): REF_RATE,
    ("valve_deadband", "in_band_frac"): LAPPED,  # a detail: flow per command inside the band, of that outside
    ("spool_rate_limit", "rate_frac_s"): SPOOL_RATE,  # from here on not of the catalogue
    ("thermal_gain_drift", "gain_frac"): WARM,
    ("thermal_gain_drift", "time_constant_s"): WARM_S,
    ("gear_eccentricity", "amplitude_rad"): GEAR,
    ("gear_eccentricity", "order"): GEAR_ORDER,
    ("cable_tug", "speed_rad_s"): TUG,
    ("cable_tug", "from_rad"): TUG_FROM,
    ("cable_tug", "side"): TUG_SIDE,
}
STICKS_AGAIN = 0.2  # of the breakaway command
STEP_S = 0.001
DISTURBANCE_MEMORY = 0.98  # of the speed disturbance, from PLC cycle to PLC cycle


@dataclass(frozen=True)
class Motion:
    """One row a PLC cycle: sequence received (m,), reference, encoder, valve command, true and link angle (m, n)."""

    seq: Array
    ref: Array
    encoder: Array
    u: Array
    true: Array
    link: Array


@dataclass(frozen=True)
class Drive:
    """What moves the joints: nominal numbers (n, 5), effects (n, columns), pump, delay, loss, encoders,
    the nominal arm with its payload, whose torques load the joints."""

    nominal: Array
    table: Array
    flow_limit: float
    delay_s: float
    loss_frac: float
    resolution: Array
    arm: Arm
    reference_torque: Array
    cycle_s: float


def drive_of(machine: dict[str, Any], effects: list[dict[str, Any]]) -> Drive:
    """The drive of a machine file (as parsed) with the dynamic effects of a list of entries."""
    joints, plc = machine["joint"], machine["plc"]
    n = len(joints)
    table = np.zeros((n, COLUMNS))
    for column, value in NEUTRAL.items():
        table[:, column] = value
    flow_limit, delay, loss = np.inf, plc["transport_delay_s"], 0.0
    for effect in effects:
        name, values = effect["name"], effect["parameters"]
        flow_limit = min(flow_limit, values.get("flow_limit_frac", np.inf))
        delay += values["delay_s"] if name == "transport_delay" else 0.0
        loss += values["loss_frac"] if name == "packet_loss" else 0.0
        for parameter, value in (values | effect.get("detail", {})).items():
            if (name, parameter) in COLUMN:
                table[effect["joint"] - 1, COLUMN[name, parameter]] = value
    nominal = np.array(
        [
            (
                j["kp_frac_per_rad"],
                j["pt1_tau_s"],
                j["velocity_gain_rad_s"],
                j["valve_frequency_hz"],
                j["valve_damping"],
            )
            for j in joints
        ]
    )
    nominal[:, 3] *= 2.0 * np.pi
    low, high = (np.deg2rad([j[key] for j in joints]) for key in ("q_min_deg", "q_max_deg"))
    resolution = 2.0 * np.pi / np.array([j["encoder_counts_rev"] for j in joints], dtype=float)
    torque = reference_torques(arm_of(machine, []), low, high)
    loaded = arm_of(machine, [effect for effect in effects if effect["name"] == "payload_error"])
    return Drive(nominal, table, flow_limit, delay, loss, resolution, loaded, torque, plc["cycle_s"])


def run(drive: Drive, sent: Array, noise: Array, rng: np.random.Generator) -> Motion:
    """Drive the joints along the sent reference (m, n), one row a PLC cycle; noise (m, n): innovations of the speed."""
    m, n = sent.shape
    arrived = rng.uniform(size=m) >= drive.loss_frac
    arrived[0] = True
    held = np.maximum.accumulate(np.where(arrived, np.arange(m), 0))
    late = int(np.ceil(drive.delay_s / drive.cycle_s - 1e-9))
    seq = held[np.maximum(np.arange(m) - late, 0)]
    ref = _limited(sent[seq], drive.table, drive.cycle_s)
    out = Motion(seq, ref, *(np.zeros((m, n)) for _ in range(4)))
    start = true_angles(ref[0], drive.table)
    _run(
        drive.nominal, drive.table, drive.flow_limit, drive.resolution, drive.cycle_s, drive.reference_torque,
        drive.arm.packed(), ref, start, noise, out.encoder, out.u, out.true, out.link,
    )  # fmt: skip
    return out


def _limited(ref: Array, table: Array, cycle_s: float) -> Array:
    """The received reference in whole steps, then at its largest speed."""
    out = ref.copy()
    for j in range(ref.shape[1]):
        if table[j, REF_STEP] > 0.0:
            out[:, j] = np.round(out[:, j] / table[j, REF_STEP]) * table[j, REF_STEP]
        most = table[j, REF_RATE] * cycle_s
        if np.isfinite(most):
            for k in range(1, len(out)):
                out[k, j] = out[k - 1, j] + np.clip(out[k, j] - out[k - 1, j], -most, most)
    return out


def encoder_angles(true: Array, table: Array) -> Array:
    """Encoder readings (..., n) of true angles, before counting."""
    wave = table[:, WAVE] * np.sin(table[:, WAVE_ORDER] * true + table[:, WAVE_PHASE])
    return true * (1.0 + table[:, SCALE]) + table[:, BIAS] + wave + table[:, GEAR] * np.sin(table[:, GEAR_ORDER] * true)


def true_angles(reading: Array, table: Array) -> Array:
    """True angles (..., n) behind encoder readings; the fixed point converges as the waves are shallow."""
    true = reading.copy()
    for _ in range(60):
        true = true + reading - encoder_angles(true, table)
    return true


@njit(cache=True, error_model="numpy")
def _reading(q, w):
    reading = q * (1.0 + w[SCALE]) + w[BIAS] + w[WAVE] * np.sin(w[WAVE_ORDER] * q + w[WAVE_PHASE])
    return reading + w[GEAR] * np.sin(w[GEAR_ORDER] * q)


@njit(cache=True, error_model="numpy")
def _run(
    nominal, table, flow_limit, resolution, cycle_s, reference, arm, ref, start, noise, encoder, u_out, true, link
):
    m, n = ref.shape
    q, x, xd, slow, held, lagged = start.copy(), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    moving, speed, wind, load, u = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    behind, behind_rate, bend, bend_rate = start.copy(), np.zeros(n), np.zeros(n), np.zeros(n)
    steps = int(np.round(cycle_s / STEP_S))
    dt = cycle_s / steps
    at = np.zeros((1, n))
    loaded = np.any(table[:, DROOP] != 0.0) or np.any(table[:, LEAK] != 0.0)
    for k in range(m):
        if loaded:
            at[0] = q
            torque = torques_at(at, *arm)[0]
            for j in range(n):
                load[j] = torque[j] / reference[j] if reference[j] > 0.0 else 0.0
        for j in range(n):
            w = table[j]
            reading = np.round(_reading(q[j], w) / resolution[j]) * resolution[j]
            tau = nominal[j, 1] * (1.0 + w[LAG])
            share = 1.0 - np.exp(-cycle_s / tau) if tau > 0.0 else 1.0
            lagged[j] += share * (nominal[j, 0] * (1.0 + w[GAIN]) * (ref[k, j] - reading) - lagged[j])
            u[j] = min(max(lagged[j], -w[LIMIT]), w[LIMIT])
            encoder[k, j], u_out[k, j], true[k, j], link[k, j] = reading, u[j], q[j], behind[j] + bend[j]
            wind[j] = DISTURBANCE_MEMORY * wind[j] + noise[k, j]
        for i in range(steps):
            time = k * cycle_s + i * dt
            demand = 0.0
            for j in range(n):
                w = table[j]
                held[j] = min(max(held[j], u[j] - w[HYSTERESIS]), u[j] + w[HYSTERESIS])
                share = 1.0 - np.exp(-dt / w[VALVE_LAG]) if w[VALVE_LAG] > 0.0 else 1.0
                slow[j] += share * (held[j] - slow[j])
                omega = nominal[j, 3]
                xd[j] += dt * (omega * omega * (slow[j] - x[j]) - 2.0 * nominal[j, 4] * omega * xd[j])
                xd[j] = min(max(xd[j], -w[SPOOL_RATE]), w[SPOOL_RATE])
                x[j] += dt * xd[j]
                if moving[j] != 0.0 and (x[j] * moving[j] <= 0.0 or abs(x[j]) <= STICKS_AGAIN * w[BREAKAWAY]):
                    moving[j] = 0.0
                if moving[j] == 0.0 and abs(x[j]) > w[BREAKAWAY]:
                    moving[j] = np.sign(x[j])
                within = min(abs(x[j]), w[DEAD_BAND])
                open_by = (abs(x[j]) - within + w[LAPPED] * within) * np.sign(x[j]) if moving[j] != 0.0 else 0.0
                flow = open_by * (1.0 + w[FLOW]) * (1.0 + w[WARM] * (1.0 - np.exp(-time / w[WARM_S])))
                if open_by > 0.0:
                    flow *= 1.0 + w[ASYMMETRY]
                flow *= max(1.0 + w[DROOP] * load[j] * np.sign(open_by), 0.0)
                speed[j] = nominal[j, 2] * flow
                demand += abs(flow)
            served = flow_limit / demand if demand > flow_limit else 1.0
            for j in range(n):
                w = table[j]
                qd = speed[j] * served + w[LEAK] * load[j] + wind[j]
                if w[TUG] != 0.0 and (q[j] - w[TUG_FROM]) * w[TUG_SIDE] > 0.0:
                    qd -= w[TUG] * w[TUG_SIDE] * min((q[j] - w[TUG_FROM]) * w[TUG_SIDE] / 0.02, 1.0)
                q[j] += dt * qd
                old = behind[j]
                half = 0.5 * w[BACKLASH]
                behind[j] = min(max(old, q[j] - half), q[j] + half)
                if w[FLEX_GAIN] != 0.0:
                    rate = (behind[j] - old) / dt
                    omega = 2.0 * np.pi * w[FLEX_HZ]
                    pull = -w[FLEX_GAIN] * (rate - behind_rate[j]) / dt
                    bend_rate[j] += dt * (pull - 2.0 * w[FLEX_DAMPING] * omega * bend_rate[j] - omega**2 * bend[j])
                    bend[j] += dt * bend_rate[j]
                    behind_rate[j] = rate
