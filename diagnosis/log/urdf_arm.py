"""The arm of a machine file that names a URDF: the chain, what the file adds to it, and where the two differ."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from diagnosis.errors import DiagnosisError
from diagnosis.log.findings import Finding
from diagnosis.log.machine_keys import DH_KEYS
from diagnosis.log.machine_numbers import is_sliding, number_of, vector_of
from diagnosis.log.nearest import nearest_name
from machine.effects.arm import Arm
from machine.effects.arm_urdf import arm_from_chain
from machine.effects.urdf_xml import UrdfJoint, urdf_chain, urdf_joint_names
from machine.rotations import Array

URDF_REPLACED_KEYS = (*DH_KEYS, "dh_convention")  # what a URDF says in a [[joint]]'s place
MISSING_MASS_CONSEQUENCE = "gravity's torque is not known; a bend is reported as an encoder's error"


@dataclass(frozen=True, slots=True)
class UrdfArm:
    """The arm, its joints' names, `joint_limits` (n, 2) [rad or m], findings, and what of the load is not known."""

    arm: Arm
    joint_names: tuple[str, ...]
    joint_limits: Array
    findings: tuple[Finding, ...]
    load_absent: str


def urdf_arm(
    text: str,
    section: Mapping[str, Any],
    joints: Sequence[Mapping[str, Any]],
    T_flange_tcp: Array | None,
    gravity: Array,
) -> UrdfArm:
    """The arm between the links that [urdf] names, with what [[joint]] and [machine] add to it.

    Model:  geometry, types and limits are the URDF's; mass_kg and com_m of a [[joint]] go before the URDF's, since a
            crane's masses are known better than its drawing's, and its q_min and q_max before <limit>. A type that
            differs is refused: one of the two files is of another machine.
    Args:   section: [urdf] with base_link, tip_link. joints: every [[joint]]. gravity: (3,) in base_link's axes.
    Raises: DiagnosisError, MachineError: a file that is not a URDF, names or types that cannot belong together.
    """
    chain = urdf_chain(text, section["base_link"], section["tip_link"])
    moving = {joint.name: joint for joint in chain if joint.joint_type != "fixed"}
    wanted = _joint_vector_names(joints, list(moving))
    arm, names = arm_from_chain(chain, wanted, T_flange_tcp, gravity)
    for number, (joint, name) in enumerate(zip(joints, names, strict=False), start=1):
        _check_type(joint, number, moving.get(name))
    limits = [
        (moving[name].lower_limit, moving[name].upper_limit) if name in moving else (-np.inf, np.inf) for name in names
    ]
    arm = _arm_with_given_masses(arm, joints, names)
    findings = (*_misnamed_joint_findings(names, moving, urdf_joint_names(text)), *_unread_geometry_findings(joints))
    return UrdfArm(arm, names, np.array(limits), findings, _load_absent(arm, names))


def _joint_vector_names(joints: Sequence[Mapping[str, Any]], moving: list[str]) -> tuple[str, ...] | None:
    """The order of the joint vector; None: the chain's own."""
    names = [str(joint["name"]) for joint in joints if "name" in joint]
    if len(names) < len(joints):
        if len(joints) != len(moving):
            raise DiagnosisError(
                f"machine.toml: {len(joints)} [[joint]], not all with a name, but {len(moving)} URDF joints move "
                f"({', '.join(moving)}); give every [[joint]] the name of its URDF joint"
            )
        return None
    if len(set(names)) < len(names):
        raise DiagnosisError(f"machine.toml: [[joint]] names {names} repeat; give each the name of its URDF joint")
    return tuple(names) or None


def _check_type(joint: Mapping[str, Any], number: int, urdf: UrdfJoint | None) -> None:
    slid = is_sliding(joint, f"joint {number}")
    if urdf is not None and "type" in joint and slid != (urdf.joint_type == "prismatic"):
        raise DiagnosisError(
            f"machine.toml: joint {number} ({urdf.name}): type = {joint['type']!r}, but the URDF's is "
            f"{urdf.joint_type}; "
            "correct one of them, or leave type out"
        )


def _arm_with_given_masses(arm: Arm, joints: Sequence[Mapping[str, Any]], names: tuple[str, ...]) -> Arm:
    """The arm with the masses and centres that the machine file gives."""
    mass, com = arm.mass.copy(), arm.com.copy()
    for k, (joint, name) in enumerate(zip(joints, names, strict=False)):
        given, centre = number_of(joint, "mass_kg", name), vector_of(joint, "com_m", 3, name)
        mass[k] = mass[k] if given is None else given
        com[k] = com[k] if centre is None else centre
    return replace(arm, mass=mass, com=com)


def _load_absent(arm: Arm, names: tuple[str, ...]) -> str:
    light = [
        name for name, mass, moves in zip(names, arm.mass, arm.motion_factor, strict=True) if moves and mass == 0.0
    ]
    if not light:
        return ""
    moved_by = ", ".join(light)
    return f"neither the URDF nor [[joint]] has a mass of the link that {moved_by} moves: {MISSING_MASS_CONSEQUENCE}"


def _misnamed_joint_findings(
    names: tuple[str, ...], moving: Mapping[str, UrdfJoint], anywhere: frozenset[str]
) -> list[Finding]:
    """Names on one side only. A joint may be meant to stay or to lie elsewhere: said, and a problem if misspelt."""
    held = [name for name in moving if name not in names]
    findings, meant = [], set[str]()
    for number, name in enumerate(names, start=1):
        if name in moving:
            continue
        near = nearest_name(name, held) if name not in anywhere else None
        meant |= {near} if near else set()
        where = "is not on the URDF's chain" if name in anywhere else "is not in the URDF"
        text = f"joint {number} ({name}) {where} and moves nothing"
        text += f"; did you mean {near!r}?" if near else ""
        severity = "note" if name in anywhere else "problem"
        findings.append(Finding("machine_mismatch", severity, "machine.toml", text))
    for name in held:
        text = f"the URDF's joint {name!r} lies on the chain, has no [[joint]] of its name and is held at 0"
        findings.append(Finding("machine_mismatch", "problem" if name in meant else "note", "machine.toml", text))
    return findings


def _unread_geometry_findings(joints: Sequence[Mapping[str, Any]]) -> list[Finding]:
    """A second geometry next to the URDF's, which is the one that counts."""
    keys = [key for key in URDF_REPLACED_KEYS if any(key in joint for joint in joints)]
    if not keys:
        return []
    text = f"[[joint]] {', '.join(keys)}: not read, the geometry is the URDF's; leave [urdf] or these out"
    return [Finding("unknown_key", "note", "machine.toml", text, len(keys))]
