"""An arm of any number of joints as plain arrays: classic DH and modified DH (URDF: `arm_urdf`), all in one form."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from machine.description import Machine
from machine.errors import MachineError
from machine.poses import pose
from machine.rotations import Array, rotation_about

Convention = Literal["classic", "modified"]


@dataclass(frozen=True, slots=True)
class Arm:
    """T_base_link_i = T_base_link_(i-1) before_i motion_i(q_i) after_i; motion about (or, prismatic, along) z.

    `before`, `after`: (n, 4, 4). `q_offset`: added to q (n,). `motion_factor`: on q_offset + q (n,): 1, -1 where
    a URDF's joint is passed from child to parent, 0 where a joint is not in the chain. `prismatic`: 1.0 or 0.0 (n,).
    `length_before`, `length_after`: where an error of the DH length a (row 0) and d (row 1) enters, unit vectors or
    zero (n, 2, 3).
    `mass`: (n,) [kg], `com`: (n, 3) [m] in link frames. `gravity`: (3,) in an upright base. `T_flange_tcp`: (4, 4).
    """

    before: Array
    after: Array
    q_offset: Array
    motion_factor: Array
    prismatic: Array
    length_before: Array
    length_after: Array
    mass: Array
    com: Array
    gravity: Array
    T_flange_tcp: Array

    def __post_init__(self) -> None:
        """Copy the arrays in, read-only, and refuse wrong shapes and values."""
        n = len(self.before)
        per_joint = {"before": (4, 4), "after": (4, 4), "length_before": (2, 3), "length_after": (2, 3), "com": (3,)}
        for field in fields(self):
            array = np.array(getattr(self, field.name), dtype=float, order="C")
            own = {"gravity": (3,), "T_flange_tcp": (4, 4)}.get(field.name)
            wanted = own if own is not None else (n, *per_joint.get(field.name, ()))
            if array.shape != wanted or not np.isfinite(array).all():
                raise MachineError(f"arm: {field.name} has shape {array.shape}; give finite values of shape {wanted}")
            array.setflags(write=False)
            object.__setattr__(self, field.name, array)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.before)


def gravity_torque_bound_nm(arm: Arm) -> float:
    """Torque [N m] of all masses at the whole length of an arm: the most that gravity could do to it."""
    links = np.linalg.norm((arm.before @ arm.after)[:, :3, 3], axis=1)
    length_m = float(links.sum()) + float(np.linalg.norm(arm.T_flange_tcp[:3, 3]))
    return float(arm.mass.sum()) * float(np.linalg.norm(arm.gravity)) * length_m


@dataclass(frozen=True, slots=True)
class DhRow:
    """One joint of a DH table; modified rows hold a_(i-1), alpha_(i-1) of Craig's table."""

    a_m: float
    d_m: float
    alpha_rad: float
    theta_offset_rad: float
    prismatic: bool = False
    convention: Convention = "classic"


def arm_from_dh(
    rows: Sequence[DhRow],
    T_flange_tcp: Array | None = None,
    mass: Array | None = None,
    com: Array | None = None,
    gravity: Array | None = None,
) -> Arm:
    """An arm from its DH table.

    Model:  classic: Rz(theta) Tz(d) Tx(a) Rx(alpha); modified: Rx(alpha) Tx(a) Rz(theta) Tz(d). A prismatic joint adds
            q to d and keeps theta_offset as its fixed theta.
    Source: paper eq. 24; Craig, Introduction to Robotics, eq. 3.6.
    """
    n = len(rows)
    before, after = np.tile(np.eye(4), (n, 1, 1)), np.tile(np.eye(4), (n, 1, 1))
    length_before, length_after = np.zeros((n, 2, 3)), np.zeros((n, 2, 3))
    zero = np.zeros(n)
    for i, row in enumerate(rows):
        slide = pose(rotation_about("x", row.alpha_rad), np.array([row.a_m, 0.0, 0.0]))
        lift = pose(np.eye(3), np.array([0.0, 0.0, row.d_m]))
        turn = pose(rotation_about("z", row.theta_offset_rad), np.zeros(3)) if row.prismatic else np.eye(4)
        zero[i] = 0.0 if row.prismatic else row.theta_offset_rad
        length_after[i, 1, 2] = 1.0
        if row.convention == "modified":
            before[i], after[i], length_before[i, 0, 0] = slide, lift @ turn, 1.0
        else:
            after[i] = turn @ lift @ slide
            length_after[i, 0] = turn[:3, 0]
    prismatic = np.array([float(row.prismatic) for row in rows])
    return Arm(
        before,
        after,
        zero,
        np.ones(n),
        prismatic,
        length_before,
        length_after,
        np.zeros(n) if mass is None else mass,
        np.zeros((n, 3)) if com is None else com,
        np.array([0.0, 0.0, -9.81]) if gravity is None else gravity,
        np.eye(4) if T_flange_tcp is None else T_flange_tcp,
    )


def arm_of(machine: Machine) -> Arm:
    """The arm of a machine."""
    joints = machine.joints
    return arm_from_dh(
        [DhRow(j.a_m, j.d_m, j.alpha_rad, j.theta_offset_rad) for j in joints],
        machine.T_flange_tcp,
        np.array([j.mass_kg for j in joints]),
        np.array([j.com_m for j in joints]),
        machine.gravity_base_m_s2,
    )
