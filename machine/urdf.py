"""URDF text generated from the same DH table that the kinematics use, drawn as a crane that a viewer can recognise."""

from xml.sax.saxutils import quoteattr

import numpy as np

from machine.description import Joint, Machine
from machine.poses import inverse_pose, pose
from machine.rotations import Array, rotation_about
from machine.urdf_shapes import (
    DARK_MATERIAL_XML,
    GREY_MATERIAL_XML,
    PAINT_MATERIAL_XML,
    bar,
    box,
    cylinder_visual,
    origin_element,
)

LINK_THICKNESSES_M = (0.30, 0.20, 0.16, 0.13, 0.11, 0.09)  # of the bodies, from the base; drawing only
PEDESTAL_M = (0.8, 0.8, 0.12)
DRAWN_LENGTH_MIN_M = 0.02


def urdf_text(machine: Machine, tilts: Array | None = None) -> str:
    """The machine as URDF: joint zeros, limits and speeds as in the machine file.

    Model:   classic DH puts d_i, a_i and alpha_i behind the joint's rotation, URDF has its fixed origin before it. So
             joint i moves an empty body_i on its axis, T_base_link_(i-1) Rz(theta_i), and link_i, the DH frame, is
             fixed to it at (a_i, 0, d_i), turned by alpha_i about x. The shapes hang on link_i.
    Args:    tilts: what stands before each joint (n, 4, 4), as the axes of a real machine lie; none without it.
    Returns: links base, body_1..n, link_1..n, flange, tcp, tool, cam_left, cam_right.
    """
    parts = [f"<robot name={quoteattr(machine.name)}>", f'<link name="base">{_pedestal_shape_xml()}</link>']
    parent = "base"
    for number, joint in enumerate(machine.joints, start=1):
        T_link_body = pose(rotation_about("z", joint.theta_offset_rad), np.zeros(3))
        T_link_body = T_link_body if tilts is None else tilts[number - 1] @ T_link_body
        parts.append(_revolute_joint_xml(joint, number, parent, T_link_body))
        parts.append(f'<link name="body_{number}"/>')
        parent = f"link_{number}"
        parts.append(
            _fixed_frame_xml(parent, f"body_{number}", dh_fixed_part(joint), _body_shapes_xml(machine, number))
        )
    baseline = np.array([machine.camera.baseline_m, 0.0, 0.0])
    parts.append(_fixed_frame_xml("flange", parent, np.eye(4)))
    parts.append(_fixed_frame_xml("tcp", "flange", machine.T_flange_tcp, _camera_bracket(machine)))
    parts.append(_fixed_frame_xml("tool", "tcp", machine.T_tcp_tool, _marker_plates(machine)))
    parts.append(_fixed_frame_xml("cam_left", "tcp", machine.T_tcp_cam_left, _camera_box(machine.camera.baseline_m)))
    parts.append(_fixed_frame_xml("cam_right", "cam_left", pose(np.eye(3), baseline)))
    parts.append("</robot>")
    return "\n".join(parts)


def dh_fixed_part(joint: Joint) -> Array:
    """What follows a joint's rotation in its DH row (paper eq. 24 at theta = 0): (a, 0, d) and alpha about x."""
    return pose(rotation_about("x", joint.alpha_rad), np.array([joint.a_m, 0.0, joint.d_m]))


def _revolute_joint_xml(joint: Joint, number: int, parent: str, T_parent_body: Array) -> str:
    limit = (
        f'<limit lower="{joint.q_min_rad:.12g}" upper="{joint.q_max_rad:.12g}" effort="0" '
        f'velocity="{joint.qd_max_rad_s:.12g}"/>'
    )
    return (
        f'<joint name={quoteattr(joint.name)} type="revolute"><parent link="{parent}"/><child link="body_{number}"/>'
        f'{origin_element(T_parent_body)}<axis xyz="0 0 1"/>{limit}</joint>'
    )


def _fixed_frame_xml(name: str, parent: str, T_parent_frame: Array, visual: str = "") -> str:
    """A fixed link."""
    return (
        f'<link name="{name}">{visual}</link><joint name="{name}_mount" type="fixed"><parent link="{parent}"/>'
        f'<child link="{name}"/>{origin_element(T_parent_frame)}</joint>'
    )


def _body_shapes_xml(machine: Machine, number: int) -> str:
    """Shapes of a moving body in its link's frame: a hub on its joint's axis and the DH segments that turn with it.

    a_i always belongs to body i. d_i lies on joint i's axis, so it may be drawn on either side of the joint: the next
    joint's d is this body's boom (d4, the tilt boom, on body 3), and the first and last keep their own (pillar, tool).
    """
    joint, count = machine.joints[number - 1], len(machine.joints)
    thickness = LINK_THICKNESSES_M[min(number, len(LINK_THICKNESSES_M)) - 1]
    T_link_body = inverse_pose(dh_fixed_part(joint))
    along_axis = np.array([0.0, 0.0, 1.0])
    axis, foot, end = T_link_body[:3, :3] @ along_axis, T_link_body[:3, 3], np.zeros(3)
    corner = foot + joint.d_m * axis
    half_hub = 0.65 * thickness * axis
    shapes = (
        [] if number == 1 else [cylinder_visual(foot - half_hub, foot + half_hub, 0.6 * thickness, DARK_MATERIAL_XML)]
    )
    if number == count:
        neck = foot + 0.6 * joint.d_m * axis
        shapes += [
            cylinder_visual(foot, neck, 0.5 * thickness, GREY_MATERIAL_XML),
            cylinder_visual(neck, corner, 0.2 * thickness, DARK_MATERIAL_XML),
        ]
    elif number == 1:
        shapes.append(cylinder_visual(foot, corner, 0.5 * thickness, PAINT_MATERIAL_XML))
    if abs(joint.a_m) > DRAWN_LENGTH_MIN_M:
        shapes.append(bar(corner, end, thickness, PAINT_MATERIAL_XML))
    if number < count - 1 and abs(machine.joints[number].d_m) > DRAWN_LENGTH_MIN_M:
        shapes.append(bar(end, machine.joints[number].d_m * along_axis, thickness, PAINT_MATERIAL_XML))
    return "".join(shapes)


def _pedestal_shape_xml() -> str:
    return box(pose(np.eye(3), np.array([0.0, 0.0, -PEDESTAL_M[2] / 2.0])), PEDESTAL_M, GREY_MATERIAL_XML)


def _camera_bracket(machine: Machine) -> str:
    """From the torsion axis to the middle between the eyes, in the tcp frame."""
    middle = machine.T_tcp_cam_left @ np.array([machine.camera.baseline_m / 2.0, 0.0, -0.02, 1.0])
    foot = np.array([0.0, 0.0, middle[2]])
    return (
        bar(foot, middle[:3], 0.03, DARK_MATERIAL_XML) if np.linalg.norm(middle[:3] - foot) > DRAWN_LENGTH_MIN_M else ""
    )


def _camera_box(baseline_m: float) -> str:
    T_cam_box = pose(np.eye(3), np.array([baseline_m / 2.0, 0.0, -0.015]))
    return box(T_cam_box, (baseline_m + 0.05, 0.03, 0.03), DARK_MATERIAL_XML)


def _marker_plates(machine: Machine) -> str:
    """A plate behind each tool marker's print, a fifth wider than the marker."""
    plates = []
    for marker in machine.markers_on("tool"):
        T_tool_plate = marker.T_on_marker @ pose(np.eye(3), np.array([0.0, 0.0, -0.004]))
        plates.append(box(T_tool_plate, (1.2 * marker.side_m, 1.2 * marker.side_m, 0.006), GREY_MATERIAL_XML))
    return "".join(plates)
