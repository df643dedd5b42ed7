"""Forward kinematics and geometric Jacobian of a classic-DH chain (paper eq. 23-24)."""

import numpy as np
from numba import njit

from machine.chain import Chain
from machine.errors import MachineError
from machine.rotations import Array


@njit(cache=True)
def _link_poses(a: Array, d: Array, alpha: Array, theta: Array) -> Array:
    n = a.shape[0]
    poses = np.zeros((n + 1, 4, 4))
    poses[0] = np.eye(4)
    for i in range(n):
        c, s = np.cos(theta[i]), np.sin(theta[i])
        ca, sa = np.cos(alpha[i]), np.sin(alpha[i])
        T_i = np.array(
            [  # eq. 24
                [c, -s * ca, s * sa, a[i] * c],
                [s, c * ca, -c * sa, a[i] * s],
                [0.0, sa, ca, d[i]],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
        poses[i + 1] = poses[i] @ T_i  # eq. 23
    return poses


@njit(cache=True)
def _jacobian(poses: Array, p_tcp: Array) -> Array:
    n = poses.shape[0] - 1
    J = np.zeros((6, n))
    for i in range(n):
        z = poses[i, :3, 2]
        r = p_tcp - poses[i, :3, 3]
        J[0, i] = z[1] * r[2] - z[2] * r[1]
        J[1, i] = z[2] * r[0] - z[0] * r[2]
        J[2, i] = z[0] * r[1] - z[1] * r[0]
        J[3:, i] = z
    return J


def _checked(chain: Chain, q: Array) -> Array:
    q = np.asarray(q, dtype=float)
    if q.shape != (chain.n,):
        raise MachineError(f"joint vector has shape {q.shape}; the chain has {chain.n} joints: give ({chain.n},) [rad]")
    if not np.isfinite(q).all():
        raise MachineError(f"joint vector {q} [rad] is not finite; check the encoder reading")
    return q


def link_poses(chain: Chain, q: Array) -> Array:
    """Poses of base and all link frames in base.

    Args:    q: joint angles, shape (n,), unit [rad].
    Returns: (n + 1, 4, 4), [0] = base, [i] = T_base_link_i.
    """
    return _link_poses(chain.a, chain.d, chain.alpha, _checked(chain, q) + chain.theta_offset)


def tcp_pose(chain: Chain, q: Array) -> Array:
    """T_base_tcp (4, 4) at q (n,) [rad] (paper eq. 23, link 7 included)."""
    return link_poses(chain, q)[-1] @ chain.T_flange_tcp


def tcp_poses(chain: Chain, qs: Array) -> Array:
    """Ts_base_tcp (m, 4, 4) at joint vectors (m, n) [rad]."""
    return np.array([tcp_pose(chain, q) for q in qs]).reshape(-1, 4, 4)


def tcp_jacobian(chain: Chain, q: Array) -> Array:
    """Geometric Jacobian J_base_tcp (6, n): linear rows first, base axes, at the tcp (paper eq. 2)."""
    poses = link_poses(chain, q)
    p_tcp = poses[-1] @ chain.T_flange_tcp
    return _jacobian(poses, p_tcp[:3, 3].copy())


def sigma_min(J: Array) -> float:
    """Smallest singular value of a Jacobian: 0 at a singularity."""
    return float(np.linalg.svd(J, compute_uv=False)[-1])
