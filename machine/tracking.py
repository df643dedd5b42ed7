"""Resolved-rate tracking (paper eq. 3-5), damped only in the directions that a singularity takes away."""

from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np

from machine.chain import Chain
from machine.errors import MachineError
from machine.kinematics import tcp_jacobian, tcp_pose
from machine.rotations import Array, rotvec_from_rotation

LIMIT_TOLERANCE_RAD = 1e-9  # rounding


class TrackStatus(Enum):
    """How following a path ended."""

    OK = "ok"
    JOINT_LIMIT = "joint_limit"
    SINGULAR = "singular"
    OFF_PATH = "off_path"


@dataclass(frozen=True, slots=True)
class TrackingGains:
    """Feedback gains of eq. 4 [1/s]; damping that begins below a singular value and grows with the error.

    `sigma_damped` 0.05 is the wrist 5 deg from singular. `damping` bounds joint speed there to about
    tcp speed / (2 damping); `damping_per_error` adds to its square per squared error ([m], [rad]; 1 m counts as 1 rad).
    """

    k_position: float = 8.0
    k_rotation: float = 8.0
    sigma_damped: float = 0.05
    damping: float = 0.03
    damping_per_error: float = 1.0


@dataclass(frozen=True, slots=True)
class TrackingTolerance:
    """Largest distance from the path that still counts as following it."""

    position_m: float = 1e-3
    rotation_rad: float = float(np.deg2rad(0.1))


@dataclass(frozen=True, slots=True)
class TrackedPath:
    """Joints (m, n) [rad] along a path, the Jacobian's smallest singular value (m,) there, and how it ended.

    A path that could not be followed is still given whole, with the status and the reason of its first fault.
    """

    qs: Array
    sigma_min: Array
    position_error_max_m: float
    rotation_error_max_rad: float
    status: TrackStatus
    reason: str


def pose_error(T_base_now: Array, T_base_wanted: Array) -> tuple[Array, Array]:
    """Position error (3,) [m] and rotation error (3,) [rad], both in base axes (the delta r of eq. 4)."""
    rotation = T_base_wanted[:3, :3] @ T_base_now[:3, :3].T
    return T_base_wanted[:3, 3] - T_base_now[:3, 3], rotvec_from_rotation(rotation)


def joint_rates(J: Array, twist: Array, error2: float, gains: TrackingGains) -> tuple[Array, float]:
    """Joint rates (n,) [rad/s] for a tcp twist (6,), and the smallest singular value.

    Model:   J = sum s_i u_i v_i^T; qd = sum s_i / (s_i^2 + l_i^2) v_i u_i^T twist, l_i = 0 where s_i >= sigma_damped,
             else l_i^2 = (1 - (s_i/sigma_damped)^2) (damping^2 + damping_per_error |error|^2). Away from singularities
             this is J^-1 exactly; near one only the lost direction lags.
    Source:  paper eq. 3; numerical filtering and error-scaled damping.
    """
    u, s, vt = np.linalg.svd(J, full_matrices=False)
    share = np.maximum(0.0, 1.0 - (s / gains.sigma_damped) ** 2)
    damping2 = share * (gains.damping**2 + gains.damping_per_error * error2)
    return vt.T @ (s / (s * s + damping2) * (u.T @ twist)), float(s[-1])  # eq. 3


def track_step(chain: Chain, q: Array, T_des: Array, v_des: Array, dt_s: float, gains: TrackingGains) -> Array:
    """Joints one step later.

    Model:   qd = J^-1 [v_d + Kp (p_d - p); w_d + Kr dr], q(t + dt) = q + qd dt; J^-1 damped as `joint_rates`.
    Args:    q: (n,) [rad]. T_des: T_base_tcp wanted now (4, 4). v_des: its twist (6,), linear [m/s] then angular
             [rad/s], base axes. dt_s: [s]; keep gain * dt below 1.
    Returns: joints (n,) [rad]; limits are the caller's business.
    Raises:  MachineError: wrong shapes, or q not finite.
    Source:  paper eq. 3-5.
    """
    return _step(chain, q, T_des, v_des, dt_s, gains)[0]


def _step(chain: Chain, q: Array, T_des: Array, v_des: Array, dt_s: float, gains: TrackingGains) -> tuple[Array, float]:
    if T_des.shape != (4, 4) or np.shape(v_des) != (6,) or chain.n != 6:
        raise MachineError(
            f"tracking needs a 6-joint chain, a pose (4, 4) and a twist (6,); got {chain.n} joints, "
            f"{T_des.shape} and {np.shape(v_des)}"
        )
    position, rotation = pose_error(tcp_pose(chain, q), T_des)
    wanted = v_des + np.concatenate([gains.k_position * position, gains.k_rotation * rotation])  # eq. 4
    error2 = float(position @ position + rotation @ rotation)
    rates, smallest = joint_rates(tcp_jacobian(chain, q), wanted, error2, gains)
    return q + rates * dt_s, smallest  # eq. 5


def track_path(
    chain: Chain,
    q_start: Array,
    Ts_base_tcp: Array,
    dt_s: float,
    gains: TrackingGains | None = None,
    tolerance: TrackingTolerance | None = None,
) -> TrackedPath:
    """Follow a timed path by resolved rates.

    Args:    q_start: (6,) [rad], at the first pose. Ts_base_tcp: (m, 4, 4), one pose every dt_s [s].
    Returns: joints at every pose; status JOINT_LIMIT, SINGULAR or OFF_PATH with joint, value, limit, unit and remedy.
    Raises:  MachineError: the start is further off the first pose than the tolerance, or shapes are wrong.
    """
    gains, tolerance = gains or TrackingGains(), tolerance or TrackingTolerance()
    _check_path(Ts_base_tcp, dt_s)
    _check_start(chain, q_start, Ts_base_tcp[0], tolerance)
    qs, smallest = [np.array(q_start, dtype=float)], []
    for now, following in pairwise(Ts_base_tcp):
        twist = np.concatenate(pose_error(now, following)) / dt_s
        q_next, sigma = _step(chain, qs[-1], now, twist, dt_s, gains)
        qs.append(q_next)
        smallest.append(sigma)
    smallest.append(float(np.linalg.svd(tcp_jacobian(chain, qs[-1]), compute_uv=False)[-1]))
    track, sigmas = np.array(qs), np.array(smallest)
    errors = [pose_error(tcp_pose(chain, q), T) for q, T in zip(qs, Ts_base_tcp, strict=True)]
    off_m, off_rad = (np.array([float(np.linalg.norm(error[part])) for error in errors]) for part in (0, 1))
    status, reason = _judge(chain, track, sigmas, off_m, off_rad, gains, tolerance)
    return TrackedPath(track, sigmas, float(off_m.max()), float(off_rad.max()), status, reason)


def _check_path(Ts_base_tcp: Array, dt_s: float) -> None:
    if Ts_base_tcp.ndim != 3 or Ts_base_tcp.shape[1:] != (4, 4) or not np.isfinite(Ts_base_tcp).all():
        raise MachineError(f"path has shape {Ts_base_tcp.shape} or is not finite; give poses (m, 4, 4)")
    if not len(Ts_base_tcp) or dt_s <= 0.0:
        raise MachineError(f"path has {len(Ts_base_tcp)} poses every {dt_s} s; give at least one, and a time above 0 s")


def _check_start(chain: Chain, q_start: Array, T_base_first: Array, tolerance: TrackingTolerance) -> None:
    position, rotation = (float(np.linalg.norm(e)) for e in pose_error(tcp_pose(chain, q_start), T_base_first))
    if position > tolerance.position_m or rotation > tolerance.rotation_rad:
        raise MachineError(
            f"tracking starts {position * 1e3:.2f} mm and {np.rad2deg(rotation):.2f} deg off the path (limits "
            f"{tolerance.position_m * 1e3:g} mm, {np.rad2deg(tolerance.rotation_rad):g} deg); start the path where the "
            "machine stands"
        )


def _judge(
    chain: Chain,
    qs: Array,
    sigmas: Array,
    off_m: Array,
    off_rad: Array,
    gains: TrackingGains,
    tolerance: TrackingTolerance,
) -> tuple[TrackStatus, str]:
    """The first fault along a path."""
    excess = np.maximum(chain.q_min - qs, qs - chain.q_max)
    beyond = excess.max(axis=1) > LIMIT_TOLERANCE_RAD
    off = (off_m > tolerance.position_m) | (off_rad > tolerance.rotation_rad)
    if not (beyond | off).any():
        return TrackStatus.OK, ""
    k = int(np.argmax(beyond | off))
    where = f"at {100.0 * k / max(1, len(qs) - 1):.0f} % of the path"
    if beyond[k]:
        j = int(np.argmax(excess[k]))
        value, low, high = np.rad2deg([qs[k, j], chain.q_min[j], chain.q_max[j]])
        text = f"{chain.label(j)} would be at {value:.1f} deg, limits {low:.1f} .. {high:.1f} deg"
        return TrackStatus.JOINT_LIMIT, f"{text} {where}; start from another posture or shorten the path"
    text = (
        f"the tcp is {off_m[k] * 1e3:.2f} mm and {np.rad2deg(off_rad[k]):.2f} deg off the path {where}, tolerance "
        f"{tolerance.position_m * 1e3:g} mm and {np.rad2deg(tolerance.rotation_rad):g} deg"
    )
    low = float(sigmas[: k + 1].min())
    if low < gains.sigma_damped:
        text += f", after the smallest singular value fell to {low:.4f}, limit {gains.sigma_damped:g}"
        return TrackStatus.SINGULAR, f"{text}; bend the wrist more by another boom posture"
    return TrackStatus.OFF_PATH, f"{text}; drive slower or sample the path more finely"
