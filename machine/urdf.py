"""URDF text generated from the same DH table that the kinematics use, with boxes that look like a crane."""

from xml.sax.saxutils import quoteattr

import numpy as np

from machine.description import Joint, Machine
from machine.poses import pose
from machine.rotations import Array, rotation_about, rotation_from_rotvec

THICKNESS_M = (0.34, 0.22, 0.18, 0.14, 0.12, 0.10)
STEEL = '<material name="paint"><color rgba="0.93 0.66 0.15 1"/></material>'
DARK = '<material name="dark"><color rgba="0.2 0.22 0.24 1"/></material>'


def urdf_text(machine: Machine) -> str:
    """The machine as URDF: base, link_1..n, tcp, tool, cam_left; joint zeros and limits as in the machine file.

    Model: classic DH puts a_i, d_i and alpha_i behind the joint's rotation, URDF has its fixed origin before it. So
    the origin of joint i is the fixed part of row i-1, and joint i turns about z of link i-1 by q_i + offset_i; the
    offset goes into the origin's rotation about the same axis.
    """
    parts = [f"<robot name={quoteattr(machine.name)}>", '<link name="base"/>']
    parent, T_fixed = "base", np.eye(4)
    for number, joint in enumerate(machine.joints, start=1):
        T_origin = T_fixed @ pose(rotation_about("z", joint.theta_offset_rad), np.zeros(3))
        parts.append(_revolute(joint, number, parent, T_origin))
        T_fixed = dh_fixed_part(joint)
        thickness = THICKNESS_M[min(number, len(THICKNESS_M)) - 1]
        parts.append(_link(f"link_{number}", T_fixed[:3, 3], thickness))
        parent = f"link_{number}"
    parts.append(_fixed("tcp", parent, T_fixed @ machine.T_flange_tcp))
    parts.append(_fixed("tool", "tcp", machine.T_tcp_tool))
    parts.append(_fixed("cam_left", "tcp", machine.T_tcp_cam_left, _camera_box(machine.camera.baseline_m)))
    parts.append("</robot>")
    return "\n".join(parts)


def dh_fixed_part(joint: Joint) -> Array:
    """What follows a joint's rotation in its DH row (paper eq. 24 at theta = 0): (a, 0, d) and alpha about x."""
    return pose(rotation_about("x", joint.alpha_rad), np.array([joint.a_m, 0.0, joint.d_m]))


def _origin(T: Array) -> str:
    xyz = " ".join(f"{value:.12g}" for value in T[:3, 3])
    rpy = " ".join(f"{value:.17g}" for value in _roll_pitch_yaw(T[:3, :3]))
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>'


def _roll_pitch_yaw(R: Array) -> tuple[float, float, float]:
    """Fixed-axis angles of R = Rz(yaw) Ry(pitch) Rx(roll); at pitch = +-90 deg roll is set to 0."""
    cosine = float(np.hypot(R[0, 0], R[1, 0]))
    pitch = float(np.arctan2(-R[2, 0], cosine))
    if cosine < 1e-12:
        return 0.0, pitch, float(np.arctan2(-R[0, 1], R[1, 1]))
    return float(np.arctan2(R[2, 1], R[2, 2])), pitch, float(np.arctan2(R[1, 0], R[0, 0]))


def _revolute(joint: Joint, number: int, parent: str, T_origin: Array) -> str:
    limit = (
        f'<limit lower="{joint.q_min_rad:.9g}" upper="{joint.q_max_rad:.9g}" effort="0" '
        f'velocity="{joint.qd_max_rad_s:.9g}"/>'
    )
    return (
        f'<joint name={quoteattr(joint.name)} type="revolute"><parent link="{parent}"/><child link="link_{number}"/>'
        f'{_origin(T_origin)}<axis xyz="0 0 1"/>{limit}</joint>'
    )


def _link(name: str, along: Array, thickness: float) -> str:
    """A link drawn as a box from its joint to the end of its DH segment."""
    length = float(np.linalg.norm(along))
    if length < 0.02:
        return (
            f'<link name="{name}"><visual><geometry><sphere radius="{thickness:.3f}"/></geometry>{DARK}</visual></link>'
        )
    T_box = pose(_rotation_taking_z_to(along / length), along / 2.0)
    box = f'<geometry><box size="{thickness:.3f} {thickness:.3f} {length:.4f}"/></geometry>'
    hub = f'<visual><geometry><sphere radius="{0.62 * thickness:.3f}"/></geometry>{DARK}</visual>'
    return f'<link name="{name}"><visual>{_origin(T_box)}{box}{STEEL}</visual>{hub}</link>'


def _rotation_taking_z_to(direction: Array) -> Array:
    z = np.array([0.0, 0.0, 1.0])
    axis = np.cross(z, direction)
    sine, cosine = float(np.linalg.norm(axis)), float(direction[2])
    if sine < 1e-12:
        return np.eye(3) if cosine > 0 else rotation_about("x", np.pi)
    return rotation_from_rotvec(axis / sine * np.arctan2(sine, cosine))


def _fixed(name: str, parent: str, T: Array, visual: str = "") -> str:
    return (
        f'<link name="{name}">{visual}</link><joint name="{name}_mount" type="fixed"><parent link="{parent}"/>'
        f'<child link="{name}"/>{_origin(T)}</joint>'
    )


def _camera_box(baseline_m: float) -> str:
    T_box = pose(np.eye(3), np.array([baseline_m / 2.0, 0.0, -0.015]))
    size = f'<geometry><box size="{baseline_m + 0.05:.3f} 0.03 0.03"/></geometry>'
    return f"<visual>{_origin(T_box)}{size}{DARK}</visual>"
