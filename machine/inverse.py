"""Closed-form inverse kinematics of a 3R arm with a spherical wrist: eight branches, the nearest inside the limits."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from machine.chain import Chain
from machine.errors import MachineError
from machine.kinematics import link_poses, sigma_min, tcp_jacobian
from machine.poses import inverse_pose
from machine.rotations import Array, rotation_about

ALPHAS_RAD = np.deg2rad([90.0, 0.0, 90.0, 90.0, -90.0, 90.0])  # the twists of Table 1, which the closed form needs
WRIST_SINGULAR = 1e-9  # |sin theta5| below which theta4 and theta6 share one axis


class InverseStatus(Enum):
    """How the inverse ended; `q` is given only for OK and SINGULAR."""

    OK = "ok"
    OUT_OF_REACH = "out_of_reach"
    JOINT_LIMIT = "joint_limit"
    SINGULAR = "singular"


@dataclass(frozen=True, slots=True)
class Branch:
    """One solution (n,) [rad] and whether it lies inside the joint limits."""

    q: Array
    inside_limits: bool


@dataclass(frozen=True, slots=True)
class InverseResult:
    """The solution nearest to where the machine stands, or why there is none."""

    status: InverseStatus
    reason: str
    q: Array | None
    sigma_min: float


def inverse_all(chain: Chain, T_base_tcp: Array, q_near: Array | None = None) -> tuple[Branch, ...]:
    """All solutions that reach a pose.

    Model:   wrist centre from the pose, three arm angles from it (two shoulders x two elbows), then ZYZ wrist angles
             (two flips). Angles are unwrapped to the turn nearest `q_near` that lies inside the limits.
    Args:    chain: twists as Table 1. T_base_tcp: wanted pose (4, 4). q_near: (6,) [rad]; middle of the ranges if None.
    Returns: up to eight branches; none when out of reach.
    Raises:  MachineError when the chain has other twists, or the pose is not finite.
    """
    _check(chain, T_base_tcp)
    near = (chain.q_min + chain.q_max) / 2.0 if q_near is None else np.asarray(q_near, dtype=float)
    T_base_6 = T_base_tcp @ inverse_pose(chain.T_flange_tcp)
    z5 = T_base_6[:3, 1]  # axis of joint 6, since alpha_6 = 90 deg
    p_wrist = T_base_6[:3, 3] - chain.d[5] * z5
    branches: list[Branch] = []
    for arm in _arm_angles(chain, p_wrist):
        for wrist in _wrist_angles(chain, arm, T_base_6, near):
            q = _nearest_turn(np.concatenate([arm, wrist]) - chain.theta_offset, near, chain)
            inside = bool(np.all(q >= chain.q_min - 1e-9) and np.all(q <= chain.q_max + 1e-9))
            branches.append(Branch(q=q, inside_limits=inside))
    return tuple(branches)


def inverse_nearest(chain: Chain, T_base_tcp: Array, q_near: Array) -> InverseResult:
    """The branch inside the joint limits with the least largest joint travel from q_near (6,) [rad]."""
    branches = inverse_all(chain, T_base_tcp, q_near)
    if not branches:
        return InverseResult(InverseStatus.OUT_OF_REACH, _reach_reason(chain, T_base_tcp), None, 0.0)
    inside = [branch for branch in branches if branch.inside_limits]
    if not inside:
        closest = min(branches, key=lambda branch: _excess(chain, branch.q).max())
        return InverseResult(InverseStatus.JOINT_LIMIT, _limit_reason(chain, closest.q), None, 0.0)
    best = min(inside, key=lambda branch: float(np.abs(branch.q - q_near).max()))
    smallest = sigma_min(tcp_jacobian(chain, best.q))
    if abs(np.sin(best.q[4] + chain.theta_offset[4])) < WRIST_SINGULAR:
        reason = "joint 5 is at 0 deg: the wrist is singular; turn the tool out of the tilt boom's line"
        return InverseResult(InverseStatus.SINGULAR, reason, best.q, smallest)
    return InverseResult(InverseStatus.OK, "", best.q, smallest)


def _check(chain: Chain, T_base_tcp: Array) -> None:
    if chain.n != 6 or not np.allclose(chain.alpha, ALPHAS_RAD, atol=1e-9) or chain.a[3:].any() or chain.d[4] != 0.0:
        raise MachineError(
            "the closed-form inverse needs six joints with the twists of Table 1 (90, 0, 90, 90, -90, 90 deg) and a "
            "spherical wrist (a4 = a5 = a6 = d5 = 0)"
        )
    if T_base_tcp.shape != (4, 4) or not np.isfinite(T_base_tcp).all():
        raise MachineError(f"wanted pose has shape {T_base_tcp.shape} or is not finite; give a finite (4, 4) pose")


def _arm_angles(chain: Chain, p_wrist: Array) -> list[Array]:
    """theta 1..3 that put the wrist centre at p_wrist."""
    x, y, z = p_wrist
    radius = float(np.hypot(x, y))
    lateral = chain.d[1] + chain.d[2]
    if radius < abs(lateral) or radius < 1e-9:
        return []
    forearm = float(np.hypot(chain.a[2], chain.d[3]))
    bend = float(np.arctan2(chain.d[3], chain.a[2]))
    side = float(np.arcsin(lateral / radius))
    azimuth = float(np.arctan2(y, x))
    solutions = []
    for theta1 in (azimuth + side, azimuth + np.pi - side):
        u = x * np.cos(theta1) + y * np.sin(theta1) - chain.a[0]
        v = z - chain.d[0]
        cosine = (u * u + v * v - chain.a[1] ** 2 - forearm**2) / (2.0 * chain.a[1] * forearm)
        if abs(cosine) > 1.0 + 1e-12:
            continue
        for elbow in (np.arccos(np.clip(cosine, -1.0, 1.0)), -np.arccos(np.clip(cosine, -1.0, 1.0))):
            reach = np.arctan2(forearm * np.sin(elbow), chain.a[1] + forearm * np.cos(elbow))
            solutions.append(np.array([theta1, np.arctan2(v, u) - reach, bend + elbow]))
    return solutions


def _wrist_angles(chain: Chain, arm: Array, T_base_6: Array, near: Array) -> list[Array]:
    """theta 4..6 for given arm angles: Rz(t4) Ry(-t5) Rz(t6) = R_3_6 Rx(-90 deg)."""
    q = np.zeros(6)
    q[:3] = arm - chain.theta_offset[:3]
    R_base_3 = link_poses(chain, q)[3][:3, :3]
    M = R_base_3.T @ T_base_6[:3, :3] @ rotation_about("x", -np.pi / 2.0)
    sine = float(np.hypot(M[0, 2], M[1, 2]))
    if sine < WRIST_SINGULAR:
        theta5 = 0.0 if M[2, 2] > 0.0 else np.pi
        theta4 = near[3] + chain.theta_offset[3]
        turned = rotation_about("y", theta5) @ rotation_about("z", -theta4) @ M  # Rz(t6)
        return [np.array([theta4, theta5, np.arctan2(turned[1, 0], turned[0, 0])])]
    up = np.array([np.arctan2(-M[1, 2], -M[0, 2]), np.arctan2(sine, M[2, 2]), np.arctan2(-M[2, 1], M[2, 0])])
    down = np.array([np.arctan2(M[1, 2], M[0, 2]), np.arctan2(-sine, M[2, 2]), np.arctan2(M[2, 1], -M[2, 0])])
    return [up, down]


def _nearest_turn(q: Array, near: Array, chain: Chain) -> Array:
    """Each angle plus the whole turns that bring it nearest `near`, preferring turns inside the limits."""
    turn = 2.0 * np.pi
    base = q + turn * np.round((near - q) / turn)
    candidates = base + turn * np.array([[-1.0], [0.0], [1.0]])
    outside = (candidates < chain.q_min - 1e-9) | (candidates > chain.q_max + 1e-9)
    cost = np.abs(candidates - near) + 1e3 * outside
    return candidates[np.argmin(cost, axis=0), np.arange(len(q))]


def _excess(chain: Chain, q: Array) -> Array:
    return np.maximum(np.maximum(chain.q_min - q, q - chain.q_max), 0.0)


def _limit_reason(chain: Chain, q: Array) -> str:
    j = int(np.argmax(_excess(chain, q)))
    value, low, high = np.rad2deg([q[j], chain.q_min[j], chain.q_max[j]])
    return (
        f"joint {j + 1} would have to be at {value:.1f} deg (limits {low:.1f} .. {high:.1f} deg); "
        "move the base or the target, or turn the tool"
    )


def _reach_reason(chain: Chain, T_base_tcp: Array) -> str:
    distance = float(np.linalg.norm(T_base_tcp[:3, 3] - np.array([0.0, 0.0, chain.d[0]])))
    longest = float(chain.a[0] + chain.a[1] + np.hypot(chain.a[2], chain.d[3]) + chain.d[5])
    return (
        f"the target is {distance:.2f} m from the shoulder; the arm reaches at most {longest:.2f} m "
        "and not every orientation there: move the base or the target nearer"
    )
