"""The true machine as a serial tree: six motor joints and five passive flexible joints, in kinematic order."""

from dataclasses import dataclass

import numpy as np

from machine.poses import inverse_pose, pose
from machine.rotations import Array, rotation_about
from sim_plc.plant.truth import InertiaTruth, KinematicTruth

# From the base: slew, lift, lift vertical, lift lateral, tilt, tilt vertical, tilt lateral, wrist mount, wrist 1, 2, 3
MOTOR_JOINT_INDICES = np.array([0, 1, 4, 8, 9, 10])
FLEX_JOINT_INDICES = np.array([2, 3, 5, 6, 7])
N_TREE_JOINTS = 11
_BODY_OF_LINK = (
    0,
    3,
    6,
    8,
    9,
    10,
)  # the joint whose body carries link i's mass: booms hang on their lateral flexible joint


@dataclass(frozen=True, slots=True)
class Tree:
    """Fixed transforms between joint frames and body inertias, in joint frames; `T_last_tcp` closes the chain."""

    tree_R: Array  # (11, 3, 3)
    tree_p: Array  # (11, 3)
    T_last_tcp: Array
    mass_kg: Array
    com_m: Array
    inertia_kg_m2: Array
    armature_kg_m2: Array


def _axis_rotation_pose(axis: str, angle_rad: float) -> Array:
    return pose(rotation_about(axis, angle_rad), np.zeros(3))


def _dh_rest(kinematics: KinematicTruth, i: int) -> Array:
    """DH transform of link i without its rotation: Tz(d) Tx(a) Rx(alpha)."""
    offset = np.array([kinematics.a_m[i], 0.0, kinematics.d_m[i]])
    return pose(rotation_about("x", float(kinematics.alpha_rad[i])), offset)


def build_tree(kinematics: KinematicTruth, inertia: InertiaTruth) -> Tree:
    """Tree whose pose at zero flexible angles is the DH chain of the six motor angles.

    Model:   every joint turns about the z axis of its own frame. Vertical bending shares the axis of lift or tilt,
             lateral bending is across it and across the boom, the wrist mount bends vertically at d4 along the boom.
    """
    rest = [_dh_rest(kinematics, i) for i in range(6)]
    zero = [_axis_rotation_pose("z", float(angle)) for angle in kinematics.theta_zero_rad]
    to_y, to_x = (
        _axis_rotation_pose("x", -np.pi / 2),
        _axis_rotation_pose("y", np.pi / 2),
    )  # put z on the old y, on the old x
    along_boom = pose(np.eye(3), np.array([0.0, 0.0, kinematics.d_m[3]]))
    wrist_rest = inverse_pose(along_boom) @ rest[3]
    steps = [
        zero[0],
        rest[0] @ zero[1],
        np.eye(4),
        to_y,
        inverse_pose(to_y) @ rest[1] @ zero[2],
        np.eye(4),
        to_x,
        inverse_pose(to_x) @ rest[2] @ along_boom @ to_y,
        inverse_pose(to_y) @ zero[3],
        wrist_rest @ zero[4],
        rest[4] @ zero[5],
    ]
    links = [rest[0], inverse_pose(to_y) @ rest[1], inverse_pose(to_x) @ rest[2], wrist_rest, rest[4], rest[5]]
    mass, com, moments = np.zeros(N_TREE_JOINTS), np.zeros((N_TREE_JOINTS, 3)), np.zeros((N_TREE_JOINTS, 3, 3))
    for link, (body, T_joint_link) in enumerate(zip(_BODY_OF_LINK, links, strict=True)):
        rotation = T_joint_link[:3, :3]
        mass[body] = inertia.mass_kg[link]
        com[body] = rotation @ inertia.com_m[link] + T_joint_link[:3, 3]
        moments[body] = rotation @ inertia.inertia_com_kg_m2[link] @ rotation.T
    armature = np.zeros(N_TREE_JOINTS)
    armature[MOTOR_JOINT_INDICES] = inertia.armature_kg_m2
    return Tree(
        tree_R=np.array([step[:3, :3] for step in steps]),
        tree_p=np.array([step[:3, 3] for step in steps]),
        T_last_tcp=rest[5] @ kinematics.T_flange_tcp,
        mass_kg=mass,
        com_m=com,
        inertia_kg_m2=moments,
        armature_kg_m2=armature,
    )
