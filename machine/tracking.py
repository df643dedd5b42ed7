"""Resolved-rate tracking (paper eq. 3-5), damped near the wrist singularity."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from machine.chain import Chain
from machine.errors import MachineError
from machine.kinematics import sigma_min, tcp_jacobian, tcp_pose
from machine.rotations import Array, rotvec_from_rotation


@dataclass(frozen=True, slots=True)
class TrackingGains:
    """Feedback gains of eq. 4 [1/s] and the damping that grows with the error near a singularity."""

    k_position: float = 8.0
    k_rotation: float = 8.0
    damping: float = 1e-3


@dataclass(frozen=True, slots=True)
class TrackedPath:
    """Joints (m, n) along a path, smallest singular value at each sample, and the largest pose errors left."""

    qs: Array
    sigma_min: Array
    position_error_max_m: float
    rotation_error_max_rad: float


def pose_error(T_base_now: Array, T_base_wanted: Array) -> tuple[Array, Array]:
    """Position error (3,) [m] and rotation error (3,) [rad], both in base axes (the delta r of eq. 4)."""
    rotation = T_base_wanted[:3, :3] @ T_base_now[:3, :3].T
    return T_base_wanted[:3, 3] - T_base_now[:3, 3], rotvec_from_rotation(rotation)


def track_step(
    chain: Chain, q: Array, T_base_wanted: Array, twist_base: Array, dt_s: float, gains: TrackingGains
) -> Array:
    """Joints one step later.

    Model:   qd = J^-1 [v + Kp (p_d - p); w + Kr dr] (eq. 4), q(t + dt) = q + qd dt (eq. 5); J^-1 is damped least
             squares with lambda = damping * |error|^2, so it is exact on the path and bounded off it at a singularity.
    Args:    q: (n,) [rad]. T_base_wanted: (4, 4). twist_base: (6,) linear [m/s] then angular [rad/s]. dt_s: [s].
    Returns: joints (n,) [rad].
    """
    position, rotation = pose_error(tcp_pose(chain, q), T_base_wanted)
    wanted = twist_base + np.concatenate([gains.k_position * position, gains.k_rotation * rotation])
    J = tcp_jacobian(chain, q)
    error2 = float(position @ position + rotation @ rotation)
    normal = J @ J.T + (gains.damping * error2 + 1e-12) * np.eye(6)
    return q + J.T @ np.linalg.solve(normal, wanted) * dt_s  # eq. 3, 5


def track_path(
    chain: Chain, q_start: Array, Ts_base_tcp: Array, dt_s: float, gains: TrackingGains | None = None
) -> TrackedPath:
    """Follow poses (m, 4, 4) sampled every dt_s from q_start, which must be at the first pose.

    Raises: MachineError when the start is more than 1 mm or 0.1 deg off the first pose.
    """
    used = gains or TrackingGains()
    position, rotation = pose_error(tcp_pose(chain, q_start), Ts_base_tcp[0])
    if np.linalg.norm(position) > 1e-3 or np.linalg.norm(rotation) > np.deg2rad(0.1):
        off_mm, off_deg = np.linalg.norm(position) * 1e3, np.rad2deg(np.linalg.norm(rotation))
        raise MachineError(
            f"tracking starts {off_mm:.2f} mm and {off_deg:.2f} deg off the path (limits 1 mm, 0.1 deg); start the path where the machine stands"
        )
    qs, smallest, worst_m, worst_rad = [np.array(q_start)], [], 0.0, 0.0
    for now, following in pairwise(Ts_base_tcp):
        shift, turn = pose_error(now, following)
        twist = np.concatenate([shift, turn]) / dt_s
        qs.append(track_step(chain, qs[-1], now, twist, dt_s, used))
        smallest.append(sigma_min(tcp_jacobian(chain, qs[-1])))
        off_m, off_rad = (float(np.linalg.norm(part)) for part in pose_error(tcp_pose(chain, qs[-1]), following))
        worst_m, worst_rad = max(worst_m, off_m), max(worst_rad, off_rad)
    return TrackedPath(np.array(qs), np.array(smallest), worst_m, worst_rad)
