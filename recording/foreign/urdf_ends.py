"""Find the arm's chain in a URDF from the recorded joints, when base and tip are not given."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Collection
from dataclasses import dataclass

from machine.effects.urdf_xml import UrdfJoint, urdf_chain
from machine.errors import MachineError
from recording.errors import RecordingError
from recording.foreign.mapping import UrdfChain


@dataclass(frozen=True, slots=True)
class ChosenChain:
    """The two ends, and the moving joints between them. `is_guess`: chosen by the recorded joints."""

    base_link: str
    tip_link: str
    joints: tuple[UrdfJoint, ...]
    is_guess: bool


def chain_for(text: str, recorded: Collection[str], wanted: UrdfChain, n_recorded: int = 0) -> ChosenChain:
    """The chain between the ends that are given, else the one that holds most of the recorded joints.

    Args:   recorded: names of the recorded joints; empty: they are numbers, and the longest chain is taken;
            n_recorded: how many joints were recorded. A chain of numbered joints has fingers only where the others
            are fewer than that.
    Model:  of the links that recorded joints move, the one with most recorded joints on the way to the root; fingers,
            which are several moving joints on one link, do not count.
    Raises: RecordingError: no URDF, no such link, or no recorded joint in it; names both sides.
    """
    try:
        root = ElementTree.fromstring(text.lstrip("\ufeff \t\r\n"))
        parents = {_joint_link_name(joint, "child"): joint for joint in root.findall("joint")}
        base = wanted.base_link or _root_link(parents)
        tip = wanted.tip_link or _find_tip_link(parents, recorded, n_recorded)
        chain = urdf_chain(text, base, tip)
    except ElementTree.ParseError as error:
        raise RecordingError(f"the URDF is not XML: {error}; a xacro file has to be expanded by xacro first") from error
    except MachineError as error:
        raise RecordingError(str(error)) from error
    moving = tuple(joint for joint in chain if joint.joint_type != "fixed")
    if recorded and not any(joint.name in recorded for joint in moving):
        ours, theirs = ", ".join(sorted(recorded)[:8]), ", ".join(joint.name for joint in moving)
        raise RecordingError(
            f"no joint between {base} and {tip} of the URDF ({theirs}) was recorded ({ours}); give this robot's URDF, "
            "or say under [joint_names] of the mapping file what the URDF calls each joint"
        )
    return ChosenChain(base, tip, moving, not (wanted.base_link and wanted.tip_link))


def _joint_link_name(joint: ElementTree.Element, side: str) -> str:
    found = joint.find(side)
    return "" if found is None else found.get("link", "")


def _root_link(parents: dict[str, ElementTree.Element]) -> str:
    roots = [link for joint in parents.values() if (link := _joint_link_name(joint, "parent")) not in parents]
    return roots[0] if roots else ""


def _joints_to_root(parents: dict[str, ElementTree.Element], link: str) -> list[ElementTree.Element]:
    """Joints from a link up to the root."""
    way: list[ElementTree.Element] = []
    while link in parents and parents[link] not in way:
        way.append(parents[link])
        link = _joint_link_name(way[-1], "parent")
    return way


def _find_tip_link(parents: dict[str, ElementTree.Element], recorded: Collection[str], n_recorded: int) -> str:
    moving = [joint for joint in parents.values() if joint.get("type") != "fixed"]
    names = recorded or {joint.get("name") for joint in moving}
    last_mover = {id(joint): _next_moving(parents, _joint_link_name(joint, "parent")) for joint in moving}
    siblings = list(last_mover.values())
    best, tip = 0, ""
    for joint in moving:
        above = last_mover[id(joint)]
        is_finger = joint.find("mimic") is not None or (above is not None and siblings.count(above) > 1)
        if joint.get("name") not in names or (is_finger and joint.get("type") == "prismatic"):
            continue
        count = sum(
            element.get("name") in names for element in _joints_to_root(parents, _joint_link_name(joint, "child"))
        )
        if count > best:
            best, tip = count, _joint_link_name(joint, "child")
    if tip and (recorded or best >= n_recorded):
        return tip
    leaves = set(parents) - {_joint_link_name(joint, "parent") for joint in parents.values()}
    return max(sorted(leaves), key=lambda link: len(_joints_to_root(parents, link)), default="")


def _next_moving(parents: dict[str, ElementTree.Element], link: str) -> str | None:
    return next(
        (element.get("name") for element in _joints_to_root(parents, link) if element.get("type") != "fixed"), None
    )
