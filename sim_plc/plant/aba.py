"""Articulated-body algorithm for a serial chain of revolute joints, every quantity in base axes about the base origin.

In common axes no 6x6 congruence is needed: articulated inertias of parent and child simply add.
Source: Featherstone 2008, Rigid Body Dynamics Algorithms, section 7.3; spatial vectors are (angular, linear).
"""

import numpy as np
from numba import njit

from machine.rotations import Array


@njit(cache=True, error_model="numpy")
def joint_frames(tree_R: Array, tree_p: Array, q: Array, R: Array, p: Array) -> None:
    """Orientation R (n, 3, 3) and origin p (n, 3) [m] of every joint frame in base, after its rotation; axis = R[:, 2].

    Model:   R_i = R_{i-1} tree_R_i Rz(q_i), p_i = p_{i-1} + R_{i-1} tree_p_i.
    """
    for i in range(q.shape[0]):
        c, s = np.cos(q[i]), np.sin(q[i])
        for row in range(3):
            if i == 0:
                x, y, z = tree_R[0, row, 0], tree_R[0, row, 1], tree_R[0, row, 2]
                p[0, row] = tree_p[0, row]
            else:
                a, b, d = R[i - 1, row, 0], R[i - 1, row, 1], R[i - 1, row, 2]
                x = a * tree_R[i, 0, 0] + b * tree_R[i, 1, 0] + d * tree_R[i, 2, 0]
                y = a * tree_R[i, 0, 1] + b * tree_R[i, 1, 1] + d * tree_R[i, 2, 1]
                z = a * tree_R[i, 0, 2] + b * tree_R[i, 1, 2] + d * tree_R[i, 2, 2]
                p[i, row] = p[i - 1, row] + a * tree_p[i, 0] + b * tree_p[i, 1] + d * tree_p[i, 2]
            R[i, row, 0] = c * x + s * y
            R[i, row, 1] = -s * x + c * y
            R[i, row, 2] = z


@njit(cache=True, error_model="numpy")
def _cross_product(a: Array, ia: int, b: Array, ib: int, out: Array, io: int) -> None:
    out[io] = a[ia + 1] * b[ib + 2] - a[ia + 2] * b[ib + 1]
    out[io + 1] = a[ia + 2] * b[ib] - a[ia] * b[ib + 2]
    out[io + 2] = a[ia] * b[ib + 1] - a[ia + 1] * b[ib]


@njit(cache=True, error_model="numpy")
def _spatial_inertia(R: Array, p: Array, mass: float, com: Array, inertia: Array, out: Array, turned: Array) -> None:
    """Spatial inertia (6, 6) in base axes about the base origin; `com`, `inertia` about it in the joint frame."""
    cx = p[0] + R[0, 0] * com[0] + R[0, 1] * com[1] + R[0, 2] * com[2]
    cy = p[1] + R[1, 0] * com[0] + R[1, 1] * com[1] + R[1, 2] * com[2]
    cz = p[2] + R[2, 0] * com[0] + R[2, 1] * com[1] + R[2, 2] * com[2]
    for a in range(3):
        for b in range(3):
            turned[a, b] = R[a, 0] * inertia[0, b] + R[a, 1] * inertia[1, b] + R[a, 2] * inertia[2, b]
    for a in range(3):
        for b in range(3):
            out[a, b] = turned[a, 0] * R[b, 0] + turned[a, 1] * R[b, 1] + turned[a, 2] * R[b, 2]
            out[a, 3 + b] = 0.0
            out[3 + a, b] = 0.0
            out[3 + a, 3 + b] = 0.0
        out[3 + a, 3 + a] = mass
    out[0, 0] += mass * (cy * cy + cz * cz)
    out[1, 1] += mass * (cx * cx + cz * cz)
    out[2, 2] += mass * (cx * cx + cy * cy)
    out[0, 1] -= mass * cx * cy
    out[1, 0] -= mass * cx * cy
    out[0, 2] -= mass * cx * cz
    out[2, 0] -= mass * cx * cz
    out[1, 2] -= mass * cy * cz
    out[2, 1] -= mass * cy * cz
    # m [c]x in the upper right block, its transpose below
    out[0, 4], out[0, 5], out[1, 5] = -mass * cz, mass * cy, -mass * cx
    out[1, 3], out[2, 3], out[2, 4] = mass * cz, -mass * cy, mass * cx
    out[4, 0], out[5, 0], out[5, 1] = -mass * cz, mass * cy, -mass * cx
    out[3, 1], out[3, 2], out[4, 2] = mass * cz, -mass * cy, mass * cx


@njit(cache=True, error_model="numpy")
def _propagate_velocities(R: Array, p: Array, qd: Array, axis: Array, v: Array, c: Array) -> None:
    """Motion axes S_i = (z, p x z), spatial velocities v_i and bias accelerations c_i = v_i x S_i qd_i."""
    for i in range(qd.shape[0]):
        s = axis[i]
        for k in range(3):
            s[k] = R[i, k, 2]
        _cross_product(p[i], 0, s, 0, s, 3)
        for k in range(6):
            v[i, k] = s[k] * qd[i]
            if i > 0:
                v[i, k] += v[i - 1, k]
        w = v[i]
        x, y, z = s[0], s[1], s[2]
        c[i, 0] = (w[1] * z - w[2] * y) * qd[i]
        c[i, 1] = (w[2] * x - w[0] * z) * qd[i]
        c[i, 2] = (w[0] * y - w[1] * x) * qd[i]
        c[i, 3] = (w[1] * s[5] - w[2] * s[4] + w[4] * z - w[5] * y) * qd[i]
        c[i, 4] = (w[2] * s[3] - w[0] * s[5] + w[5] * x - w[3] * z) * qd[i]
        c[i, 5] = (w[0] * s[4] - w[1] * s[3] + w[3] * y - w[4] * x) * qd[i]


@njit(cache=True, error_model="numpy")
def _bias_force(inertia: Array, v: Array, momentum: Array, out: Array) -> None:
    """Gyroscopic force v x* (I v) of one body."""
    for a in range(6):
        total = 0.0
        for b in range(6):
            total += inertia[a, b] * v[b]
        momentum[a] = total
    h = momentum
    out[0] = v[1] * h[2] - v[2] * h[1] + v[4] * h[5] - v[5] * h[4]
    out[1] = v[2] * h[0] - v[0] * h[2] + v[5] * h[3] - v[3] * h[5]
    out[2] = v[0] * h[1] - v[1] * h[0] + v[3] * h[4] - v[4] * h[3]
    out[3] = v[1] * h[5] - v[2] * h[4]
    out[4] = v[2] * h[3] - v[0] * h[5]
    out[5] = v[0] * h[4] - v[1] * h[3]


@njit(cache=True, error_model="numpy")
def aba(
    tree_R: Array,
    tree_p: Array,
    mass: Array,
    com: Array,
    inertia: Array,
    armature: Array,
    gravity: Array,
    q: Array,
    qd: Array,
    tau: Array,
    work: Array,
    qdd: Array,
) -> None:
    """Joint accelerations of the chain under joint torques.

    Model:   M(q) qdd + h(q, qd) = tau; gravity enters as a base acceleration of -g.
    Args:    tree_R, tree_p: fixed transform from the previous joint frame, (n, 3, 3), (n, 3) [m].
             mass (n,) [kg], com (n, 3) [m], inertia (n, 3, 3) about the CoM [kg m2]: in the joint's own frame.
             armature: rotor inertia on the joint axis, (n,) [kg m2]. gravity: (3,) [m/s2].
             q, qd, tau: (n,) [rad, rad/s, N m]. work: scratch of `aba_work(n)`.
             qdd: result (n,) [rad/s2], written in place.
    """
    n = q.shape[0]
    R = work[: 9 * n].reshape(n, 3, 3)
    p = work[9 * n : 12 * n].reshape(n, 3)
    axis = work[12 * n : 18 * n].reshape(n, 6)
    v = work[18 * n : 24 * n].reshape(n, 6)
    c = work[24 * n : 30 * n].reshape(n, 6)
    force = work[30 * n : 36 * n].reshape(n, 6)
    U = work[36 * n : 42 * n].reshape(n, 6)
    D = work[42 * n : 43 * n]
    u = work[43 * n : 44 * n]
    bodies = work[44 * n : 80 * n].reshape(n, 6, 6)
    extra = work[80 * n : 80 * n + 21]
    turned = extra[:9].reshape(3, 3)
    momentum = extra[9:15]
    acc = extra[15:21]

    joint_frames(tree_R, tree_p, q, R, p)
    _propagate_velocities(R, p, qd, axis, v, c)
    for i in range(n):
        _spatial_inertia(R[i], p[i], mass[i], com[i], inertia[i], bodies[i], turned)
        _bias_force(bodies[i], v[i], momentum, force[i])

    for i in range(n - 1, -1, -1):
        s, Ui, Ii = axis[i], U[i], bodies[i]
        d, projected = armature[i], 0.0
        for a in range(6):
            total = 0.0
            for b in range(6):
                total += Ii[a, b] * s[b]
            Ui[a] = total
            d += s[a] * total
            projected += s[a] * force[i, a]
        D[i] = d
        u[i] = tau[i] - projected
        if i == 0:
            break
        ratio = u[i] / d
        bias = 0.0
        for b in range(6):
            bias += Ui[b] * c[i, b]
        ratio -= bias / d
        for a in range(6):
            total = force[i, a] + Ui[a] * ratio
            scaled = Ui[a] / d
            for b in range(6):
                total += Ii[a, b] * c[i, b]
                bodies[i - 1, a, b] += Ii[a, b] - scaled * Ui[b]
            force[i - 1, a] += total

    acc[:3] = 0.0
    acc[3:] = -gravity
    for i in range(n):
        total = 0.0
        for a in range(6):
            acc[a] += c[i, a]
            total += U[i, a] * acc[a]
        qdd[i] = (u[i] - total) / D[i]
        for a in range(6):
            acc[a] += axis[i, a] * qdd[i]


def aba_work(n: int) -> Array:
    """Scratch memory for `aba` with n joints."""
    return np.zeros(80 * n + 21)
