"""Compiled closed form of the inverse kinematics: all DH angles that reach a flange pose, in plain loops."""

import numpy as np
from numba import njit

from machine.rotations import Array

FREE = 1e-9  # |sin theta5|, or [m] of the wrist centre from the slew axis, below which an angle may be chosen freely
LIMIT_TOLERANCE_RAD = 1e-9  # an angle this far outside its range still counts as inside: rounding


@njit(cache=True)
def solve_angles(a: Array, d: Array, T_base_flange: Array, theta_near: Array) -> tuple[int, Array]:
    """DH angles of every branch.

    Model:   wrist centre p_w = p - d6 z5; theta1..3 from it (two shoulders, two elbows); then
             Rz(t4) Ry(-t5) Rz(t6) = R_3_flange Rx(-90 deg), two flips.
    Args:    a, d: (6,) [m]. T_base_flange: (4, 4). theta_near: (6,), taken for an angle that is free.
    Returns: number of branches (0, 2, 4 or 8), and an array (8, 6) [rad] whose first rows hold them.
    """
    found = np.empty((8, 6))
    count = 0
    R = T_base_flange
    x, y, z = R[0, 3] - d[5] * R[0, 1], R[1, 3] - d[5] * R[1, 1], R[2, 3] - d[5] * R[2, 1]  # z5 = y_flange
    lateral = d[1] + d[2]
    radius = np.hypot(x, y)
    if radius < abs(lateral) - FREE:
        return 0, found
    side = np.arcsin(min(1.0, max(-1.0, lateral / radius))) if radius > FREE else 0.0
    azimuth = np.arctan2(y, x) if radius > FREE else theta_near[0]
    forearm, bend = np.hypot(a[2], d[3]), np.arctan2(d[3], a[2])
    for shoulder in range(2):
        t1 = azimuth + side if shoulder == 0 else azimuth + np.pi - side
        c1, s1 = np.cos(t1), np.sin(t1)
        u, v = x * c1 + y * s1 - a[0], z - d[0]
        cosine = (u * u + v * v - a[1] * a[1] - forearm * forearm) / (2.0 * a[1] * forearm)
        if abs(cosine) > 1.0 + 1e-12:
            continue
        for elbow in range(2):
            angle = np.arccos(min(1.0, max(-1.0, cosine))) * (1.0 if elbow == 0 else -1.0)
            t2 = np.arctan2(v, u) - np.arctan2(forearm * np.sin(angle), a[1] + forearm * np.cos(angle))
            t3 = bend + angle
            c, s = np.cos(t2 + t3), np.sin(t2 + t3)
            M = np.empty((3, 3))  # R_3_flange Rx(-90 deg); rows x3, y3, z3 in base axes times the flange's columns
            for j in range(3):
                column, sign = (0, 1.0) if j == 0 else ((2, -1.0) if j == 1 else (1, 1.0))
                ahead = c1 * R[0, column] + s1 * R[1, column]
                M[0, j] = sign * (c * ahead + s * R[2, column])
                M[1, j] = sign * (s1 * R[0, column] - c1 * R[1, column])
                M[2, j] = sign * (s * ahead - c * R[2, column])
            for flip in range(2):
                _wrist(M, -1.0 if flip == 0 else 1.0, theta_near[3] + np.pi * flip, found[count])
                found[count, 0], found[count, 1], found[count, 2] = t1, t2, t3
                count += 1
    return count, found


@njit(cache=True)
def _wrist(M: Array, sign: float, theta4_free: float, out: Array) -> None:
    """theta 4..6 of M = Rz(t4) Ry(-t5) Rz(t6); theta6 from what theta4 leaves, so it is sound at theta5 = 0."""
    t4 = np.arctan2(sign * M[1, 2], sign * M[0, 2]) if np.hypot(M[0, 2], M[1, 2]) > FREE else theta4_free
    c4, s4 = np.cos(t4), np.sin(t4)
    out[3] = t4
    out[4] = np.arctan2(-c4 * M[0, 2] - s4 * M[1, 2], M[2, 2])
    out[5] = np.arctan2(c4 * M[1, 0] - s4 * M[0, 0], c4 * M[1, 1] - s4 * M[0, 1])


@njit(cache=True)
def unwrap(q: Array, q_near: Array, q_min: Array, q_max: Array) -> bool:
    """Add whole turns in place: inside the range and nearest q_near, else least outside. Returns: all inside."""
    turn = 2.0 * np.pi
    all_inside = True
    for j in range(q.shape[0]):
        low = np.ceil((q_min[j] - LIMIT_TOLERANCE_RAD - q[j]) / turn)
        high = np.floor((q_max[j] + LIMIT_TOLERANCE_RAD - q[j]) / turn)
        if low <= high:
            q[j] += turn * min(high, max(low, np.rint((q_near[j] - q[j]) / turn)))
        else:
            all_inside = False
            q[j] += turn * np.rint(((q_min[j] + q_max[j]) / 2.0 - q[j]) / turn)
    return all_inside
