"""The own plant at its finest: chambers, LuGre, flexible links at 0.25 ms, with effects in its valves and oil."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numba import njit

from benchmarks.diagnosis.sealed import faults as f
from benchmarks.diagnosis.sealed import nominal_own as own
from machine.rotations import Array
from sim_plc.draw_plant import draw_plant, nominal_kinematics
from sim_plc.plant import kernel
from sim_plc.plant.aba import aba
from sim_plc.plant.cylinder import interpolate_table
from sim_plc.plant.hydraulics import (
    OIL_VAPOUR_PRESSURE_PA,
    play_operator,
    pump_flow,
    spool_opening,
    spool_step,
    valve_flows,
)
from sim_plc.plant.kernel import lugre_step
from sim_plc.plant.plant import Plant
from sim_plc.plant.statics import gravity_torques
from sim_plc.plant.tree import FLEX_JOINT_INDICES, MOTOR_JOINT_INDICES, N_TREE_JOINTS
from sim_plc.plant.truth import PlantTruth

PLANT_SEED = 7  # the one machine of this benchmark
GRID = 15
RESTICK = 0.2  # of the breakaway command (the effect's definition)
STEPS = 20  # of 0.25 ms in a PLC cycle
FOLLOWS = 20  # PLC cycles, 0.1 s


@cache
def truth() -> PlantTruth:
    """The machine: springs, valves, friction and play drawn, lengths and zeros as in the file."""
    machine = own.six_joints()
    drawn = draw_plant(machine, "realistic", PLANT_SEED)
    play_drawn = drawn.kinematics.backlash_rad * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    return replace(drawn, kinematics=replace(nominal_kinematics(machine), backlash_rad=play_drawn))


@cache
def _loads() -> tuple[Array, Array, Array]:
    """Loads of lift and tilt (2, GRID, GRID), torque over largest torque, and the angles of lift and tilt."""
    machine = own.six_joints()
    tree = Plant(truth(), np.concatenate([own.HOME_RAD, own.WRIST_RAD])).tree
    grids = [np.linspace(j.q_min_rad, j.q_max_rad, GRID) for j in machine.joints[1:3]]
    out, q = np.zeros((2, GRID, GRID)), np.zeros(N_TREE_JOINTS)
    q[MOTOR_JOINT_INDICES[3:]] = own.WRIST_RAD
    for a, lift in enumerate(grids[0]):
        for b, tilt in enumerate(grids[1]):
            q[MOTOR_JOINT_INDICES[1]], q[MOTOR_JOINT_INDICES[2]] = lift, tilt
            out[:, a, b] = gravity_torques(tree, machine.gravity_base_m_s2, q)[MOTOR_JOINT_INDICES[1:3]]
    return out / np.abs(out).max(axis=(1, 2))[:, None, None], grids[0], grids[1]


@njit(cache=True)
def _bilinear(table: Array, x0: float, dx: float, y0: float, dy: float, x: float, y: float) -> float:
    a, b = (x - x0) / dx, (y - y0) / dy
    i = min(max(int(a), 0), table.shape[0] - 2)
    k = min(max(int(b), 0), table.shape[1] - 2)
    a, b = a - i, b - k
    low = (1.0 - a) * table[i, k] + a * table[i + 1, k]
    return (1.0 - b) * low + b * ((1.0 - a) * table[i, k + 1] + a * table[i + 1, k + 1])


@njit(cache=True, error_model="numpy")
def _reading(q: float, encoder: Array, joint: Array) -> float:
    reading = q * (1.0 + encoder[1]) + encoder[0] + encoder[2] * np.sin(encoder[3] * q + encoder[4])
    return reading + joint[f.GEAR] * np.sin(joint[f.GEAR_ORDER] * q)


@njit(cache=True, error_model="numpy")
def _run(
    par,
    state,
    joint: Array,
    flow_limit: float,
    nominal: Array,
    encoder: Array,
    resolution: Array,
    ref: Array,
    u_given: Array,
    near: Array,
    shock: Array,
    loads: Array,
    grid: Array,
    enc_out: Array,
    smooth_out: Array,
    u_out: Array,
    true_out: Array,
    pressure_out: Array,
) -> None:
    """One row a PLC cycle. `u_given` with rows: those commands instead of the controller's (open loop); `near` with
    rows: the joints are set there now and then, and `smooth_out` goes on as if they were not.
    """
    n, oil, shared = joint.shape[0], par.oil_parameters, state.shared_states
    lagged, u, slow, moving = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    load, wind, opened, ahead = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    dt = kernel.INTEGRATION_STEP_S
    cycle = STEPS * dt
    for k in range(ref.shape[0]):
        for j in range(n):
            reading = _reading(state.q[par.motor_joints[j]], encoder[j], joint[j])
            smooth_out[k, j] = reading + ahead[j]
            if near.shape[0] and k % FOLLOWS == FOLLOWS - 1:
                state.q[par.motor_joints[j]] = near[k, j]
                ahead[j] += reading - _reading(near[k, j], encoder[j], joint[j])
            reading = np.round(reading / resolution[j]) * resolution[j]
            tau = nominal[j, 1] * (1.0 + joint[j, f.KP_LAG])
            share = 1.0 - np.exp(-cycle / tau) if tau > 0.0 else 1.0
            wanted = nominal[j, 0] * (1.0 + joint[j, f.KP_GAIN]) * (ref[k, j] - reading)
            lagged[j] += share * (wanted - lagged[j])
            u[j] = min(max(lagged[j], -joint[j, f.U_LIMIT]), joint[j, f.U_LIMIT])
            if u_given.shape[0]:
                u[j] = u_given[k, j]
            enc_out[k, j], u_out[k, j] = reading, u[j]
            pressure_out[k, 2 * j], pressure_out[k, 2 * j + 1] = (
                state.joint_states[j, kernel.P_A],
                state.joint_states[j, kernel.P_B],
            )
            wind[j] = 0.99 * wind[j] + shock[k, j]
        pressure_out[k, 2 * n] = shared[kernel.P_SUPPLY]
        load[1] = _bilinear(
            loads[0], grid[0], grid[1], grid[2], grid[3], state.q[par.motor_joints[1]], state.q[par.motor_joints[2]]
        )
        load[2] = _bilinear(
            loads[1], grid[0], grid[1], grid[2], grid[3], state.q[par.motor_joints[1]], state.q[par.motor_joints[2]]
        )
        for i in range(state.q.shape[0]):
            true_out[k, i] = state.q[i]
        for j in range(par.motor_joints.shape[0]):
            true_out[k, par.motor_joints[j]] = state.joint_states[j, kernel.OUTPUT]
        for _ in range(STEPS):
            p_supply = shared[kernel.P_SUPPLY] + oil[kernel.RIPPLE] * np.sin(
                oil[kernel.RIPPLE_OMEGA] * shared[kernel.TIME] + oil[kernel.RIPPLE_PHASE]
            )
            demand = 0.0
            for j in range(n):
                c, s, w = par.joint_parameters[j], state.joint_states[j], joint[j]
                s[kernel.HELD_COMMAND] = play_operator(
                    s[kernel.HELD_COMMAND], u[j], c[kernel.HYSTERESIS] + w[f.HYSTERESIS]
                )
                share = 1.0 - np.exp(-dt / w[f.LAG]) if w[f.LAG] > 0.0 else 1.0
                slow[j] += share * (s[kernel.HELD_COMMAND] - slow[j])
                s[kernel.SPOOL], s[kernel.SPOOL_RATE] = spool_step(
                    s[kernel.SPOOL], s[kernel.SPOOL_RATE], slow[j], c[kernel.OMEGA], c[kernel.ZETA],
                    min(c[kernel.RATE], w[f.SPOOL_RATE]), dt,
                )  # fmt: skip
                x = s[kernel.SPOOL]
                if moving[j] != 0.0 and (x * moving[j] <= 0.0 or abs(x) <= RESTICK * w[f.BREAKAWAY]):
                    moving[j] = 0.0
                if moving[j] == 0.0 and abs(x) > w[f.BREAKAWAY]:
                    moving[j] = 1.0 if x > 0.0 else -1.0
                o = spool_opening(x, c[kernel.DEAD_BAND] + w[f.DEADBAND]) if moving[j] != 0.0 else 0.0
                o *= (1.0 + w[f.FLOW]) * (1.0 + w[f.WARMING] * shared[kernel.TIME] / 60.0)
                if x > 0.0:
                    o *= 1.0 + w[f.ASYMMETRY]
                    o *= max(1.0 + w[f.DROOP] * load[j], 0.0)
                else:
                    o *= max(1.0 - w[f.DROOP] * load[j], 0.0)
                opened[j] = o
                demand += abs(o)
            served = flow_limit / demand if demand > flow_limit else 1.0
            drawn = 0.0
            for j in range(par.motor_joints.shape[0]):
                i = par.motor_joints[j]
                c, s = par.joint_parameters[j], state.joint_states[j]
                o = opened[j] * served if j < n else 0.0
                y = interpolate_table(par.table_y[j], c[kernel.TABLE_Q0], c[kernel.TABLE_STEP], state.q[i])
                lever = interpolate_table(par.table_lever[j], c[kernel.TABLE_Q0], c[kernel.TABLE_STEP], state.q[i])
                yd = lever * state.qd[i]
                pushed = 0.0  # flow [m or rad a second] past the valve: leak along the load, disturbance
                if j < n:
                    pushed = lever * (joint[j, f.LEAK] * load[j] + wind[j])
                qa, qb, taken = valve_flows(
                    o, c[kernel.FLOW_GAIN], s[kernel.P_A], s[kernel.P_B], p_supply, oil[kernel.P_TANK],
                    oil[kernel.LAMINAR],
                )  # fmt: skip
                drawn += taken
                leak = c[kernel.LEAKAGE] * (s[kernel.P_A] - s[kernel.P_B])
                rate_a = oil[kernel.BULK] / (c[kernel.DEAD_A] + c[kernel.AREA_A] * y)
                rate_b = oil[kernel.BULK] / (c[kernel.DEAD_B] + c[kernel.AREA_B] * (c[kernel.STROKE] - y))
                rate_a *= qa - c[kernel.AREA_A] * (yd - pushed) - leak
                rate_b *= qb + c[kernel.AREA_B] * (yd - pushed) + leak
                s[kernel.P_A] = max(s[kernel.P_A] + dt * rate_a, OIL_VAPOUR_PRESSURE_PA)
                s[kernel.P_B] = max(s[kernel.P_B] + dt * rate_b, OIL_VAPOUR_PRESSURE_PA)
                s[kernel.BRISTLE], friction = lugre_step(
                    s[kernel.BRISTLE], yd, c[kernel.COULOMB], c[kernel.STATIC], c[kernel.VISCOUS], c[kernel.STRIBECK],
                    c[kernel.BRISTLE_K], c[kernel.BRISTLE_D], dt,
                )  # fmt: skip
                torque = lever * (s[kernel.P_A] * c[kernel.AREA_A] - s[kernel.P_B] * c[kernel.AREA_B] - friction)
                if j < n and joint[j, f.TUG] != 0.0:  # a cable that comes tight now and then
                    torque += joint[j, f.TUG] * max(np.sin(0.9 * shared[kernel.TIME]) - 0.3, 0.0)
                state.torque_nm[i] = torque
            for m in range(par.flex_joints.shape[0]):
                i = par.flex_joints[m]
                state.torque_nm[i] = -par.flex_k[m] * state.q[i] - par.flex_c[m] * state.qd[i]
            aba(
                par.tree_R, par.tree_p, par.mass_kg, par.com_m, par.inertia_kg_m2, par.armature_kg_m2, par.gravity_m_s2,
                state.q, state.qd, state.torque_nm, state.aba_workspace, state.qdd,
            )  # fmt: skip
            for i in range(state.q.shape[0]):
                state.qd[i] += dt * state.qdd[i]
                state.q[i] += dt * state.qd[i]
            for j in range(par.motor_joints.shape[0]):
                state.joint_states[j, kernel.OUTPUT] = play_operator(
                    state.joint_states[j, kernel.OUTPUT],
                    state.q[par.motor_joints[j]],
                    par.joint_parameters[j, kernel.HALF_PLAY],
                )
            pumped = pump_flow(shared[kernel.P_SUPPLY], oil[kernel.P_SET], oil[kernel.DROOP], oil[kernel.FLOW_MAX])
            shared[kernel.P_SUPPLY] = max(
                shared[kernel.P_SUPPLY] + dt * (pumped - drawn) / oil[kernel.ACCUMULATOR], oil[kernel.P_TANK]
            )
            shared[kernel.TIME] += dt


@dataclass(frozen=True)
class Course:
    """What happened, one row a PLC cycle: encoders, commands (m, 3), the tree's true angles (m, 11), pressures.

    `smooth`: the encoders before they count: two runs differ there by what an effect does alone, not by single counts.
    """

    enc: Array
    smooth: Array
    u: Array
    tree_q: Array
    pressures: Array


def encoder_rows(faults: f.Faults, n: int) -> Array:
    """Bias, scale, eccentric amplitude, order, phase of each encoder (n, 5)."""
    out = np.zeros((n, 5))
    out[:, 3] = 1.0
    for one in faults.injected:
        if one.joint is None:
            continue
        if one.name == "encoder_bias":
            out[one.joint - 1, 0] = one.size
        elif one.name == "encoder_scale":
            out[one.joint - 1, 1] = one.size
        elif one.name == "encoder_eccentricity":
            out[one.joint - 1, 2:] = one.size, one.values["order"], one.values["phase_rad"]
    return out


def true_at(reading: Array, encoder: Array) -> Array:
    """True angles (3,) behind encoder readings (3,)."""
    q = reading.copy()
    for _ in range(20):
        wave = encoder[:, 2] * np.sin(encoder[:, 3] * q + encoder[:, 4])
        q = (reading - encoder[:, 0] - wave) / (1.0 + encoder[:, 1])
    return q


def run(faults: f.Faults, ref: Array, shock: Array, u_given: Array | None = None, near: Array | None = None) -> Course:
    """Drive the plant from home along the received reference (m, 3) [rad], a row every 5 ms.

    Args: shock: disturbance's innovations (m, 3) [rad/s]. u_given: (m, 3) valve commands for an open-loop run. near:
          angles (m, 3) that an open-loop run is set to every 0.1 s, at its own speeds and pressures: left to itself a
          machine with a fault is a tenth of a radian elsewhere after two minutes, where all joints carry other loads,
          which tells nothing to whoever knows the measured angles. `smooth` goes on as if nothing had been set.
    """
    machine, n = own.six_joints(), own.N
    encoder = encoder_rows(faults, n)
    machine_truth = _changed(truth(), faults)
    plant = Plant(machine_truth, np.concatenate([true_at(ref[0], encoder), own.WRIST_RAD]))
    nominal = np.array([(j.kp_frac_per_rad, j.pt1_tau_s) for j in machine.joints[:n]])
    resolution = 2.0 * np.pi / machine_truth.kinematics.encoder_counts_rev[:n]
    loads, lifts, tilts = _loads()
    grid = np.array([lifts[0], lifts[1] - lifts[0], tilts[0], tilts[1] - tilts[0]])
    m = len(ref)
    out = Course(*(np.zeros((m, columns)) for columns in (n, n, n, N_TREE_JOINTS, 2 * n + 1)))
    given, kept_near = (np.zeros((0, n)) if one is None else np.ascontiguousarray(one) for one in (u_given, near))
    _run(
        plant.parameters,
        plant.state,
        faults.joint,
        faults.flow_limit,
        nominal,
        encoder,
        resolution,
        np.ascontiguousarray(ref),
        given,
        kept_near,
        np.ascontiguousarray(shock),
        loads,
        grid,
        out.enc,
        out.smooth,
        out.u,
        out.tree_q,
        out.pressures,
    )
    return out


def _changed(base: PlantTruth, faults: f.Faults) -> PlantTruth:
    """The plant with its play widened and its load carried."""
    extra = np.zeros(6)
    for one in faults.injected:
        if one.name == "backlash" and one.joint is not None:
            extra[one.joint - 1] += one.size
    kinematics = replace(base.kinematics, backlash_rad=base.kinematics.backlash_rad + extra)
    kg = faults.of("payload_error")
    if kg == 0.0:
        return replace(base, kinematics=kinematics)
    tip = own.six_joints().T_flange_tcp[:3, 3]
    mass, com = base.inertia.mass_kg.copy(), base.inertia.com_m.copy()
    com[5] = (mass[5] * com[5] + kg * tip) / (mass[5] + kg)
    mass[5] += kg
    return replace(base, kinematics=kinematics, inertia=replace(base.inertia, mass_kg=mass, com_m=com))


def springs() -> tuple[Array, Array]:
    """Indices of the motors and springs in the tree."""
    return MOTOR_JOINT_INDICES, FLEX_JOINT_INDICES
