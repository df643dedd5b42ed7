"""A trajectory that goes back and forth for as long as wanted, so that the PLC stays in RUN."""

import numpy as np

from machine.description import Machine
from server.motion.contracts import Array, JointTrajectory

KNOT_S = 0.05
LEG_S = 3.0
SPEED_SHARE = 0.3  # of each joint's speed limit, in the middle of a leg
_PEAK = 1.875  # of the quintic from rest to rest, times distance / duration
_ROOM_SHARE = 0.4  # of the way to the farther end of a joint's range


def back_and_forth(machine: Machine, q_start: Array, seconds: float) -> JointTrajectory:
    """Legs of 3 s from the start and back to it, all joints at once, as one trajectory; an even number of legs.

    Model:   q = q_start + a s(u) on the way there, s(u) = 10 u^3 - 15 u^4 + 6 u^5; mirrored on the way back.
    """
    q_min, q_max = (np.array([getattr(joint, name) for joint in machine.joints]) for name in ("q_min_rad", "q_max_rad"))
    qd_max = np.array([joint.qd_max_rad_s for joint in machine.joints])
    up = q_max - q_start >= q_start - q_min
    room = np.where(up, q_max - q_start, q_start - q_min)
    reach = np.minimum(SPEED_SHARE * qd_max * LEG_S / _PEAK, _ROOM_SHARE * room) * np.where(up, 1.0, -1.0)
    pairs = max(1, round(seconds / (2.0 * LEG_S)))
    per_leg = round(LEG_S / KNOT_S)
    u = np.arange(per_leg) / per_leg
    s = 10 * u**3 - 15 * u**4 + 6 * u**5
    sd = (30 * u**2 - 60 * u**3 + 30 * u**4) / LEG_S
    sdd = (60 * u - 180 * u**2 + 120 * u**3) / LEG_S**2
    there_and_back = [np.concatenate((s, 1.0 - s)), np.concatenate((sd, -sd)), np.concatenate((sdd, -sdd))]
    q, qd, qdd = (np.append(np.tile(part, pairs), 0.0)[:, None] * reach for part in there_and_back)
    return JointTrajectory(KNOT_S * np.arange(len(q), dtype=np.float64), q_start + q, qd, qdd)
