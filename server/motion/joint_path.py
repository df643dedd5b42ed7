"""The shape of a path in joint space, without time: a smooth curve q(s), s from 0 to 1."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from machine.chain import Chain
from machine.description import Machine
from machine.inverse import InverseResult, inverse_all, inverse_nearest
from machine.kinematics import tcp_poses
from machine.poses import pose
from machine.rotations import geodesic_angle, rotation_from_rotvec, rotvec_from_rotation
from server.motion.contracts import Array, PlanStatus
from server.motion.refusal import Refusal, range_refusal
from server.motion.settings import PlanSettings


@dataclass(frozen=True, slots=True)
class JointPath:
    """Samples `qs` (m, joints) [rad] at `path_parameter` (m,), the TCP poses there, and the interpolating
    quintic spline through them."""

    path_parameter: Array
    qs: Array
    Ts_base_tcp: Array
    spline: BSpline

    @property
    def length_m(self) -> float:
        """Length of the TCP's way [m]."""
        return float(np.linalg.norm(np.diff(self.Ts_base_tcp[:, :3, 3], axis=0), axis=1).sum())

    @property
    def turn_rad(self) -> float:
        """Angle that the TCP turns [rad]."""
        Rs = self.Ts_base_tcp[:, :3, :3]
        return float(sum(geodesic_angle(a, b) for a, b in pairwise(Rs)))

    def derivatives(self, s: Array) -> list[Array]:
        """q and its first four derivatives with respect to s, each (n, joints)."""
        return [self.spline(s, nu=order) for order in range(5)]


def straight_poses(T_start: Array, T_end: Array, settings: PlanSettings) -> Array:
    """Poses along a straight line with an evenly turning orientation.

    Model:   p = p0 + s (p1 - p0); R = exp(s log(R1 R0^T)) R0.
    Args:    poses (4, 4) in base.
    Returns: (m, 4, 4), no further apart than the settings' sample distances, both ends included.
    """
    rotvec = rotvec_from_rotation(T_end[:3, :3] @ T_start[:3, :3].T)
    step = T_end[:3, 3] - T_start[:3, 3]
    m = 1 + max(
        12,
        int(np.ceil(np.linalg.norm(step) / settings.sample_m)),
        int(np.ceil(np.linalg.norm(rotvec) / settings.sample_rad)),
    )
    return np.array(
        [
            pose(rotation_from_rotvec(s * rotvec) @ T_start[:3, :3], T_start[:3, 3] + s * step)
            for s in np.linspace(0.0, 1.0, m)
        ]
    )


def _of_samples(chain: Chain, qs: Array) -> JointPath:
    s = np.linspace(0.0, 1.0, len(qs))
    return JointPath(s, qs, tcp_poses(chain, qs), make_interp_spline(s, qs, k=5))


def joint_line(chain: Chain, q_start: Array, q_end: Array) -> JointPath:
    """Every joint straight from start to end."""
    m = 1 + max(12, int(np.ceil(np.abs(q_end - q_start).max() / 0.02)))
    return _of_samples(chain, q_start + np.linspace(0.0, 1.0, m)[:, None] * (q_end - q_start))


def joint_path_along(
    machine: Machine, chain: Chain, q_start: Array, Ts: Array, settings: PlanSettings
) -> JointPath | Refusal:
    """Joint path along TCP poses, on the branch where the machine stands.

    Args:    q_start: joints at the first pose (joints,) [rad]; Ts: (m, 4, 4).
    Returns: the path, its first sample exactly q_start; or why a pose cannot be reached.
    """
    qs = [q_start]
    for k, T in enumerate(Ts[1:], start=1):
        result = inverse_nearest(chain, T, qs[-1])
        if result.q_rad is None or np.abs(result.q_rad - qs[-1]).max() > settings.jump_max_rad:
            return _branch_end(machine, chain, T, qs[-1], result, k / (len(Ts) - 1))
        qs.append(result.q_rad)
    return _of_samples(chain, np.array(qs))


def _branch_end(machine: Machine, chain: Chain, T: Array, q: Array, result: InverseResult, share: float) -> Refusal:
    """Why the present branch cannot be followed to this pose: a joint limit, out of reach, or a singularity."""
    where = f"at {100 * share:.0f} % of the path: "
    branches = inverse_all(chain, T, q)
    if branches:
        nearest = min(branches, key=lambda branch: float(np.abs(branch.q_rad - q).max()))
        beyond = range_refusal(machine, np.array([q, nearest.q_rad]), 0.0)
        if beyond is not None:
            return Refusal(beyond.status, where + beyond.reason)
    if result.q_rad is None:
        known = {each.name: each for each in PlanStatus}
        return Refusal(known.get(result.status.name, PlanStatus.OUT_OF_REACH), where + result.reason)
    jump = np.abs(result.q_rad - q)
    text = (
        f"joint '{machine.joints[int(jump.argmax())].name}' would jump by {np.rad2deg(jump.max()):.1f} deg, "
        "the path passes a singularity; approach from another posture"
    )
    return Refusal(PlanStatus.SINGULAR, where + text)
