"""Closed-form inverse kinematics of a 3R arm with a spherical wrist: eight branches, the nearest inside the limits."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from machine.chain import Chain
from machine.errors import MachineError
from machine.inverse_kernel import rotation_fault, solve_angles, unwrap
from machine.kinematics import sigma_min, tcp_jacobian
from machine.poses import inverse_pose
from machine.rotations import Array

ALPHAS_RAD = np.deg2rad([90.0, 0.0, 90.0, 90.0, -90.0, 90.0])  # the twists of Table 1, which the closed form needs
SINGULAR = 1e-4  # sin of an angle, or [m]; nearer, 1e-6 of noise in the wanted pose turns a joint by half a degree
ROTATION_TOLERANCE = 1e-6  # how far a wanted pose may be from orthonormal


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
    Args:    chain: twists as Table 1. T_base_tcp: wanted pose (4, 4). q_near: (6,) [rad]; middle of the ranges if
             None; at theta5 = 0 it also chooses theta4.
    Returns: up to eight branches; none when out of reach.
    Raises:  MachineError: the chain has other twists, T_base_tcp is not a pose, or q_near is not finite.
    """
    _check_chain(chain)
    _check_pose(T_base_tcp)
    q_near = (chain.q_min + chain.q_max) / 2.0 if q_near is None else _checked_near(q_near)
    T_base_flange = T_base_tcp @ inverse_pose(chain.T_flange_tcp)
    count, thetas = solve_angles(chain.a, chain.d, T_base_flange, q_near + chain.theta_offset)
    qs = thetas[:count] - chain.theta_offset
    inside = unwrap(qs, q_near + 0.0, chain.q_min, chain.q_max)
    return tuple(Branch(q=q, inside_limits=bool(fits)) for q, fits in zip(qs, inside, strict=True))


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
        closest = min(branches, key=lambda branch: _excess(chain, branch.q).max())
        return InverseResult(InverseStatus.JOINT_LIMIT, _limit_reason(chain, closest.q), None, 0.0)
    best = min(inside, key=lambda branch: float(np.abs(branch.q - q_near).max()))
    smallest = sigma_min(tcp_jacobian(chain, best.q))
    reason = _singular_reason(chain, best.q, T_base_tcp)
    status = InverseStatus.SINGULAR if reason else InverseStatus.OK
    return InverseResult(status, reason, best.q, smallest)


def _check_chain(chain: Chain) -> None:
    if chain.n != 6 or np.abs(chain.alpha - ALPHAS_RAD).max() > 1e-9 or chain.a[3:].any() or chain.d[4] != 0.0:
        raise MachineError(
            "the closed-form inverse needs six joints with the twists of Table 1 (90, 0, 90, 90, -90, 90 deg) and a "
            f"spherical wrist (a4 = a5 = a6 = d5 = 0); alpha is {np.rad2deg(chain.alpha).round(3)} deg, "
            f"a {chain.a} m, d {chain.d} m"
        )
    if chain.a[1] == 0.0 or np.hypot(chain.a[2], chain.d[3]) == 0.0:
        raise MachineError("the closed-form inverse needs two booms of some length: a2, and a3 or d4, above 0 m")


def _check_pose(T_base_tcp: Array) -> None:
    if T_base_tcp.shape != (4, 4) or not np.isfinite(T_base_tcp).all():
        raise MachineError(f"wanted pose has shape {T_base_tcp.shape} or is not finite; give a finite (4, 4) pose")
    error = float(rotation_fault(np.array(T_base_tcp, dtype=float)))
    if error > ROTATION_TOLERANCE:
        raise MachineError(
            f"wanted pose is not a pose: its rotation departs from orthonormal by {error:.1e} (limit "
            f"{ROTATION_TOLERANCE:.0e}; inf: mirrored); make it a rotation first"
        )


def _checked_near(q_near: Array) -> Array:
    q_near = np.asarray(q_near, dtype=float)
    if q_near.shape != (6,) or not np.isfinite(q_near).all():
        raise MachineError(f"q_near is {q_near}; give six finite joint angles [rad]")
    return q_near


def _excess(chain: Chain, q: Array) -> Array:
    return np.maximum(np.maximum(chain.q_min - q, q - chain.q_max), 0.0)


def _limit_reason(chain: Chain, q: Array) -> str:
    j = int(np.argmax(_excess(chain, q)))
    value, low, high = np.rad2deg([q[j], chain.q_min[j], chain.q_max[j]])
    return (
        f"{chain.label(j)} would have to be at {value:.1f} deg, limits {low:.1f} .. {high:.1f} deg; "
        "move the base or the target, or turn the tool"
    )


def _reach_reason(chain: Chain, T_base_tcp: Array) -> str:
    """The wrist centre's distance from the lift joint against what the two booms can span."""
    T_base_flange = T_base_tcp @ inverse_pose(chain.T_flange_tcp)
    x, y, z = T_base_flange[:3, 3] - chain.d[5] * T_base_flange[:3, 1]
    lateral = abs(float(chain.d[1] + chain.d[2]))
    radius = float(np.hypot(x, y))
    if radius < lateral:
        return (
            f"the wrist centre would be {radius:.3f} m from the slew axis, where the booms, {lateral:.3f} m off it, "
            "cannot come; move the target away from the slew axis"
        )
    ahead = float(np.sqrt(radius * radius - lateral * lateral)) - chain.a[0]
    distance = float(np.hypot(ahead, z - chain.d[0]))
    forearm = float(np.hypot(chain.a[2], chain.d[3]))
    shortest, longest = abs(chain.a[1] - forearm), chain.a[1] + forearm
    remedy = "move the base or the target nearer" if distance > longest else "move the target further away"
    return (
        f"the wrist centre would be {distance:.2f} m from {chain.label(1)}, which spans {shortest:.2f} m and "
        f"reaches at most {longest:.2f} m; {remedy}"
    )


def _singular_reason(chain: Chain, q: Array, T_base_tcp: Array) -> str:
    """Which of the three singularities q is at; empty when at none."""
    theta = q + chain.theta_offset
    if abs(np.sin(theta[4])) < SINGULAR:
        return (
            f"{chain.label(4)} is at {np.rad2deg(q[4]):.3f} deg, where {chain.label(3)} and {chain.label(5)} turn "
            f"about one axis (limit {np.rad2deg(SINGULAR):.3f} deg); turn the tool out of the tilt boom's line"
        )
    bend = float(np.arctan2(chain.d[3], chain.a[2]))
    if abs(np.sin(theta[2] - bend)) < SINGULAR:
        return (
            f"{chain.label(2)} is at {np.rad2deg(q[2]):.3f} deg, where the booms are in line (limit "
            f"{np.rad2deg(SINGULAR):.3f} deg from it); move the target nearer to the base"
        )
    T_base_flange = T_base_tcp @ inverse_pose(chain.T_flange_tcp)
    centre = T_base_flange[:2, 3] - chain.d[5] * T_base_flange[:2, 1]
    off_axis_m = np.sqrt(max(0.0, float(centre @ centre) - float(chain.d[1] + chain.d[2]) ** 2))
    if off_axis_m < SINGULAR:
        return (
            f"the wrist centre is {off_axis_m:.5f} m from the slew axis (limit {SINGULAR:g} m), where "
            f"{chain.label(0)} cannot move it sideways; move the target away from the slew axis"
        )
    return ""
