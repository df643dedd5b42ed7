"""URDF's <origin> and <visual> elements: poses, boxes and cylinders."""

import numpy as np

from machine.poses import pose
from machine.rotations import Array, rotation_about, rotation_from_rotvec

PAINT_MATERIAL_XML = '<material name="paint"><color rgba="0.93 0.66 0.15 1"/></material>'
DARK_MATERIAL_XML = '<material name="dark"><color rgba="0.2 0.22 0.24 1"/></material>'
GREY_MATERIAL_XML = '<material name="grey"><color rgba="0.62 0.64 0.66 1"/></material>'


def origin_element(T: Array) -> str:
    """A pose as <origin>, with every digit."""
    xyz = " ".join(f"{value:.17g}" for value in T[:3, 3])
    rpy = " ".join(f"{value:.17g}" for value in roll_pitch_yaw(T[:3, :3]))
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>'


def roll_pitch_yaw(R: Array) -> tuple[float, float, float]:
    """Fixed-axis angles [rad] of R = Rz(yaw) Ry(pitch) Rx(roll); roll is 0 at pitch = +-90 deg."""
    cosine = float(np.hypot(R[0, 0], R[1, 0]))
    pitch = float(np.arctan2(-R[2, 0], cosine))
    if cosine < 1e-12:
        return 0.0, pitch, float(np.arctan2(-R[0, 1], R[1, 1]))
    return float(np.arctan2(R[2, 1], R[2, 2])), pitch, float(np.arctan2(R[1, 0], R[0, 0]))


def box(T: Array, size_m: tuple[float, float, float], material: str) -> str:
    """A box with its middle at T."""
    size = " ".join(f"{value:.4f}" for value in size_m)
    return f'<visual>{origin_element(T)}<geometry><box size="{size}"/></geometry>{material}</visual>'


def bar(start: Array, end: Array, thickness_m: float, material: str) -> str:
    """A square bar from start to end (3,) [m]."""
    length, T = _length_and_middle_pose(start, end)
    return box(T, (thickness_m, thickness_m, length), material)


def cylinder_visual(start: Array, end: Array, radius_m: float, material: str) -> str:
    """A cylinder from start to end (3,) [m]."""
    length, T = _length_and_middle_pose(start, end)
    geometry = f'<geometry><cylinder radius="{radius_m:.4f}" length="{length:.4f}"/></geometry>'
    return f"<visual>{origin_element(T)}{geometry}{material}</visual>"


def _length_and_middle_pose(start: Array, end: Array) -> tuple[float, Array]:
    """Length, and the pose of the middle with z along the way."""
    way = end - start
    length = max(float(np.linalg.norm(way)), 1e-3)
    return length, pose(_rotation_taking_z_to(way / length), (start + end) / 2.0)


def _rotation_taking_z_to(direction: Array) -> Array:
    axis = np.cross([0.0, 0.0, 1.0], direction)
    sine, cosine = float(np.linalg.norm(axis)), float(direction[2])
    if sine < 1e-12:
        return np.eye(3) if cosine >= 0.0 else rotation_about("x", np.pi)
    return rotation_from_rotvec(axis / sine * float(np.arctan2(sine, cosine)))
