"""An arm from a URDF: the chain between two of its links."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machine.effects.arm import Arm
from machine.effects.urdf_xml import UrdfJoint, urdf_chain
from machine.errors import MachineError
from machine.poses import pose
from machine.rotations import Array, rotation_about, rotation_from_rotvec

LINK_LENGTH_MIN_M = 1e-9  # a shorter link has no direction of its own
SKEW_AXES_SINE_MIN = 0.05  # sine between two axes: below it they are parallel, and no normal of both is their own


def arm_from_urdf(
    text: str,
    base_link: str,
    tip_link: str,
    joint_names: Sequence[str] | None = None,
    T_flange_tcp: Array | None = None,
    gravity: Array | None = None,
) -> tuple[Arm, tuple[str, ...]]:
    """The chain between two links of a URDF, up to their common ancestor and down again.

    Args:    joint_names, T_flange_tcp, gravity: as of `arm_from_chain`.
    Returns: the arm, and the names of its joints.
    Raises:  MachineError: as `urdf_chain` and `arm_from_chain`.
    """
    return arm_from_chain(urdf_chain(text, base_link, tip_link), joint_names, T_flange_tcp, gravity)


def arm_from_chain(
    chain: Sequence[UrdfJoint],
    joint_names: Sequence[str] | None = None,
    T_flange_tcp: Array | None = None,
    gravity: Array | None = None,
) -> tuple[Arm, tuple[str, ...]]:
    """The arm of a URDF's chain.

    Model:   before_i = fixed joints since the last moving one, origin, and the turn that brings the axis onto z;
             after_i undoes that turn. Upwards the joint's inverse. Lengths as of modified DH: "a" along the common
             normal of the last axis and this one, "d" along the axis. Link i is what joint i moves. Masses of links
             that are fixed to it are left out.
    Args:    joint_names: order of the joint vector; moving joints of the chain without a name here are held at 0, names
             that are not in the chain get a joint that moves nothing. Without them: the chain's own, from the base.
             gravity: (3,) in the base link's axes [m/s^2]; without it (0, 0, -9.81).
    Returns: the arm, and the names of its joints.
    Raises:  MachineError: none of the names moves, or they are not in the chain's order.
    """
    pending = np.eye(4)
    parts: list[_Part] = []
    for joint in chain:
        pending = pending if joint.child_to_parent else pending @ joint.T_parent_joint
        if joint.joint_type != "fixed" and (joint_names is None or joint.name in joint_names):
            parts.append(_Part(joint, pending))
            pending = np.eye(4)
        pending = pending @ np.linalg.inv(joint.T_parent_joint) if joint.child_to_parent else pending
    _require_no_follower(chain, joint_names)
    names = tuple(joint_names) if joint_names is not None else tuple(part.joint.name for part in parts)
    if not parts:
        moving = [joint.name for joint in chain if joint.joint_type != "fixed"]
        raise MachineError(f"urdf: none of {list(names)} moves on the chain, whose joints are {moving}; name those")
    tcp = pending @ (np.eye(4) if T_flange_tcp is None else T_flange_tcp)
    return _arm_from_parts(parts, names, tcp, np.array([0.0, 0.0, -9.81]) if gravity is None else gravity), names


def _require_no_follower(chain: Sequence[UrdfJoint], joint_names: Sequence[str] | None) -> None:
    """That no joint of the chain moves with another one's reading: it would be held at 0, or be a joint of its own."""
    known = [joint.name for joint in chain if joint.joint_type != "fixed"] if joint_names is None else list(joint_names)
    for joint in chain:
        measured = joint_names is not None and joint.name in joint_names
        if joint.joint_type != "fixed" and joint.mimicked_joint in known and not measured:
            raise MachineError(
                f"urdf: joint {joint.name!r} mimics {joint.mimicked_joint!r}, and one reading that moves two joints is "
                f"not modelled; record {joint.name!r} as a joint of its own and give it a [[joint]]"
            )


@dataclass(frozen=True, slots=True)
class _Part:
    joint: UrdfJoint
    T_last_joint: Array


def _arm_from_parts(parts: list[_Part], names: Sequence[str], T_flange_tcp: Array, gravity: Array) -> Arm:
    """Joints in the chain's order must be in the vector's order; those that are not in the chain move nothing."""
    n, places = len(names), [names.index(part.joint.name) for part in parts]
    if places != sorted(places):
        chain = [part.joint.name for part in parts]
        raise MachineError(f"urdf: joints {list(names)} are not in the chain's order {chain}; list them from the base")
    before, after = np.tile(np.eye(4), (n, 1, 1)), np.tile(np.eye(4), (n, 1, 1))
    length_before, length_after = np.zeros((n, 2, 3)), np.zeros((n, 2, 3))
    moves, prismatic, mass, com = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((n, 3))
    last: Array | None = None
    for i, part in zip(places, parts, strict=True):
        turn = axis_turn(part.joint.axis)
        before[i], after[i] = part.T_last_joint @ turn, turn.T
        length_before[i, 0] = _axis_offset_direction(last, part)
        last = part.joint.axis / np.linalg.norm(part.joint.axis)
        length_after[i, 1, 2] = 1.0
        moves[i] = -1.0 if part.joint.child_to_parent else 1.0
        prismatic[i] = float(part.joint.joint_type == "prismatic")
        if (
            not part.joint.child_to_parent
            and part.joint.child_mass_kg is not None
            and part.joint.child_com_m is not None
        ):
            mass[i], com[i] = part.joint.child_mass_kg, part.joint.child_com_m
    zero = np.zeros(n)
    return Arm(before, after, zero, moves, prismatic, length_before, length_after, mass, com, gravity, T_flange_tcp)


def _axis_offset_direction(last: Array | None, part: _Part) -> Array:
    """Direction (3,), in the last joint's frame, in which an axis may lie further from the last one.

    0 where there is none: what goes along either axis is a d.
    """
    offset = part.T_last_joint[:3, 3]
    axis = part.T_last_joint[:3, :3] @ part.joint.axis / np.linalg.norm(part.joint.axis)
    normal = offset - (offset @ axis) * axis
    both = np.zeros(3) if last is None else np.cross(last, axis)
    if float(np.linalg.norm(both)) > SKEW_AXES_SINE_MIN:
        normal = both if offset @ both >= 0.0 else -both
    length = float(np.linalg.norm(normal))
    return normal / length if length > LINK_LENGTH_MIN_M else np.zeros(3)


def axis_turn(axis: Array) -> Array:
    """The pose (4, 4) that turns z onto a joint's axis (3,)."""
    return pose(_z_onto(axis), np.zeros(3))


def _z_onto(axis: Array) -> Array:
    """Rotation (3, 3) that takes z onto a unit axis."""
    unit = axis / np.linalg.norm(axis)
    cross = np.cross([0.0, 0.0, 1.0], unit)
    sine = float(np.linalg.norm(cross))
    if sine < 1e-12:
        return np.eye(3) if unit[2] > 0.0 else rotation_about("x", np.pi)
    return rotation_from_rotvec(cross / sine * float(np.arctan2(sine, unit[2])))
