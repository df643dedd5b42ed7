"""An arm from a URDF: the chain between two of its links."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from machine.effects.arm import Arm
from machine.errors import MachineError
from machine.poses import pose
from machine.rotations import Array, rotation_about, rotation_from_rotvec

LENGTH_MIN_M = 1e-9  # a shorter link has no direction of its own
SKEW_MIN = 0.05  # sine between two axes: below it they are parallel, and no normal of both is their own


@dataclass(frozen=True, slots=True)
class _UrdfJoint:
    name: str
    kind: Literal["revolute", "prismatic", "fixed"]
    parent: str
    child: str
    T_parent_joint: Array
    axis: Array


def arm_from_urdf(
    text: str,
    base_link: str,
    tip_link: str,
    joint_names: Sequence[str] | None = None,
    T_flange_tcp: Array | None = None,
) -> tuple[Arm, tuple[str, ...]]:
    """The chain between two links of a URDF, up to their common ancestor and down again.

    Model:   before_i = fixed joints since the last moving one, origin, and the turn that brings the axis onto z;
             after_i undoes that turn. Upwards the joint's inverse. Lengths as of modified DH: "a" along the common
             normal of the last axis and this one, "d" along the axis. Link i is what joint i moves. Masses of links
             that are fixed to it are left out.
    Args:    joint_names: order of the joint vector; moving joints of the chain without a name here are held at 0, names
             that are not in the chain get a joint that moves nothing. Without them: the chain's own, from the base.
    Returns: the arm, and the names of its joints.
    Raises:  MachineError: not URDF, no such link, no chain, a joint type that is not known.
    """
    joints = _urdf_joints(text)
    up, down = _path(joints, base_link, tip_link)
    pending = np.eye(4)
    parts: list[_Part] = []
    for joint, rising in [*((one, True) for one in up), *((one, False) for one in down)]:
        pending = pending if rising else pending @ joint.T_parent_joint
        if joint.kind != "fixed" and (joint_names is None or joint.name in joint_names):
            parts.append(_Part(joint, rising, pending))
            pending = np.eye(4)
        pending = pending @ np.linalg.inv(joint.T_parent_joint) if rising else pending
    names = tuple(joint_names) if joint_names is not None else tuple(part.joint.name for part in parts)
    if not parts:
        raise MachineError(
            f"urdf: none of {list(names)} moves between {base_link!r} and {tip_link!r}; name those that do"
        )
    tcp = pending @ (np.eye(4) if T_flange_tcp is None else T_flange_tcp)
    return _arm(parts, names, tcp, _inertials(text)), names


@dataclass(frozen=True, slots=True)
class _Part:
    joint: _UrdfJoint
    rising: bool
    T_last_joint: Array


def _path(joints: list[_UrdfJoint], base: str, tip: str) -> tuple[list[_UrdfJoint], list[_UrdfJoint]]:
    """Joints from base up to the common ancestor, and from there down to the tip."""
    above = {joint.child: joint for joint in joints}

    def rise(link: str) -> list[_UrdfJoint]:
        way: list[_UrdfJoint] = []
        while link in above and len(way) <= len(joints):
            way.append(above[link])
            link = above[link].parent
        return way

    links = {joint.child for joint in joints} | {joint.parent for joint in joints}
    for link in (base, tip):
        if link not in links:
            raise MachineError(f"urdf: there is no link {link!r}; it has {', '.join(sorted(links)[:12])} ...")
    up, down = rise(base), rise(tip)
    while up and down and up[-1].name == down[-1].name:
        up.pop()
        down.pop()
    ends = up[-1].parent if up else base, down[-1].parent if down else tip
    if ends[0] != ends[1]:
        raise MachineError(f"urdf: no chain from {base!r} to {tip!r}; they hang on {ends[0]!r} and {ends[1]!r}")
    return up, down[::-1]


def _arm(
    parts: list[_Part], names: Sequence[str], T_flange_tcp: Array, inertials: dict[str, tuple[float, Array]]
) -> Arm:
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
        turn = pose(_z_onto(part.joint.axis), np.zeros(3))
        before[i], after[i] = part.T_last_joint @ turn, turn.T
        length_before[i, 0] = _apart(last, part)
        last = part.joint.axis / np.linalg.norm(part.joint.axis)
        length_after[i, 1, 2] = 1.0
        moves[i] = -1.0 if part.rising else 1.0
        prismatic[i] = float(part.joint.kind == "prismatic")
        mass[i], com[i] = (0.0, np.zeros(3)) if part.rising else inertials.get(part.joint.child, (0.0, np.zeros(3)))
    gravity = np.array([0.0, 0.0, -9.81])
    zero = np.zeros(n)
    return Arm(before, after, zero, moves, prismatic, length_before, length_after, mass, com, gravity, T_flange_tcp)


def _apart(last: Array | None, part: _Part) -> Array:
    """Direction (3,), in the last joint's frame, in which an axis may lie further from the last one.

    0 where there is none: what goes along either axis is a d.
    """
    offset = part.T_last_joint[:3, 3]
    axis = part.T_last_joint[:3, :3] @ part.joint.axis / np.linalg.norm(part.joint.axis)
    normal = offset - (offset @ axis) * axis
    both = np.zeros(3) if last is None else np.cross(last, axis)
    if float(np.linalg.norm(both)) > SKEW_MIN:
        normal = both if offset @ both >= 0.0 else -both
    length = float(np.linalg.norm(normal))
    return normal / length if length > LENGTH_MIN_M else np.zeros(3)


def _z_onto(axis: Array) -> Array:
    """Rotation (3, 3) that takes z onto a unit axis."""
    unit = axis / np.linalg.norm(axis)
    cross = np.cross([0.0, 0.0, 1.0], unit)
    sine = float(np.linalg.norm(cross))
    if sine < 1e-12:
        return np.eye(3) if unit[2] > 0.0 else rotation_about("x", np.pi)
    return rotation_from_rotvec(cross / sine * float(np.arctan2(sine, unit[2])))


def _urdf_joints(text: str) -> list[_UrdfJoint]:
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise MachineError(f"urdf is not XML: {error}") from error
    return [_urdf_joint(joint) for joint in root.findall("joint") if joint.find("parent") is not None]


def _urdf_joint(joint: ElementTree.Element) -> _UrdfJoint:
    name, parent, child = joint.get("name", ""), joint.find("parent"), joint.find("child")
    kinds: dict[str, Literal["revolute", "prismatic", "fixed"]] = {
        "revolute": "revolute",
        "continuous": "revolute",
        "prismatic": "prismatic",
        "fixed": "fixed",
    }
    kind = kinds.get(joint.get("type", ""))
    if kind is None or parent is None or child is None:
        raise MachineError(
            f"urdf: joint {name!r} has type {joint.get('type')!r}; revolute, prismatic or fixed between links"
        )
    T = pose(_from_rpy(_numbers(joint.find("origin"), "rpy", "0 0 0")), _numbers(joint.find("origin"), "xyz", "0 0 0"))
    axis = _numbers(joint.find("axis"), "xyz", "1 0 0")
    if kind != "fixed" and not float(np.linalg.norm(axis)) > 0.0:
        raise MachineError(f"urdf: joint {name!r} has no axis; give a direction")
    return _UrdfJoint(name, kind, parent.get("link", ""), child.get("link", ""), T, axis)


def _inertials(text: str) -> dict[str, tuple[float, Array]]:
    """Mass [kg] and centre (3,) [m] of each link."""
    found: dict[str, tuple[float, Array]] = {}
    for link in ElementTree.fromstring(text).findall("link"):
        inertial = link.find("inertial")
        if inertial is not None:
            mass = _numbers(inertial.find("mass"), "value", "0")[0]
            found[link.get("name", "")] = (float(mass), _numbers(inertial.find("origin"), "xyz", "0 0 0"))
    return found


def _numbers(element: ElementTree.Element | None, key: str, default: str) -> Array:
    text = default if element is None else element.get(key, default)
    try:
        return np.array([float(word) for word in text.split()])
    except ValueError as error:
        raise MachineError(f"urdf: {key}={text!r} holds something that is not a number") from error


def _from_rpy(rpy: Array) -> Array:
    roll, pitch, yaw = (float(angle) for angle in rpy)
    return rotation_about("z", yaw) @ rotation_about("y", pitch) @ rotation_about("x", roll)
