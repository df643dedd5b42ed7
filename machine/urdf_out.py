"""Export an arm with its known effects as URDF; what a URDF cannot hold is reported."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass, replace
from xml.sax.saxutils import quoteattr

import numpy as np

from machine.description import Machine
from machine.effects.arm import Arm
from machine.effects.arm_urdf import arm_from_urdf, axis_turn
from machine.effects.entries import EffectEntry, pack_effects
from machine.effects.kernel import BIAS
from machine.effects.layout import BASE_TILT, LENGTH_A, LENGTH_D, TILT_X, TILT_Y, ParameterSets
from machine.effects.registry import effect_of
from machine.effects.seen import camera_mount
from machine.effects.urdf_xml import urdf_chain
from machine.errors import MachineError
from machine.poses import inverse_pose, pose
from machine.rotations import Array, rotation_about, rotation_from_rotvec
from machine.urdf import urdf_text
from machine.urdf_shapes import origin_element, roll_pitch_yaw

#: What moves a frame by the same amount in every posture.
POSTURE_INDEPENDENT_EFFECTS = ("encoder_bias", "link_length_error", "joint_axis_tilt", "base_tilt")
POSTURE_INDEPENDENT_EFFECTS += ("hand_eye_rotation", "hand_eye_translation")


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Of every joint (n,): lowest and highest reading [rad or m], and speed [rad/s or m/s]; inf where not known."""

    q_min: Array
    q_max: Array
    speed_max: Array


def split_entries(entries: Sequence[EffectEntry]) -> tuple[tuple[EffectEntry, ...], tuple[str, ...]]:
    """The effects that a URDF holds, and each other one in words, with the reason."""
    held = tuple(entry for entry in entries if entry.name in POSTURE_INDEPENDENT_EFFECTS)
    left_out = []
    for entry in entries:
        if entry.name in POSTURE_INDEPENDENT_EFFECTS:
            continue
        where = "" if entry.joint is None else f" of joint {entry.joint}"
        stage = effect_of(entry.name).stage
        why = "it is of the camera, not of the arm" if stage == "camera" else f"it acts at stage {stage}"
        if entry.name in ("encoder_scale", "encoder_eccentricity"):
            why = "a URDF takes a joint's reading as its angle"
        elif entry.name in ("gravity_sag", "base_compliance", "payload_error", "link_flexibility"):
            why = "a URDF's links are rigid"
        left_out.append(f"{entry.name}{where}: {why}")
    return held, tuple(left_out)


def machine_urdf(machine: Machine, entries: Sequence[EffectEntry]) -> str:
    """A machine, drawn as in the panel, with zeros, lengths, tilts and mount applied."""
    sets = pack_effects(entries, len(machine.joints))
    P = sets.joint_parameters[0]
    joints = tuple(
        replace(
            joint,
            a_m=joint.a_m + P[k, LENGTH_A],
            d_m=joint.d_m + P[k, LENGTH_D],
            theta_offset_rad=joint.theta_offset_rad - P[k, BIAS],
        )
        for k, joint in enumerate(machine.joints)
    )
    corrected = replace(machine, joints=joints, T_tcp_cam_left=camera_mount(sets, machine.T_tcp_cam_left))
    tilts = _joint_tilt_poses(sets)
    tilts[0] = _base_tilt_pose(sets) @ tilts[0]
    return urdf_text(corrected, tilts)


def arm_urdf(
    name: str, names: Sequence[str], arm: Arm, entries: Sequence[EffectEntry], limits: JointLimits, mount: Array | None
) -> str:
    """Any arm without shapes: links base, body_1..n, link_1..n, tcp, and cam_left where a mount is known.

    Args: mount: T_tcp_cam_left (4, 4).
    """
    sets = pack_effects(entries, arm.n)
    P, tilts = sets.joint_parameters[0], _joint_tilt_poses(sets)
    parts, parent = [f"<robot name={quoteattr(name or 'arm')}>", '<link name="base"/>'], "base"
    for k in range(arm.n):
        before, after = arm.before[k].copy(), arm.after[k].copy()
        for column, row in ((LENGTH_A, 0), (LENGTH_D, 1)):
            before[:3, 3] += P[k, column] * arm.length_before[k, row]
            after[:3, 3] += P[k, column] * arm.length_after[k, row]
        body, link = f"body_{k + 1}", f"link_{k + 1}"
        shift = arm.motion_factor[k] * (arm.q_offset[k] - P[k, BIAS])
        T = (
            (_base_tilt_pose(sets) if k == 0 else np.eye(4))
            @ before
            @ tilts[k]
            @ _joint_motion_pose(float(shift), bool(arm.prismatic[k]))
        )
        parts.append(f'<link name="{body}"/>')
        parts.append(_moving_joint_xml(names[k], k, parent, body, T, arm, limits))
        parts.append(f'<link name="{link}"/>{_fixed_joint_xml(f"{link}_mount", body, link, after)}')
        parent = link
    parts.append(f'<link name="tcp"/>{_fixed_joint_xml("tcp_mount", parent, "tcp", arm.T_flange_tcp)}')
    if mount is not None:
        parts.append(
            f'<link name="cam_left"/>{_fixed_joint_xml("cam_left_mount", "tcp", "cam_left", camera_mount(sets, mount))}'
        )
    return "\n".join([*parts, "</robot>"])


def edited_urdf(
    text: str, base_link: str, tip_link: str, names: Sequence[str], entries: Sequence[EffectEntry], mount: Array | None
) -> str:
    """A robot's own URDF with the origins of its arm's joints corrected; meshes, masses and all else stay.

    Model:  joint i's origin becomes P^-1 before_i' tilt_i d_i shift_i, P the fixed joints since the last moving one
            and all primes as in `structure.link_poses`; the base's tilt goes into the first one.
    Args:   names: the joint vector's; mount: T_tip_cam_left (4, 4), or None.
    Raises: MachineError: no URDF, or the chain passes a joint from child to parent, whose origin is another joint's.
    """
    chain = urdf_chain(text, base_link, tip_link)
    if any(joint.child_to_parent for joint in chain):
        rising = ", ".join(joint.name for joint in chain if joint.child_to_parent)
        raise MachineError(f"urdf: the chain passes {rising} from child to parent; give a base_link above the arm")
    sets = pack_effects(entries, len(names))
    P, tilts = sets.joint_parameters[0], _joint_tilt_poses(sets)
    lengths = _length_directions(text, base_link, tip_link, names)
    root = ElementTree.fromstring(text.lstrip("\ufeff \t\r\n"), ElementTree.XMLParser(target=_with_comments()))
    elements = {joint.get("name"): joint for joint in root.findall("joint")}
    fixed, lean = np.eye(4), _base_tilt_pose(sets)
    for joint in chain:
        if joint.joint_type == "fixed" or joint.name not in names:
            fixed = fixed @ joint.T_parent_joint
            continue
        k = list(names).index(joint.name)
        turn = axis_turn(joint.axis)
        before = fixed @ joint.T_parent_joint @ turn
        before[:3, 3] += P[k, LENGTH_A] * lengths[k]
        along = pose(np.eye(3), np.array([0.0, 0.0, P[k, LENGTH_D]]))
        moved = (
            lean
            @ before
            @ tilts[k]
            @ along
            @ _joint_motion_pose(float(-P[k, BIAS]), joint.joint_type == "prismatic")
            @ turn.T
        )
        if np.abs(moved - fixed @ joint.T_parent_joint).max() > 0.0:
            _set_origin(elements[joint.name], inverse_pose(fixed) @ moved)
        fixed, lean = np.eye(4), np.eye(4)
    if mount is not None:
        root.append(ElementTree.fromstring('<link name="cam_left"/>'))
        root.append(
            ElementTree.fromstring(_fixed_joint_xml("cam_left_mount", tip_link, "cam_left", camera_mount(sets, mount)))
        )
    return ElementTree.tostring(root, encoding="unicode")


def _with_comments() -> ElementTree.TreeBuilder:
    return ElementTree.TreeBuilder(insert_comments=True)


def _length_directions(text: str, base_link: str, tip_link: str, names: Sequence[str]) -> Array:
    return arm_from_urdf(text, base_link, tip_link, names)[0].length_before[:, 0]


def _set_origin(joint: ElementTree.Element, T: Array) -> None:
    found = joint.find("origin")
    element = ElementTree.SubElement(joint, "origin") if found is None else found
    element.set("xyz", " ".join(f"{value:.17g}" for value in T[:3, 3]))
    element.set("rpy", " ".join(f"{value:.17g}" for value in roll_pitch_yaw(T[:3, :3])))


def _joint_tilt_poses(sets: ParameterSets) -> Array:
    """How each joint's axis is tilted (n, 4, 4)."""
    P = sets.joint_parameters[0]
    out = np.tile(np.eye(4), (len(P), 1, 1))
    for k in range(len(P)):
        out[k, :3, :3] = rotation_from_rotvec(np.array([P[k, TILT_X], P[k, TILT_Y], 0.0]))
    return out


def _base_tilt_pose(sets: ParameterSets) -> Array:
    """How the base is tilted (4, 4)."""
    return pose(rotation_from_rotvec(sets.machine_parameters[0, BASE_TILT].copy()), np.zeros(3))


def _joint_motion_pose(way: float, slides: bool) -> Array:
    if slides:
        return pose(np.eye(3), np.array([0.0, 0.0, way]))
    return pose(rotation_about("z", way), np.zeros(3))


def _fixed_joint_xml(name: str, parent: str, child: str, T: Array) -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="fixed">{ends}{origin_element(T)}</joint>'


def _moving_joint_xml(name: str, k: int, parent: str, child: str, T: Array, arm: Arm, limits: JointLimits) -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>{origin_element(T)}'
    if arm.motion_factor[k] == 0.0:
        return f'<joint name={quoteattr(name)} type="fixed">{ends}</joint>'
    bounded = bool(np.isfinite([limits.q_min[k], limits.q_max[k]]).all())
    kind = "prismatic" if arm.prismatic[k] else "revolute" if bounded else "continuous"
    low, high = (limits.q_min[k], limits.q_max[k]) if bounded else (-1e3, 1e3)
    speed = float(limits.speed_max[k]) if np.isfinite(limits.speed_max[k]) else 0.0
    ends_of = "" if kind == "continuous" else f'lower="{low:.12g}" upper="{high:.12g}" '
    limit = f'<limit {ends_of}effort="0" velocity="{speed:.12g}"/>'
    return (
        f'<joint name={quoteattr(name)} type="{kind}">{ends}<axis xyz="0 0 {arm.motion_factor[k]:g}"/>{limit}</joint>'
    )
