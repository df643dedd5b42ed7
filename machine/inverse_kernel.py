"""Compiled closed form of the inverse kinematics: all DH angles that reach a flange pose, in plain loops."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.rotations import Array

FREE = 1e-9  # |sin theta5|, or [m] of the wrist centre from the slew axis, below which an angle may be chosen freely
LIMIT_TOLERANCE_RAD = 1e-9  # an angle this far outside its range still counts as inside: rounding


@njit(cache=True)
def solve_angles(a: Array, d: Array, T_base_flange: Array, theta_near: Array) -> tuple[int, Array]:
    """DH angles of every branch.

    Model:   wrist centre p_w = p - d6 z5 (z5 = y_flange); theta1..3 from it (two shoulders, two elbows); then
             Rz(t4) Ry(-t5) Rz(t6) = R_3_flange Rx(-90 deg), two flips.
    Args:    a, d: (6,) [m]. T_base_flange: (4, 4). theta_near: (6,) [rad], taken for an angle that is free.
    Returns: number of branches (0, 4 or 8), and an array (8, 6) [rad] whose first rows hold them.
    """
    found = np.empty((8, 6))
    p_wrist = T_base_flange[:3, 3] - d[5] * T_base_flange[:3, 1]
    n_arms, arms = _arm_angles(a, d, p_wrist, theta_near[0])
    for k in range(2 * n_arms):
        found[k, :3] = arms[k // 2]
        M = _wrist_rotation(arms[k // 2], T_base_flange)
        if k % 2 == 0:
            _wrist_angles(M, -1.0, theta_near[3], found[k])
        else:
            _wrist_angles(M, 1.0, theta_near[3] + np.pi, found[k])
    return 2 * n_arms, found


@njit(cache=True)
def _arm_angles(a: Array, d: Array, p_wrist: Array, theta1_free: float) -> tuple[int, Array]:
    """theta 1..3 that put the wrist centre at p_wrist: how many (0, 2 or 4), and an array (4, 3)."""
    arms = np.empty((4, 3))
    count = 0
    x, y, z = p_wrist
    lateral, radius = d[1] + d[2], np.hypot(x, y)
    if radius < abs(lateral) - FREE:
        return 0, arms
    side = np.arcsin(min(1.0, max(-1.0, lateral / radius))) if radius > FREE else 0.0
    azimuth = np.arctan2(y, x) if radius > FREE else theta1_free
    forearm, bend = np.hypot(a[2], d[3]), np.arctan2(d[3], a[2])
    for shoulder in range(2):
        theta1 = azimuth + side if shoulder == 0 else azimuth + np.pi - side
        u, v = x * np.cos(theta1) + y * np.sin(theta1) - a[0], z - d[0]
        cosine = (u * u + v * v - a[1] * a[1] - forearm * forearm) / (2.0 * a[1] * forearm)
        if abs(cosine) > 1.0 + 1e-12:
            continue
        for sign in (1.0, -1.0):
            elbow = sign * np.arccos(min(1.0, max(-1.0, cosine)))
            ahead, above = a[1] + forearm * np.cos(elbow), forearm * np.sin(elbow)
            arms[count, 0] = theta1
            arms[count, 1] = np.arctan2(v, u) - np.arctan2(above, ahead)
            arms[count, 2] = bend + elbow
            count += 1
    return count, arms


@njit(cache=True)
def _wrist_rotation(arm: Array, R: Array) -> Array:
    """R_3_flange Rx(-90 deg): rows are x3, y3, z3 in base axes, columns the flange's x, -z and y."""
    c1, s1 = np.cos(arm[0]), np.sin(arm[0])
    c, s = np.cos(arm[1] + arm[2]), np.sin(arm[1] + arm[2])
    M = np.empty((3, 3))
    for j in range(3):
        column = 0 if j == 0 else 3 - j
        sign = -1.0 if j == 1 else 1.0
        ahead = c1 * R[0, column] + s1 * R[1, column]
        M[0, j] = sign * (c * ahead + s * R[2, column])
        M[1, j] = sign * (s1 * R[0, column] - c1 * R[1, column])
        M[2, j] = sign * (s * ahead - c * R[2, column])
    return M


@njit(cache=True)
def _wrist_angles(M: Array, sign: float, theta4_free: float, out: Array) -> None:
    """theta 4..6 of M = Rz(t4) Ry(-t5) Rz(t6); theta6 from what theta4 leaves, so it is sound at theta5 = 0."""
    t4 = np.arctan2(sign * M[1, 2], sign * M[0, 2]) if np.hypot(M[0, 2], M[1, 2]) > FREE else theta4_free
    c4, s4 = np.cos(t4), np.sin(t4)
    out[3] = t4
    out[4] = np.arctan2(-c4 * M[0, 2] - s4 * M[1, 2], M[2, 2])
    out[5] = np.arctan2(c4 * M[1, 0] - s4 * M[0, 0], c4 * M[1, 1] - s4 * M[0, 1])


@njit(cache=True)
def unwrap(qs: Array, q_near: Array, q_min: Array, q_max: Array) -> NDArray[np.bool_]:
    """Add whole turns to qs (m, n) in place: inside the range and nearest q_near, else least outside it.

    Returns: (m,), whether all joints of a row are inside their ranges.
    """
    turn = 2.0 * np.pi
    inside = np.ones(qs.shape[0], np.bool_)
    for k in range(qs.shape[0]):
        for j in range(qs.shape[1]):
            low = np.ceil((q_min[j] - LIMIT_TOLERANCE_RAD - qs[k, j]) / turn)
            high = np.floor((q_max[j] + LIMIT_TOLERANCE_RAD - qs[k, j]) / turn)
            if low <= high:
                qs[k, j] += turn * min(high, max(low, np.rint((q_near[j] - qs[k, j]) / turn)))
            else:
                inside[k] = False
                qs[k, j] += turn * np.rint(((q_min[j] + q_max[j]) / 2.0 - qs[k, j]) / turn)
    return inside


@njit(cache=True)
def rotation_fault(T: Array) -> float:
    """How far the rotation of a pose is from orthonormal, largest entry of R R^T - I; infinite when mirrored."""
    worst = 0.0
    for i in range(3):
        for j in range(3):
            product = T[i, 0] * T[j, 0] + T[i, 1] * T[j, 1] + T[i, 2] * T[j, 2]
            worst = max(worst, abs(product - (1.0 if i == j else 0.0)))
    x = T[0, 1] * T[1, 2] - T[0, 2] * T[1, 1]
    y = T[0, 2] * T[1, 0] - T[0, 0] * T[1, 2]
    z = T[0, 0] * T[1, 1] - T[0, 1] * T[1, 0]
    return worst if x * T[2, 0] + y * T[2, 1] + z * T[2, 2] > 0.0 else np.inf
