"""Reference shaping: what to ask of a lagging P or PT-1 joint so that the joint itself follows the planned path."""

from dataclasses import dataclass

import numpy as np

from machine.description import Machine
from server.motion.contracts import Array


@dataclass(frozen=True, slots=True)
class ServoLag:
    """Nominal joint loops: qd = gain (q_ref - q) behind a first-order lag tau. Shapes (joints,), [1/s] and [s]."""

    gain: Array
    tau_s: Array


def servo_lag_of(machine: Machine) -> ServoLag:
    """The nominal loops of a machine: gain = kp velocity_gain, tau of the PT-1 joints (eq. 25)."""
    gain = np.array([joint.kp_frac_per_rad * joint.velocity_gain_rad_s for joint in machine.joints])
    return ServoLag(gain=gain, tau_s=np.array([joint.pt1_tau_s for joint in machine.joints]))


def shaped(derivatives: list[Array], lag: ServoLag) -> list[Array]:
    """Reference whose lagging response is the planned path.

    Model:   u = kp (q_ref - q) / (tau s + 1), qd = velocity_gain u  =>  q_ref = q + (qd + tau qdd) / (kp
             velocity_gain).
    Args:    derivatives: planned q and its first four time derivatives, each (n, joints).
    Returns: q_ref and its first two time derivatives, each (n, joints); equal to q wherever the first four vanish.
    Source:  Makinen et al. 2023, eq. 6 and 25, inverted.
    """
    q, q1, q2, q3, q4 = derivatives
    return [
        q + (q1 + lag.tau_s * q2) / lag.gain,
        q1 + (q2 + lag.tau_s * q3) / lag.gain,
        q2 + (q3 + lag.tau_s * q4) / lag.gain,
    ]
