"""The walk through the simulator's cycles along a recording, compiled: encoders, controller, command, plant."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.rotations import Array
from sim_plc.plant.backlash import play
from sim_plc.plant.hydraulics import opening
from sim_plc.plant.kernel import OUTPUT, Parameters, State, advance_rigid
from sim_plc.plc.joint_control import valve_commands


class Side(NamedTuple):
    """What acts between the controller and the spool, (n,) each: see `sim_plc.command_side`."""

    kp: Array
    pt1_share: Array
    limit: Array
    hysteresis: Array
    lag_share: Array
    dead: Array
    full_flow: Array
    forward_gain: Array
    resolution: Array


@njit(cache=True, error_model="numpy")
def run_cycles(
    par: Parameters,
    state: State,
    side: Side,
    closed: bool,
    given: Array,
    rows: NDArray[np.int64],
    q_out: Array,
    u_out: Array,
    angles_out: Array,
) -> None:
    """Cycles of 1 ms of the rigid plant. `given` (cycles, n): references if `closed`, else commands.

    What stands at `rows` is noted. `angles_out`: (rows, joints of the tree), motors behind their play.
    """
    n = given.shape[1]
    q, u, lagged, command = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    held, slow = np.zeros(n), np.zeros(n)
    if not closed:
        held[:] = given[0]
        slow[:] = given[0]
    at = 0
    for k in range(given.shape[0]):
        for j in range(n):
            q[j] = np.round(state.q[par.motors[j]] / side.resolution[j]) * side.resolution[j]
        if closed:
            valve_commands(given[k], q, side.kp, side.pt1_share, 1.0, lagged, u)
        else:
            u[:] = given[k]
        while at < rows.shape[0] and rows[at] == k:
            q_out[at] = q
            u_out[at] = u
            angles_out[at] = state.q
            for j in range(n):
                angles_out[at, par.motors[j]] = state.joint[j, OUTPUT]
            at += 1
        for j in range(n):
            held[j] = play(held[j], min(max(u[j], -side.limit[j]), side.limit[j]), side.hysteresis[j])
            slow[j] += side.lag_share[j] * (held[j] - slow[j])
            opened = opening(slow[j], side.dead[j]) * side.full_flow[j]
            command[j] = opened * side.forward_gain[j] if opened > 0.0 else opened
        advance_rigid(par, state, command, 1)
