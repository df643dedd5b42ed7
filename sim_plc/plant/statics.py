"""Statics: gravity torques, sag at rest, composite inertias, and steady pressures and speeds of an actuator."""

import numpy as np

from machine.rotations import Array, skew
from sim_plc.plant.aba import joint_frames
from sim_plc.plant.tree import FLEX_JOINT_INDICES, MOTOR_JOINT_INDICES, N_TREE_JOINTS, Tree


def frames(tree: Tree, q: Array) -> tuple[Array, Array]:
    """Orientations (11, 3, 3) and origins (11, 3) [m] of the joint frames in base at joint angles q (11,) [rad]."""
    R, p = np.zeros((N_TREE_JOINTS, 3, 3)), np.zeros((N_TREE_JOINTS, 3))
    joint_frames(tree.tree_R, tree.tree_p, q, R, p)
    return R, p


def gravity_torques(tree: Tree, gravity: Array, q: Array) -> Array:
    """Torque of the weights about every joint axis, shape (11,) [N m]; at rest motors must give its negative.

    Model:   t_i = z_i . sum_k>=i (c_k - p_i) x m_k g = z_i . (sum_k>=i m_k c_k - p_i sum_k>=i m_k) x g.
    """
    R, p = frames(tree, q)
    coms = p + np.einsum("nij,nj->ni", R, tree.com_m)
    outboard = np.cumsum(tree.mass_kg[::-1])[::-1]
    moments = np.cumsum((tree.mass_kg[:, None] * coms)[::-1], axis=0)[::-1] - outboard[:, None] * p
    return np.einsum("ni,ni->n", R[:, :, 2], moments @ skew(gravity))


def static_equilibrium_angles(tree: Tree, gravity: Array, q_motor: Array, stiffness: Array) -> Array:
    """Joint angles (11,) [rad] at rest with the motors held at q_motor (6,): k q_f = gravity torque at each spring."""
    q = np.zeros(N_TREE_JOINTS)
    q[MOTOR_JOINT_INDICES] = q_motor
    for _ in range(30):
        bent = gravity_torques(tree, gravity, q)[FLEX_JOINT_INDICES] / stiffness
        settled = np.array_equal(bent, q[FLEX_JOINT_INDICES])
        q[FLEX_JOINT_INDICES] = bent
        if settled:
            break
    return q


def outboard_inertias(tree: Tree, q: Array) -> Array:
    """Moment of inertia of everything outboard of each joint about that joint's axis, shape (11,) [kg m2]."""
    R, p = frames(tree, q)
    result = np.zeros(N_TREE_JOINTS)
    for i in range(N_TREE_JOINTS):
        for k in range(i, N_TREE_JOINTS):
            arm = skew(p[k] + R[k] @ tree.com_m[k] - p[i])
            moments = R[k] @ tree.inertia_kg_m2[k] @ R[k].T - tree.mass_kg[k] * arm @ arm
            result[i] += R[i, :, 2] @ moments @ R[i, :, 2]
    return result


def steady_pressures(
    force: float, area_a: float, area_b: float, supply: float, tank: float, extend: bool
) -> tuple[float, float]:
    """Chamber pressures A, B [Pa] while the actuator moves steadily against `force` through a symmetric valve.

    Model:   pA AA - pB AB = F with (pS - pA) AB^2 = (pB - pT) AA^2 when it extends, mirrored when it retracts.
    """
    ratio = (area_a / area_b) ** 2
    if extend:
        p_b = (area_a * (supply + ratio * tank) - force) / (area_a * ratio + area_b)
    else:
        p_b = (area_a * (tank + ratio * supply) - force) / (area_a * ratio + area_b)
    return (force + p_b * area_b) / area_a, p_b


def resting_pressures(force: float, area_a: float, area_b: float, supply: float, tank: float) -> tuple[float, float]:
    """Chamber pressures A, B [Pa] that carry `force` with the valve closed: between extending and retracting."""
    _, b_out = steady_pressures(force, area_a, area_b, supply, tank, True)
    _, b_in = steady_pressures(force, area_a, area_b, supply, tank, False)
    p_b = 0.5 * (b_out + b_in)
    return (force + p_b * area_b) / area_a, p_b


def steady_speed(
    force: float, gain: float, area_a: float, area_b: float, supply: float, tank: float, laminar: float, extend: bool
) -> float:
    """Actuator speed [m/s or rad/s], positive, with the valve fully open against a constant `force`."""
    p_a, p_b = steady_pressures(force, area_a, area_b, supply, tank, extend)
    drop, area = (p_b - tank, area_b) if extend else (p_a - tank, area_a)
    return gain * drop / np.sqrt(abs(drop) + laminar) / area
