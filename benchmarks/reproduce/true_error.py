"""What a step truly left: tool minus goal in OOI axes, and OOI minus tool in camera axes as the paper tabulates it."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.reproduce.true_corners import true_poses_cam
from machine.poses import inverse_pose
from machine.rotations import Array, geodesic_angle
from sim_plc.world import World

Three = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class StepErrors:
    """One look: true and image-based, (x, y, z) [mm] and rotation [deg].

    `goal_*`: tool minus goal, OOI axes. `camera_*`: OOI minus tool, camera axes, stand-off contained. `euler_*`: of the
    OOI in tool axes, x y z as the paper's Table 2; None where only the angle is known.
    """

    name: str
    goal_true_mm: Three
    goal_image_mm: Three
    camera_true_mm: Three
    camera_image_mm: Three
    rotation_true_deg: float
    rotation_image_deg: float
    predicted_sigma_mm: Three | None = None
    euler_true_deg: Three | None = None
    euler_image_deg: Three | None = None


@dataclass(frozen=True, slots=True)
class TrueErrors:
    """The true part of `StepErrors`."""

    goal_mm: Three
    camera_mm: Three
    rotation_deg: float
    euler_deg: Three


def true_errors(world: World, T_base_tcp: Array, T_ooi_goal: Array) -> TrueErrors:
    """True errors of a true tool pose against a goal in the OOI."""
    T_ooi_tool = inverse_pose(world.scene.T_base_ooi) @ T_base_tcp @ world.scene.T_tcp_tool
    T_cam_tool, T_cam_ooi = true_poses_cam(world, T_base_tcp)
    return TrueErrors(
        goal_mm=three_mm(T_ooi_tool[:3, 3] - T_ooi_goal[:3, 3]),
        camera_mm=three_mm(T_cam_ooi[:3, 3] - T_cam_tool[:3, 3]),
        rotation_deg=float(np.rad2deg(geodesic_angle(T_ooi_goal[:3, :3], T_ooi_tool[:3, :3]))),
        euler_deg=euler_deg(T_cam_tool[:3, :3], T_cam_ooi[:3, :3]),
    )


def euler_deg(R_cam_tool: Array, R_cam_ooi: Array) -> Three:
    """Euler angles x, y, z (fixed axes) [deg] of the OOI in tool axes: Figure 5 and Table 2."""
    x, y, z = Rotation.from_matrix(R_cam_tool.T @ R_cam_ooi).as_euler("xyz", degrees=True)
    return float(x), float(y), float(z)


def three_mm(vector_m: Array) -> Three:
    """A vector (3,) [m] in millimetres."""
    x, y, z = 1e3 * np.asarray(vector_m)
    return float(x), float(y), float(z)
