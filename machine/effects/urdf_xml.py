"""Read the chain between two links of a URDF; only what lies on it is read and can be refused."""

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from typing import Literal

import numpy as np

from machine.errors import MachineError
from machine.poses import pose
from machine.rotations import Array, rotation_about

Kind = Literal["revolute", "prismatic", "fixed"]
KINDS: dict[str, Kind] = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "fixed"}
SHOWN_LINKS_MAX = 12


@dataclass(frozen=True, slots=True)
class UrdfJoint:
    """One joint of the chain. `child_to_parent`: the chain passes it so. `lower_limit`, `upper_limit`: its own
    [rad or m], -inf and inf where there are none. `child_mass_kg` and `child_com_m` (3,) [child's frame] of its child,
    None where the child has no inertial. `mimicked_joint`: the one whose reading moves this one, too. `velocity_max`
    [rad/s or m/s]: inf where the URDF gives no limit.
    """

    name: str
    joint_type: Kind
    child_to_parent: bool
    T_parent_joint: Array
    axis: Array
    lower_limit: float
    upper_limit: float
    child_mass_kg: float | None
    child_com_m: Array | None
    mimicked_joint: str = ""
    velocity_max: float = np.inf


def urdf_chain(text: str, base_link: str, tip_link: str) -> tuple[UrdfJoint, ...]:
    """The joints from one link up to the common ancestor and down to another one, fixed ones among them.

    Raises: MachineError: not URDF, no such link, no chain; on the chain a joint of another type (floating, planar) or
            without an axis, or an invalid number; names joint or link.
    """
    root = _parse_xml_root(text)
    elements = [joint for joint in root.findall("joint") if _link_name(joint, "parent") and _link_name(joint, "child")]
    up, down = _joint_path_to_tip(elements, base_link, tip_link)
    links = {link.get("name", ""): link for link in root.findall("link")}
    rising = [(joint, True) for joint in up] + [(joint, False) for joint in down]
    return tuple(_parse_joint(joint, is_rising, links.get(_link_name(joint, "child"))) for joint, is_rising in rising)


def urdf_joint_names(text: str) -> frozenset[str]:
    """The names of all joints, on a chain or not. Raises: MachineError: not URDF."""
    return frozenset(joint.get("name", "") for joint in _parse_xml_root(text).findall("joint"))


def _parse_xml_root(text: str) -> ElementTree.Element:
    try:
        return ElementTree.fromstring(text.lstrip("\ufeff \t\r\n"))
    except ElementTree.ParseError as error:
        raise MachineError(f"urdf is not XML: {error}") from error


def _link_name(joint: ElementTree.Element, side: Literal["parent", "child"]) -> str:
    found = joint.find(side)
    return "" if found is None else found.get("link", "")


def _joint_path_to_tip(
    joints: list[ElementTree.Element], base: str, tip: str
) -> tuple[list[ElementTree.Element], list[ElementTree.Element]]:
    """Joints from base up to the common ancestor, and from there down to the tip."""
    above = {_link_name(joint, "child"): joint for joint in joints}

    def rise(link: str) -> list[ElementTree.Element]:
        way: list[ElementTree.Element] = []
        while link in above and len(way) <= len(joints):
            way.append(above[link])
            link = _link_name(above[link], "parent")
        return way

    links = {_link_name(joint, "child") for joint in joints} | {_link_name(joint, "parent") for joint in joints}
    for link in (base, tip):
        if link not in links:
            known = ", ".join(sorted(links)[:SHOWN_LINKS_MAX])
            raise MachineError(f"urdf: there is no link {link!r}; it has {known} ...")
    up, down = rise(base), rise(tip)
    while up and down and up[-1] is down[-1]:
        up.pop()
        down.pop()
    ends = _link_name(up[-1], "parent") if up else base, _link_name(down[-1], "parent") if down else tip
    if ends[0] != ends[1]:
        raise MachineError(f"urdf: no chain from {base!r} to {tip!r}; they hang on {ends[0]!r} and {ends[1]!r}")
    return up, down[::-1]


def _parse_joint(joint: ElementTree.Element, rising: bool, child: ElementTree.Element | None) -> UrdfJoint:
    name, written = joint.get("name", ""), joint.get("type", "")
    subject = f"urdf: joint {name!r}"
    if written not in KINDS:
        raise MachineError(
            f"{subject} has type {written!r}; on the chain give revolute, prismatic or fixed, or "
            "choose a base_link and tip_link between which it is not"
        )
    kind, origin = KINDS[written], joint.find("origin")
    T = pose(_from_rpy(_attribute_numbers(origin, "rpy", 3, subject)), _attribute_numbers(origin, "xyz", 3, subject))
    axis = _attribute_numbers(joint.find("axis"), "xyz", 3, subject, "1 0 0")
    if kind != "fixed" and not float(np.linalg.norm(axis)) > 0.0:
        raise MachineError(f"{subject} has no axis; give a direction")
    limit = None if written == "continuous" else joint.find("limit")
    lower, upper = (float(_attribute_numbers(limit, end, 1, subject)[0]) for end in ("lower", "upper"))
    if lower >= upper:  # none given, or zeros in their place
        lower, upper = -np.inf, np.inf
    fastest = float(_attribute_numbers(joint.find("limit"), "velocity", 1, subject)[0]) or np.inf
    leader = joint.find("mimic")
    mimics = "" if leader is None else leader.get("joint", "")
    return UrdfJoint(name, kind, rising, T, axis, lower, upper, *_mass_and_centre(child), mimics, fastest)


def _mass_and_centre(link: ElementTree.Element | None) -> tuple[float | None, Array | None]:
    """Mass [kg] and centre (3,) [m] of a link; None of one without an inertial."""
    inertial = None if link is None else link.find("inertial")
    if link is None or inertial is None:
        return None, None
    subject = f"urdf: link {link.get('name', '')!r}: inertial"
    mass = float(_attribute_numbers(inertial.find("mass"), "value", 1, subject)[0])
    if mass < 0.0:
        raise MachineError(f"{subject}: value={mass:g} is below 0 kg; give the link's mass")
    return mass, _attribute_numbers(inertial.find("origin"), "xyz", 3, subject)


def _attribute_numbers(
    element: ElementTree.Element | None, key: str, size: int, subject: str, default: str = ""
) -> Array:
    """So many finite numbers of an attribute; where it is not written the default, or zeros."""
    text = None if element is None else element.get(key)
    text = (default or " ".join(["0"] * size)) if text is None else text
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError as error:
        raise MachineError(f"{subject}: {key}={text!r} holds something that is not a number; correct it") from error
    if len(values) != size or not np.isfinite(values).all():
        raise MachineError(f"{subject}: {key}={text!r} has {len(values)} numbers; give {size} finite ones")
    return values


def _from_rpy(rpy: Array) -> Array:
    roll, pitch, yaw = (float(angle) for angle in rpy)
    return rotation_about("z", yaw) @ rotation_about("y", pitch) @ rotation_about("x", roll)
