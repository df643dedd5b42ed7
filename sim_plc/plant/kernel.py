"""The plant's inner loop: one millisecond in four steps of oil, friction, structure and multibody, compiled."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.rotations import Array
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

SUBSTEPS = 4
INTEGRATION_STEP_S = 1e-3 / SUBSTEPS
STOP_STIFFNESS_NM_RAD = 2e6  # end stops [A]: a 10 kN m push goes 0.3 deg in
STOP_DAMPING_NM_S_RAD = 2e4

# Columns of `Parameters.joint_parameters`, one row per motor joint
(
    OMEGA, ZETA, RATE, DEAD_BAND, HYSTERESIS, FLOW_GAIN,
    AREA_A, AREA_B, DEAD_A, DEAD_B, STROKE, LEAKAGE,
    COULOMB, STATIC, VISCOUS, STRIBECK, BRISTLE_K, BRISTLE_D,
    STOP_LOW, STOP_HIGH, HALF_PLAY, TABLE_Q0, TABLE_STEP, GAIN,
) = range(24)  # fmt: skip
# Entries of `Parameters.oil_parameters`
BULK, LAMINAR, P_SET, P_TANK, RIPPLE, RIPPLE_OMEGA, RIPPLE_PHASE, FLOW_MAX, DROOP, ACCUMULATOR = range(10)
# Columns of `State.joint_states`
SPOOL, SPOOL_RATE, HELD_COMMAND, P_A, P_B, BRISTLE, OUTPUT = range(7)
# Entries of `State.shared_states`
P_SUPPLY, TIME = range(2)


# LuGre friction: bristles that hold at rest, slip at the breakaway force, and weaken with speed (Stribeck).


@njit(cache=True, error_model="numpy")
def lugre_step(
    z: float,
    v: float,
    coulomb: float,
    static: float,
    viscous: float,
    stribeck: float,
    stiffness: float,
    damping: float,
    dt: float,
) -> tuple[float, float]:
    """New bristle deflection and friction force.

    Model:   z' = v - s0 |v| z / G(v), G = Fc + (Fs - Fc) exp(-(v/vs)^2), F = s0 z + s1(v) z' + s2 v. The decay of z is
             implicit (stable at any speed); s1 fades with speed as G does, so that bristles damp while they stick.
    Args:    z: deflection [m or rad]. v: speed. coulomb, static: Fc, Fs. viscous: s2. stribeck: vs. stiffness: s0.
             damping: s1.
    Returns: z after dt, force against the motion.
    Source:  Canudas de Wit 1995, eqs 1-3.
    """
    if stiffness <= 0.0:
        return 0.0, viscous * v
    fading = np.exp(-((v / stribeck) ** 2))
    level = coulomb + (static - coulomb) * fading
    z_new = (z + dt * v) / (1.0 + dt * stiffness * abs(v) / level)
    rate = (z_new - z) / dt
    return z_new, stiffness * z_new + damping * fading * rate + viscous * v


class Parameters(NamedTuple):
    """Everything constant, as arrays the compiled loop can take."""

    tree_R: Array
    tree_p: Array
    mass_kg: Array
    com_m: Array
    inertia_kg_m2: Array
    armature_kg_m2: Array
    gravity_m_s2: Array
    motor_joints: NDArray[np.int64]
    flex_joints: NDArray[np.int64]
    flex_k: Array
    flex_c: Array
    joint_parameters: Array  # (6, 24)
    table_y: Array
    table_lever: Array
    oil_parameters: Array


class State(NamedTuple):
    """Everything that changes, changed in place."""

    q: Array  # (11,)
    qd: Array
    joint_states: Array  # (6, 7)
    shared_states: Array
    torque_nm: Array  # scratch
    qdd: Array
    aba_workspace: Array


@njit(cache=True, error_model="numpy")
def _actuator_step(j: int, q: float, qd: float, u: float, p_supply: float, par: Parameters, state: State) -> float:
    """Step valve, chambers and friction of joint j: torque into state.torque_nm, returns its flow out of the supply."""
    c, s = par.joint_parameters[j], state.joint_states[j]
    s[HELD_COMMAND] = play_operator(s[HELD_COMMAND], u, c[HYSTERESIS])
    s[SPOOL], s[SPOOL_RATE] = spool_step(
        s[SPOOL], s[SPOOL_RATE], s[HELD_COMMAND], c[OMEGA], c[ZETA], c[RATE], INTEGRATION_STEP_S
    )
    y = interpolate_table(par.table_y[j], c[TABLE_Q0], c[TABLE_STEP], q)
    lever = interpolate_table(par.table_lever[j], c[TABLE_Q0], c[TABLE_STEP], q)
    yd = lever * qd
    flow_a, flow_b, drawn = valve_flows(
        spool_opening(s[SPOOL], c[DEAD_BAND]),
        c[FLOW_GAIN],
        s[P_A],
        s[P_B],
        p_supply,
        par.oil_parameters[P_TANK],
        par.oil_parameters[LAMINAR],
    )
    leak = c[LEAKAGE] * (s[P_A] - s[P_B])
    rate_a = par.oil_parameters[BULK] / (c[DEAD_A] + c[AREA_A] * y) * (flow_a - c[AREA_A] * yd - leak)
    rate_b = par.oil_parameters[BULK] / (c[DEAD_B] + c[AREA_B] * (c[STROKE] - y)) * (flow_b + c[AREA_B] * yd + leak)
    s[P_A] = max(s[P_A] + INTEGRATION_STEP_S * rate_a, OIL_VAPOUR_PRESSURE_PA)
    s[P_B] = max(s[P_B] + INTEGRATION_STEP_S * rate_b, OIL_VAPOUR_PRESSURE_PA)
    s[BRISTLE], friction = lugre_step(
        s[BRISTLE], yd, c[COULOMB], c[STATIC], c[VISCOUS], c[STRIBECK], c[BRISTLE_K], c[BRISTLE_D], INTEGRATION_STEP_S
    )
    torque = lever * (s[P_A] * c[AREA_A] - s[P_B] * c[AREA_B] - friction)
    if q < c[STOP_LOW]:
        torque += STOP_STIFFNESS_NM_RAD * (c[STOP_LOW] - q) - STOP_DAMPING_NM_S_RAD * min(qd, 0.0)
    elif q > c[STOP_HIGH]:
        torque += STOP_STIFFNESS_NM_RAD * (c[STOP_HIGH] - q) - STOP_DAMPING_NM_S_RAD * max(qd, 0.0)
    state.torque_nm[par.motor_joints[j]] = torque
    return drawn


@njit(cache=True, error_model="numpy")
def advance(par: Parameters, state: State, command: Array, n_ms: int) -> None:
    """Advance the fine plant by n_ms with the valve commands held.

    Args:    command: (6,) fraction of full command; clipped to -1..1.
    """
    oil, shared, q, qd = par.oil_parameters, state.shared_states, state.q, state.qd
    for _ in range(n_ms * SUBSTEPS):
        ripple = oil[RIPPLE] * np.sin(oil[RIPPLE_OMEGA] * shared[TIME] + oil[RIPPLE_PHASE])
        p_supply = shared[P_SUPPLY] + ripple
        drawn = 0.0
        for j in range(par.motor_joints.shape[0]):
            i = int(par.motor_joints[j])
            u = min(max(command[j], -1.0), 1.0)
            drawn += _actuator_step(j, q[i], qd[i], u, p_supply, par, state)
        for k in range(par.flex_joints.shape[0]):
            i = par.flex_joints[k]
            state.torque_nm[i] = -par.flex_k[k] * q[i] - par.flex_c[k] * qd[i]
        aba(
            par.tree_R, par.tree_p, par.mass_kg, par.com_m, par.inertia_kg_m2, par.armature_kg_m2, par.gravity_m_s2,
            q, qd, state.torque_nm, state.aba_workspace, state.qdd,
        )  # fmt: skip
        for i in range(q.shape[0]):
            qd[i] += INTEGRATION_STEP_S * state.qdd[i]
            q[i] += INTEGRATION_STEP_S * qd[i]
        for j in range(par.motor_joints.shape[0]):
            state.joint_states[j, OUTPUT] = play_operator(
                state.joint_states[j, OUTPUT], q[int(par.motor_joints[j])], par.joint_parameters[j, HALF_PLAY]
            )
        pumped = pump_flow(shared[P_SUPPLY], oil[P_SET], oil[DROOP], oil[FLOW_MAX])
        shared[P_SUPPLY] = max(shared[P_SUPPLY] + INTEGRATION_STEP_S * (pumped - drawn) / oil[ACCUMULATOR], oil[P_TANK])
        shared[TIME] += INTEGRATION_STEP_S


@njit(cache=True, error_model="numpy")
def advance_rigid(par: Parameters, state: State, command: Array, n_ms: int) -> None:
    """Advance the rigid plant, the nominal model: qd = velocity gain * x, x'' = wn^2 (u - x) - 2 z wn x'. Play, if a
    machine file gives any, lies behind it.
    """
    for _ in range(n_ms * SUBSTEPS):
        for j in range(par.motor_joints.shape[0]):
            c, s, i = par.joint_parameters[j], state.joint_states[j], par.motor_joints[j]
            u = min(max(command[j], -1.0), 1.0)
            s[SPOOL_RATE] += INTEGRATION_STEP_S * (
                c[OMEGA] ** 2 * (u - s[SPOOL]) - 2.0 * c[ZETA] * c[OMEGA] * s[SPOOL_RATE]
            )
            s[SPOOL] += INTEGRATION_STEP_S * s[SPOOL_RATE]
            state.qd[i] = c[GAIN] * s[SPOOL]
            state.q[i] = min(max(state.q[i] + INTEGRATION_STEP_S * state.qd[i], c[STOP_LOW]), c[STOP_HIGH])
            s[OUTPUT] = play_operator(s[OUTPUT], state.q[int(i)], c[HALF_PLAY])
        state.shared_states[TIME] += INTEGRATION_STEP_S
