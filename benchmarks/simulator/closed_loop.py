"""The paper's joint controllers closed around the fine plant, compiled: for tuning and tests only."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from machine.rotations import Array
from sim_plc.plant.kernel import OUTPUT, Parameters, State, advance
from sim_plc.plant.plant import Plant
from sim_plc.plant.statics import frames


@dataclass(frozen=True, slots=True)
class Gains:
    """Proportional gain (6,) [command fraction per rad] and PT-1 constant (6,) [s], 0 = none."""

    kp: Array
    tau: Array


@dataclass(frozen=True, slots=True)
class LoopRun:
    """One closed-loop run, sampled every millisecond: encoder angles, valve commands, true tip positions in base."""

    t_s: Array
    q_ref: Array  # (n, 6)
    q: Array  # (n, 6)
    u: Array  # (n, 6)
    p_base_tcp: Array  # (n, 3); every 10 ms


@njit(cache=True, error_model="numpy")
def _run(
    par: Parameters, state: State, kp: Array, tau: Array, resolution: Array, q_ref: Array, q_out: Array, u_out: Array,
    angles_out: Array,
) -> None:  # fmt: skip
    lagged = np.zeros(6)
    command = np.zeros(6)
    for n in range(q_ref.shape[0]):
        for j in range(6):
            q = np.round(state.q[par.motor_joints[j]] / resolution[j]) * resolution[j]
            q_out[n, j] = q
            u = kp[j] * (q_ref[n, j] - q)
            if tau[j] > 0.0:
                lagged[j] += 1e-3 / (tau[j] + 1e-3) * (u - lagged[j])
                u = lagged[j]
            u_out[n, j] = min(max(u, -1.0), 1.0)
        for i in range(state.q.shape[0]):
            angles_out[n, i] = state.q[i]
        for j in range(6):
            angles_out[n, par.motor_joints[j]] = state.joint_states[j, OUTPUT]
        advance(par, state, command, 1)  # what was computed in the last cycle: one cycle of delay
        command[:] = u_out[n]


def run_closed_loop(plant: Plant, gains: Gains, q_ref: Array) -> LoopRun:
    """Run the plant under P and PT-1 control along a reference (n, 6) [rad], one row per millisecond.

    Model:   u = kp (q_ref - q), then 1 / (tau s + 1), clipped to -1..1, zero-order hold 1 ms, applied one cycle later.
    """
    n = len(q_ref)
    q, u, angles = np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, kernel_joints(plant)))
    resolution = 2.0 * np.pi / plant.truth.kinematics.encoder_counts_rev
    _run(plant.parameters, plant.state, gains.kp, gains.tau, resolution, np.ascontiguousarray(q_ref), q, u, angles)
    tips = np.zeros((len(range(0, n, 10)), 3))
    for row, index in enumerate(range(0, n, 10)):
        R, p = frames(plant.tree, angles[index])
        tips[row] = R[-1] @ plant.tree.T_last_tcp[:3, 3] + p[-1]
    return LoopRun(np.linspace(0.0, (n - 1) * 1e-3, n), q_ref, q, u, tips)


def kernel_joints(plant: Plant) -> int:
    """Number of joints of the plant's tree, flexible ones included."""
    return plant.state.q.shape[0]
