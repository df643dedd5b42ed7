"""Joint servos reduced to what decides where a joint stops: P, PT-1, hysteresis, dead band, speed gain, play. Compiled.

No oil, no inertia, no stiction: a joint's speed is its valve opening times its nominal gain. The fine plant is the
reference (`fine_machine.py`); what the two make of the same plans is compared, not assumed.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from machine.description import Machine
from machine.rotations import Array
from sim_plc.plant.hydraulics import play_operator, spool_opening
from sim_plc.plant.truth import PlantTruth

STEP_S = 0.005


class ServoParameters(NamedTuple):
    """Columns (6,) of the joints' loops."""

    kp: Array  # command fraction per rad
    lag_share: Array  # of the way to its input that the PT-1 goes in one step; 1 = none
    hysteresis: Array  # half width, fraction of full command
    dead_band: Array
    gain: Array  # rad/s at full command
    half_play: Array  # rad
    resolution: Array  # rad per encoder count


class ServoState(NamedTuple):
    """Motor angles, PT-1 and hysteresis memories, output angles behind the play; each (6,), changed in place."""

    q: Array
    lagged: Array
    held: Array
    output: Array


def servo_parameters(machine: Machine, truth: PlantTruth) -> ServoParameters:
    """The loops of one drawn machine."""
    joints = machine.joints
    tau = np.array([joint.pt1_tau_s for joint in joints])
    share = np.ones(len(joints))
    share[tau > 0.0] = 1.0 - np.exp(-STEP_S / tau[tau > 0.0])
    return ServoParameters(
        kp=np.array([joint.kp_frac_per_rad for joint in joints]),
        lag_share=share,
        hysteresis=np.asarray(truth.valve.hysteresis_frac, dtype=np.float64),
        dead_band=np.asarray(truth.valve.dead_band_frac, dtype=np.float64),
        gain=np.array([joint.velocity_gain_rad_s for joint in joints]),
        half_play=0.5 * truth.kinematics.backlash_rad,
        resolution=2.0 * np.pi / truth.kinematics.encoder_counts_rev,
    )


def resting_servo(truth: PlantTruth, q_start: Array) -> ServoState:
    """At rest on the start joints, outputs inside their play as drawn."""
    n = len(q_start)
    output = q_start + 0.5 * truth.kinematics.backlash_rad * truth.kinematics.play_start_frac
    return ServoState(np.array(q_start, dtype=np.float64), np.zeros(n), np.zeros(n), output)


@njit(cache=True, nogil=True)
def follow(par: ServoParameters, state: ServoState, q_ref: Array, q_out: Array, output_out: Array) -> None:
    """Follow a reference (m, 6), one row per `STEP_S`; motor and output angles at the end of each step into (m, 6)."""
    for k in range(q_ref.shape[0]):
        for j in range(q_ref.shape[1]):
            seen = np.round(state.q[j] / par.resolution[j]) * par.resolution[j]
            u = par.kp[j] * (q_ref[k, j] - seen)
            state.lagged[j] += par.lag_share[j] * (u - state.lagged[j])
            command = min(max(state.lagged[j], -1.0), 1.0)
            state.held[j] = play_operator(state.held[j], command, par.hysteresis[j])
            state.q[j] += STEP_S * par.gain[j] * spool_opening(state.held[j], par.dead_band[j])
            state.output[j] = play_operator(state.output[j], state.q[j], par.half_play[j])
            q_out[k, j] = state.q[j]
            output_out[k, j] = state.output[j]
