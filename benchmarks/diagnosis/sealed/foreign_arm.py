"""The true arm of the foreign plant behind its joints: own forward kinematics, effects as their definitions say."""

from dataclasses import dataclass

import numpy as np

from benchmarks.diagnosis.sealed import foreign_geometry as g
from benchmarks.diagnosis.sealed import foreign_machine as m
from benchmarks.diagnosis.sealed import foreign_numbers as k
from benchmarks.diagnosis.sealed.faults import Faults
from machine.rotations import Array, rotation_about, rotation_from_rotvec

GRAVITY = np.array([0.0, 0.0, -k.GRAVITY])


@dataclass(frozen=True)
class ForeignArm:
    """Lengths (3,), axis tilts (3, 3, 3), sag (3,) [rad/(N m)], base rotation and compliance, payload."""

    a: Array
    d: Array
    tilts: Array
    sag: Array
    R_base: Array
    base_compliance: float
    payload_kg: float

    def points(self, tree_q: Array) -> dict[str, Array]:
        """Every tracked point in base (3,) [m], at tree angles (7,)."""
        links = self._links(tree_q)
        return {
            name: links[link][:3, :3] @ np.array(xyz) + links[link][:3, 3] for name, (link, xyz) in m.POINTS.items()
        }

    def tcp(self, tree_q: Array) -> Array:
        """T_base_tcp (4, 4) at tree angles (7,)."""
        return self._links(tree_q)[3] @ m.T_flange_tcp()

    def _links(self, tree_q: Array) -> list[Array]:
        """T_base_link of the base and the three links, bent and leaning."""
        q = tree_q[[0, 2, 4]] + tree_q[[1, 3, 5]]
        if not (self.sag.any() or self.base_compliance):
            return self.chain(q, self.R_base)[0]
        links, axes = self.chain(q, self.R_base)
        torques, moment = self.weights(links, axes)
        lean = rotation_from_rotvec(self.base_compliance * moment)
        return self.chain(q + self.sag * torques, lean @ self.R_base)[0]

    def chain(self, q: Array, R: Array) -> tuple[list[Array], list[Array]]:
        """Links from a base turned by R; before each joint's motion its frame (its axis is z)."""
        T = _pose(R, np.zeros(3))
        links, axes = [T], []
        for i, (_, _, alpha, offset) in enumerate(m.LENGTHS):
            T = T @ _pose(self.tilts[i], np.zeros(3))
            axes.append(T)
            T = T @ _pose(g.turn(float(q[i]) + np.deg2rad(offset)), np.zeros(3))
            T = T @ _pose(rotation_about("x", float(np.deg2rad(alpha))), np.array([self.a[i], 0.0, self.d[i]]))
            links.append(T)
        return links, axes

    def weights(self, links: list[Array], axes: list[Array]) -> tuple[Array, Array]:
        """Torque of the nominal weights and the payload about each joint (3,), moment about the base's origin (3,)."""
        loads = [(mass, links[i + 1][:3, :3] @ com + links[i + 1][:3, 3]) for i, (mass, com) in enumerate(m.bodies())]
        loads.append((self.payload_kg, (links[3] @ m.T_flange_tcp())[:3, 3]))
        torques, moment = np.zeros(3), np.zeros(3)
        for link, (mass, at) in enumerate(loads):
            moment += np.cross(at, mass * GRAVITY)
            for i in range(min(link + 1, 3)):
                torques[i] += axes[i][:3, 2] @ np.cross(at - axes[i][:3, 3], mass * GRAVITY)
        return torques, moment


def _pose(R: Array, p: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


def arm_of(faults: Faults) -> ForeignArm:
    """With lengths, axis tilts, sag, base tilt and base compliance of the injected effects."""
    a, d = np.array([row[0] for row in m.LENGTHS]), np.array([row[1] for row in m.LENGTHS])
    tilts, sag, R_base, compliance = np.stack([np.eye(3)] * 3), np.zeros(3), np.eye(3), 0.0
    for one in faults.injected:
        if one.name == "link_length_error" and one.joint is not None:
            (d if one.option == "d" else a)[one.joint - 1] += one.size
        elif one.name == "gravity_sag" and one.joint is not None:
            sag[one.joint - 1] += one.size
        elif one.name == "joint_axis_tilt" and one.joint is not None:
            tilts[one.joint - 1] = tilts[one.joint - 1] @ rotation_about(one.option or "x", one.size)
        elif one.name == "base_tilt":
            R_base = rotation_from_rotvec(one.size * np.array(one.direction))
        elif one.name == "base_compliance":
            compliance = one.size
    return ForeignArm(a, d, tilts, sag, R_base, compliance, faults.of("payload_error"))
