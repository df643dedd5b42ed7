"""The third plant's arm, from the contract alone: DH rows, masses, and the pose of the tip with all structural effects.

Links are numbered from the base. Angles here are those of the link side, behind encoder and backlash.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

Array = npt.NDArray[Any]
REFERENCE_POSTURES = 2048  # over which a joint's reference torque is the largest (definition of the catalogue)


@dataclass(frozen=True)
class Arm:
    """One arm: DH rows (n, 4) a, d, alpha, offset; tilts (n, 3, 3) before each joint's motion; bending; masses."""

    rows: Array
    tilts: Array
    sag: Array
    R_base: Array
    base_compliance: float
    mass: Array
    com: Array
    payload_kg: float
    T_flange_tcp: Array
    gravity: Array

    def packed(self) -> tuple[Any, ...]:
        """The fields in the order that the compiled functions take."""
        return (
            self.rows, self.tilts, self.sag, self.R_base, self.base_compliance, self.mass, self.com, self.payload_kg,
            self.T_flange_tcp, self.gravity,
        )  # fmt: skip

    def frames(self, q: Array) -> Array:
        """T_base_link_i for i = 1..n and T_base_tcp last (m, n + 1, 4, 4) at link-side angles q (m, n)."""
        return frames_at(np.ascontiguousarray(q, dtype=float), *self.packed())

    def points(self, q: Array, where: tuple[tuple[int, Array], ...]) -> Array:
        """Positions in base (m, p, 3) [m] of points (joint from 1, place in that link's frame)."""
        T = self.frames(q)
        return np.stack([T[:, joint - 1, :3, :3] @ place + T[:, joint - 1, :3, 3] for joint, place in where], axis=1)


def rotation(axis: Array, angle: float) -> Array:
    """Rotation matrix (3, 3) about a unit axis (Rodrigues)."""
    x, y, z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)


def arm_of(machine: dict[str, Any], effects: list[dict[str, Any]]) -> Arm:
    """The arm of a machine file (as parsed) with the structural effects of a list of entries."""
    joints = machine["joint"]
    n = len(joints)
    rows = np.array(
        [(j["a_m"], j["d_m"], np.deg2rad(j["alpha_deg"]), np.deg2rad(j["theta_offset_deg"])) for j in joints]
    )
    tilts, sag, R_base, compliance, payload = np.stack([np.eye(3)] * n), np.zeros(n), np.eye(3), 0.0, 0.0
    for effect in effects:
        values, i = effect["parameters"], (effect["joint"] or 0) - 1
        if effect["name"] == "link_length_error":
            rows[i, 0 if values["of"] == "a" else 1] += values["error_m"]
        elif effect["name"] == "joint_axis_tilt":
            axis = np.array([1.0, 0.0, 0.0]) if values["about"] == "x" else np.array([0.0, 1.0, 0.0])
            tilts[i] = tilts[i] @ rotation(axis, values["tilt_rad"])
        elif effect["name"] == "gravity_sag":
            sag[i] += values["compliance_rad_nm"]
        elif effect["name"] == "base_tilt":
            R_base = R_base @ rotation(np.array(values["axis"]), values["tilt_rad"])
        elif effect["name"] == "base_compliance":
            compliance += values["compliance_rad_nm"]
        elif effect["name"] == "payload_error":
            payload += values["mass_kg"]
    mass = np.array([float(j["mass_kg"]) for j in joints])
    com = np.array([j["com_m"] for j in joints], dtype=float)
    T_flange_tcp = np.array(machine["tool"]["T_flange_tcp"], dtype=float).reshape(4, 4)
    gravity = np.array(machine["machine"]["gravity_base_m_s2"], dtype=float)
    return Arm(rows, tilts, sag, R_base, compliance, mass, com, payload, T_flange_tcp, gravity)


@njit(cache=True)
def _chain(q, rows, tilts, R_base, T_flange_tcp, links, axes):
    """Fill links (n + 1, 4, 4), the tcp last, and axes (n, 2, 3): direction and a point of each joint's axis."""
    n = rows.shape[0]
    R, p = R_base.copy(), np.zeros(3)
    for i in range(n):
        R = R @ tilts[i]
        axes[i, 0], axes[i, 1] = R[:, 2], p
        theta, alpha = q[i] + rows[i, 3], rows[i, 2]
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        p = p + R @ np.array([rows[i, 0] * c, rows[i, 0] * s, rows[i, 1]])
        R = R @ np.array([[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0.0, sa, ca]])
        links[i, :3, :3], links[i, :3, 3] = R, p
    links[n, :3, :3] = R @ np.ascontiguousarray(T_flange_tcp[:3, :3])
    links[n, :3, 3] = p + R @ np.ascontiguousarray(T_flange_tcp[:3, 3])


@njit(cache=True)
def _weights(links, axes, mass, com, payload_kg, gravity, torque):
    """Fill torque (n,), gravity's about each joint's axis [N m]; return gravity's moment about the base's origin."""
    n = mass.shape[0]
    moment = np.zeros(3)
    torque[:] = 0.0
    for k in range(n + 1):
        if k < n:
            at = links[k, :3, 3] + np.ascontiguousarray(links[k, :3, :3]) @ com[k]
            weight = mass[k] * gravity
        else:
            at = links[n, :3, 3].copy()
            weight = payload_kg * gravity
        moment += np.cross(at, weight)
        for i in range(min(k + 1, n)):
            torque[i] += np.dot(axes[i, 0], np.cross(at - axes[i, 1], weight))
    return moment


@njit(cache=True)
def frames_at(q, rows, tilts, sag, R_base, base_compliance, mass, com, payload_kg, T_flange_tcp, gravity):
    """Link frames and the tcp (m, n + 1, 4, 4), bent by gravity's torques in the unbent posture."""
    m, n = q.shape
    out = np.zeros((m, n + 1, 4, 4))
    axes, torque = np.zeros((n, 2, 3)), np.zeros(n)
    for k in range(m):
        for i in range(n + 1):
            out[k, i, 3, 3] = 1.0
        _chain(q[k], rows, tilts, R_base, T_flange_tcp, out[k], axes)
        moment = _weights(out[k], axes, mass, com, payload_kg, gravity, torque)
        lean = R_base
        turn = base_compliance * moment
        angle = np.sqrt(np.sum(turn**2))
        if angle > 0.0:
            x, y, z = turn / angle
            K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            lean = (np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)) @ R_base
        if angle > 0.0 or np.any(sag != 0.0):
            _chain(q[k] + sag * torque, rows, tilts, lean, T_flange_tcp, out[k], axes)
    return out


@njit(cache=True)
def torques_at(q, rows, tilts, sag, R_base, base_compliance, mass, com, payload_kg, T_flange_tcp, gravity):
    """Gravity's torque about each joint (m, n) [N m] at angles q (m, n), unbent."""
    m, n = q.shape
    out = np.zeros((m, n))
    links, axes = np.zeros((n + 1, 4, 4)), np.zeros((n, 2, 3))
    for k in range(m):
        _chain(q[k], rows, tilts, R_base, T_flange_tcp, links, axes)
        _weights(links, axes, mass, com, payload_kg, gravity, out[k])
    return out


def reference_torques(arm: Arm, low: Array, high: Array) -> Array:
    """Largest torque of each joint over its range (n,) [N m]; 0 where gravity never loads it."""
    q = np.random.default_rng(2048).uniform(low, high, (REFERENCE_POSTURES, len(low)))
    largest = np.abs(torques_at(q, *arm.packed())).max(axis=0)
    return np.where(largest > 1e-6 * largest.max(), largest, 0.0)
