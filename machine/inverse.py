"""Closed-form inverse kinematics of a 3R arm with a spherical wrist: eight branches, the nearest inside the limits."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.chain import Chain
from machine.errors import MachineError
from machine.kinematics import sigma_min, tcp_jacobian
from machine.poses import inverse_pose
from machine.rotations import Array

# Compiled closed form of the inverse kinematics: all DH angles that reach a flange pose, in plain loops.

# |sin theta5|, or [m] of the wrist centre from the slew axis, below which an angle may be chosen freely
FREE_ANGLE_TOLERANCE = 1e-9
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
    if radius < abs(lateral) - FREE_ANGLE_TOLERANCE:
        return 0, arms
    side = np.arcsin(min(1.0, max(-1.0, lateral / radius))) if radius > FREE_ANGLE_TOLERANCE else 0.0
    azimuth = np.arctan2(y, x) if radius > FREE_ANGLE_TOLERANCE else theta1_free
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
    t4 = (
        np.arctan2(sign * M[1, 2], sign * M[0, 2]) if np.hypot(M[0, 2], M[1, 2]) > FREE_ANGLE_TOLERANCE else theta4_free
    )
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


CLOSED_FORM_DH_ALPHAS_RAD = np.deg2rad(
    [90.0, 0.0, 90.0, 90.0, -90.0, 90.0]
)  # the twists of Table 1, which the closed form needs
# Sin of an angle, or [m]; nearer, 1e-6 of noise in the wanted pose turns a joint by half a degree
SINGULARITY_SINE_MIN = 1e-4
ORTHONORMALITY_ERROR_MAX = 1e-6  # how far a wanted pose may be from orthonormal


class InverseStatus(Enum):
    """How the inverse ended; `q` is given only for OK and SINGULAR."""

    OK = "ok"
    OUT_OF_REACH = "out_of_reach"
    JOINT_LIMIT = "joint_limit"
    SINGULAR = "singular"


@dataclass(frozen=True, slots=True)
class Branch:
    """One solution (n,) [rad] and whether it lies inside the joint limits."""

    q_rad: Array
    inside_limits: bool


@dataclass(frozen=True, slots=True)
class InverseResult:
    """The solution nearest to where the machine stands, or why there is none."""

    status: InverseStatus
    reason: str
    q_rad: Array | None
    sigma_min: float


def inverse_all(chain: Chain, T_base_tcp: Array, q_near: Array | None = None) -> tuple[Branch, ...]:
    """All solutions that reach a pose.

    Model:   wrist centre from the pose, three arm angles from it (two shoulders x two elbows), then ZYZ wrist angles
             (two flips). Angles are unwrapped to the turn nearest `q_near` that lies inside the limits.
    Args:    chain: twists as Table 1. T_base_tcp: wanted pose (4, 4). q_near: (6,) [rad]; middle of the ranges if
             None; at theta5 = 0 it also chooses theta4.
    Returns: up to eight branches; none when out of reach.
    Raises:  MachineError: the chain has other twists, T_base_tcp is not a pose, or q_near is not finite.
    """
    _check_chain(chain)
    _check_pose(T_base_tcp)
    q_near = (chain.q_min + chain.q_max) / 2.0 if q_near is None else _checked_near(q_near)
    T_base_flange = T_base_tcp @ inverse_pose(chain.T_flange_tcp)
    count, thetas = solve_angles(chain.dh_a_m, chain.dh_d_m, T_base_flange, q_near + chain.theta_offset)
    qs = thetas[:count] - chain.theta_offset
    inside = unwrap(qs, q_near + 0.0, chain.q_min, chain.q_max)
    return tuple(Branch(q_rad=q, inside_limits=bool(fits)) for q, fits in zip(qs, inside, strict=True))


def inverse_nearest(chain: Chain, T_base_tcp: Array, q_near: Array) -> InverseResult:
    """The branch inside the joint limits with the least largest joint travel from q_near.

    Args:    T_base_tcp: wanted pose (4, 4). q_near: (6,) [rad], where the machine stands.
    Returns: status OK with q (6,) [rad]; SINGULAR with q when the wrist, the booms or the slew are (nearly) singular
             there; OUT_OF_REACH or JOINT_LIMIT without q. The reason names joint, value, limit, unit and remedy.
    Raises:  MachineError as `inverse_all`.
    """
    branches = inverse_all(chain, T_base_tcp, q_near)
    if not branches:
        return InverseResult(InverseStatus.OUT_OF_REACH, _reach_reason(chain, T_base_tcp), None, 0.0)
    inside = [branch for branch in branches if branch.inside_limits]
    if not inside:
        closest = min(branches, key=lambda branch: _joint_limit_excess(chain, branch.q_rad).max())
        return InverseResult(InverseStatus.JOINT_LIMIT, _limit_reason(chain, closest.q_rad), None, 0.0)
    best = min(inside, key=lambda branch: float(np.abs(branch.q_rad - q_near).max()))
    smallest = sigma_min(tcp_jacobian(chain, best.q_rad))
    reason = _singular_reason(chain, best.q_rad, T_base_tcp)
    status = InverseStatus.SINGULAR if reason else InverseStatus.OK
    return InverseResult(status, reason, best.q_rad, smallest)


def _check_chain(chain: Chain) -> None:
    if (
        chain.n != 6
        or np.abs(chain.dh_alpha_rad - CLOSED_FORM_DH_ALPHAS_RAD).max() > 1e-9
        or chain.dh_a_m[3:].any()
        or chain.dh_d_m[4] != 0.0
    ):
        raise MachineError(
            "the closed-form inverse needs six joints with the twists of Table 1 (90, 0, 90, 90, -90, 90 deg) and a "
            f"spherical wrist (a4 = a5 = a6 = d5 = 0); alpha is {np.rad2deg(chain.dh_alpha_rad).round(3)} deg, "
            f"a {chain.dh_a_m} m, d {chain.dh_d_m} m"
        )
    if chain.dh_a_m[1] == 0.0 or np.hypot(chain.dh_a_m[2], chain.dh_d_m[3]) == 0.0:
        raise MachineError("the closed-form inverse needs two booms of some length: a2, and a3 or d4, above 0 m")


def _check_pose(T_base_tcp: Array) -> None:
    if T_base_tcp.shape != (4, 4) or not np.isfinite(T_base_tcp).all():
        raise MachineError(f"wanted pose has shape {T_base_tcp.shape} or is not finite; give a finite (4, 4) pose")
    error = float(rotation_fault(np.array(T_base_tcp, dtype=float)))
    if error > ORTHONORMALITY_ERROR_MAX:
        raise MachineError(
            f"wanted pose is not a pose: its rotation departs from orthonormal by {error:.1e} (limit "
            f"{ORTHONORMALITY_ERROR_MAX:.0e}; inf: mirrored); make it a rotation first"
        )


def _checked_near(q_near: Array) -> Array:
    q_near = np.asarray(q_near, dtype=float)
    if q_near.shape != (6,) or not np.isfinite(q_near).all():
        raise MachineError(f"q_near is {q_near}; give six finite joint angles [rad]")
    return q_near


def _joint_limit_excess(chain: Chain, q: Array) -> Array:
    return np.maximum(np.maximum(chain.q_min - q, q - chain.q_max), 0.0)


def _limit_reason(chain: Chain, q: Array) -> str:
    j = int(np.argmax(_joint_limit_excess(chain, q)))
    value, low, high = np.rad2deg([q[j], chain.q_min[j], chain.q_max[j]])
    return (
        f"{chain.joint_label(j)} would have to be at {value:.1f} deg, limits {low:.1f} .. {high:.1f} deg; "
        "move the base or the target, or turn the tool"
    )


def _reach_reason(chain: Chain, T_base_tcp: Array) -> str:
    """The wrist centre's distance from the lift joint against what the two booms can span."""
    T_base_flange = T_base_tcp @ inverse_pose(chain.T_flange_tcp)
    x, y, z = T_base_flange[:3, 3] - chain.dh_d_m[5] * T_base_flange[:3, 1]
    lateral = abs(float(chain.dh_d_m[1] + chain.dh_d_m[2]))
    radius = float(np.hypot(x, y))
    if radius < lateral:
        return (
            f"the wrist centre would be {radius:.3f} m from the slew axis, where the booms, {lateral:.3f} m off it, "
            "cannot come; move the target away from the slew axis"
        )
    ahead = float(np.sqrt(radius * radius - lateral * lateral)) - chain.dh_a_m[0]
    distance = float(np.hypot(ahead, z - chain.dh_d_m[0]))
    forearm = float(np.hypot(chain.dh_a_m[2], chain.dh_d_m[3]))
    shortest, longest = abs(chain.dh_a_m[1] - forearm), chain.dh_a_m[1] + forearm
    remedy = "move the base or the target nearer" if distance > longest else "move the target further away"
    return (
        f"the wrist centre would be {distance:.2f} m from {chain.joint_label(1)}, which spans {shortest:.2f} m and "
        f"reaches at most {longest:.2f} m; {remedy}"
    )


def _singular_reason(chain: Chain, q: Array, T_base_tcp: Array) -> str:
    """Which of the three singularities q is at; empty when at none."""
    theta = q + chain.theta_offset
    if abs(np.sin(theta[4])) < SINGULARITY_SINE_MIN:
        return (
            f"{chain.joint_label(4)} is at {np.rad2deg(q[4]):.3f} deg, where {chain.joint_label(3)} and "
            f"{chain.joint_label(5)} turn about one axis (limit {np.rad2deg(SINGULARITY_SINE_MIN):.3f} deg); "
            "turn the tool out of the tilt boom's line"
        )
    bend = float(np.arctan2(chain.dh_d_m[3], chain.dh_a_m[2]))
    if abs(np.sin(theta[2] - bend)) < SINGULARITY_SINE_MIN:
        return (
            f"{chain.joint_label(2)} is at {np.rad2deg(q[2]):.3f} deg, where the booms are in line (limit "
            f"{np.rad2deg(SINGULARITY_SINE_MIN):.3f} deg from it); move the target nearer to the base"
        )
    T_base_flange = T_base_tcp @ inverse_pose(chain.T_flange_tcp)
    centre = T_base_flange[:2, 3] - chain.dh_d_m[5] * T_base_flange[:2, 1]
    off_axis_m = np.sqrt(max(0.0, float(centre @ centre) - float(chain.dh_d_m[1] + chain.dh_d_m[2]) ** 2))
    if off_axis_m < SINGULARITY_SINE_MIN:
        return (
            f"the wrist centre is {off_axis_m:.5f} m from the slew axis (limit {SINGULARITY_SINE_MIN:g} m), where "
            f"{chain.joint_label(0)} cannot move it sideways; move the target away from the slew axis"
        )
    return ""
