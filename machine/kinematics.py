"""Forward kinematics and geometric Jacobian of a classic-DH chain (paper eq. 1-2 and 23-24).

The kernels are compiled, with bodies that run as plain Python too (`kernel.py_func`). They get the joint angles as a
fresh array, `q + theta_offset`, so that a read-only or strided q triggers no new compilation.
"""

import numpy as np
from numba import njit

from machine.chain import Chain
from machine.errors import MachineError
from machine.rotations import Array


@njit(cache=True)
def _multiply_poses(left: Array, right: Array, out: Array) -> None:
    """4x4 pose product, written out: the last row of a pose is (0, 0, 0, 1)."""
    for i in range(3):
        for j in range(4):
            out[i, j] = left[i, 0] * right[0, j] + left[i, 1] * right[1, j] + left[i, 2] * right[2, j]
        out[i, 3] += left[i, 3]
    out[3, 3] = 1.0


@njit(cache=True)
def _link_poses(a: Array, d: Array, alpha: Array, theta: Array) -> Array:
    n = a.shape[0]
    poses = np.zeros((n + 1, 4, 4))
    T_i = np.zeros((4, 4))
    for i in range(4):
        poses[0, i, i] = 1.0
    for i in range(n):
        c, s = np.cos(theta[i]), np.sin(theta[i])
        ca, sa = np.cos(alpha[i]), np.sin(alpha[i])
        T_i[0, 0], T_i[0, 1], T_i[0, 2], T_i[0, 3] = c, -s * ca, s * sa, a[i] * c  # eq. 24
        T_i[1, 0], T_i[1, 1], T_i[1, 2], T_i[1, 3] = s, c * ca, -c * sa, a[i] * s
        T_i[2, 1], T_i[2, 2], T_i[2, 3] = sa, ca, d[i]
        _multiply_poses(poses[i], T_i, poses[i + 1])  # eq. 23
    return poses


@njit(cache=True)
def _tcp_pose(a: Array, d: Array, alpha: Array, theta: Array, T_flange_tcp: Array) -> Array:
    T_base_tcp = np.zeros((4, 4))
    _multiply_poses(_link_poses(a, d, alpha, theta)[-1], T_flange_tcp, T_base_tcp)  # eq. 23, i = 7
    return T_base_tcp


@njit(cache=True)
def _tcp_poses(a: Array, d: Array, alpha: Array, thetas: Array, T_flange_tcp: Array) -> Array:
    Ts = np.zeros((thetas.shape[0], 4, 4))
    for k in range(thetas.shape[0]):
        _multiply_poses(_link_poses(a, d, alpha, thetas[k])[-1], T_flange_tcp, Ts[k])
    return Ts


@njit(cache=True)
def _tcp_jacobian(a: Array, d: Array, alpha: Array, theta: Array, T_flange_tcp: Array) -> Array:
    n = a.shape[0]
    poses = _link_poses(a, d, alpha, theta)
    T_base_tcp = np.zeros((4, 4))
    _multiply_poses(poses[n], T_flange_tcp, T_base_tcp)
    J = np.zeros((6, n))
    for i in range(n):
        zx, zy, zz = poses[i, 0, 2], poses[i, 1, 2], poses[i, 2, 2]
        rx = T_base_tcp[0, 3] - poses[i, 0, 3]
        ry = T_base_tcp[1, 3] - poses[i, 1, 3]
        rz = T_base_tcp[2, 3] - poses[i, 2, 3]
        J[0, i], J[1, i], J[2, i] = zy * rz - zz * ry, zz * rx - zx * rz, zx * ry - zy * rx  # z_(i-1) x (p - p_(i-1))
        J[3, i], J[4, i], J[5, i] = zx, zy, zz
    return J


def _dh_angles(chain: Chain, q: Array) -> Array:
    """DH angles of joint angles (n,) [rad], shape checked."""
    q = np.asarray(q, dtype=float)
    if q.shape != (chain.n,):
        raise MachineError(f"joint vector has shape {q.shape}; the chain has {chain.n} joints: give ({chain.n},) [rad]")
    return q + chain.theta_offset


def _result_if_finite(result: Array, q: Array) -> Array:
    """The kernel's result, given back only when the joint angles were finite."""
    if not np.isfinite(q).all():
        raise MachineError(f"joint vector {np.asarray(q)} [rad] is not finite; check the encoder reading")
    return result


def link_poses(chain: Chain, q: Array) -> Array:
    """Poses of base and all link frames in base.

    Model:   T_base_link_i = T_1 ... T_i, T_i the classic DH transform of Table 1's row i.
    Args:    q: joint angles, shape (n,), unit [rad].
    Returns: (n + 1, 4, 4), [0] = base, [i] = T_base_link_i, [n] = T_base_flange; positions [m].
    Raises:  MachineError: wrong shape, or not finite.
    Source:  paper eq. 23-24.
    """
    return _result_if_finite(_link_poses(chain.dh_a_m, chain.dh_d_m, chain.dh_alpha_rad, _dh_angles(chain, q)), q)


def tcp_pose(chain: Chain, q: Array) -> Array:
    """T_base_tcp (4, 4) at q (n,) [rad], position [m] (paper eq. 23, link 7 included)."""
    return _result_if_finite(
        _tcp_pose(chain.dh_a_m, chain.dh_d_m, chain.dh_alpha_rad, _dh_angles(chain, q), chain.T_flange_tcp), q
    )


def tcp_poses(chain: Chain, qs: Array) -> Array:
    """Ts_base_tcp (m, 4, 4) at joint vectors (m, n) [rad]."""
    qs = np.asarray(qs, dtype=float)
    if qs.ndim != 2 or qs.shape[1] != chain.n:
        raise MachineError(f"joint vectors have shape {qs.shape}; the chain has {chain.n} joints: give (m, {chain.n})")
    thetas = np.ascontiguousarray(qs + chain.theta_offset)
    return _result_if_finite(_tcp_poses(chain.dh_a_m, chain.dh_d_m, chain.dh_alpha_rad, thetas, chain.T_flange_tcp), qs)


def tcp_jacobian(chain: Chain, q: Array) -> Array:
    """Geometric Jacobian of the tcp.

    Model:   (v_base_tcp, w_base_tcp) = J qd; column i = (z_(i-1) x (p_tcp - p_(i-1)), z_(i-1)).
    Args:    q: joint angles, shape (n,), unit [rad].
    Returns: J_base_tcp (6, n): linear rows [m/rad] first, then angular rows; base axes, at the tcp.
    Raises:  MachineError: wrong shape, or not finite.
    Source:  paper eq. 2.
    """
    return _result_if_finite(
        _tcp_jacobian(chain.dh_a_m, chain.dh_d_m, chain.dh_alpha_rad, _dh_angles(chain, q), chain.T_flange_tcp), q
    )


def sigma_min(J: Array) -> float:
    """Smallest singular value of a Jacobian (6, n), rows in [m] and [rad] as they are: 0 at a singularity."""
    return float(np.linalg.svd(J, compute_uv=False)[-1])
