"""A circle before an OOI, as the line-equation tests need it: positions, distances and vectors, with noise and tilt."""

from dataclasses import dataclass

import numpy as np

from machine.poses import inverse_pose, pose
from machine.rotations import rotation_about, rotation_from_rotvec
from server.calibration.line_equation import circle_points, image_distance

R_TCP_CAM = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class Circle:
    """The TCP at the points, what the camera saw there, and where the TCP should go across the plane."""

    T_init: np.ndarray
    points: np.ndarray
    distances: np.ndarray
    vectors: np.ndarray
    p_goal: np.ndarray


def drive(
    seed: int,
    lateral=(0.30, -0.12),
    turn_deg: float = 0.0,
    noise_m: float = 0.0,
    points: np.ndarray | None = None,
) -> Circle:
    """Camera turned by `turn_deg` about its own axis; the tool marker sits in the TCP, the OOI 0.5 m in front."""
    rng = np.random.default_rng(seed)
    T_init = pose(rotation_from_rotvec(rng.normal(size=3)), np.array([3.0, 0.4, 1.5]))
    T_tcp_cam = pose(R_TCP_CAM @ rotation_about("z", np.deg2rad(turn_deg)), np.array([0.1, 0.05, 0.5]))
    p_ooi = T_init[:3, 3] + T_init[:3, :3] @ np.array([*lateral, -0.5])
    driven = circle_points(T_init) if points is None else points
    vectors = []
    for p in driven:
        T_cam_base = inverse_pose(pose(T_init[:3, :3], p) @ T_tcp_cam)
        tool, ooi = (T_cam_base @ np.append(x, 1.0) for x in (p, p_ooi))
        vectors.append((ooi - tool)[:2] + noise_m * rng.normal(size=2))
    seen = np.array(vectors)
    distances = np.array([image_distance(np.zeros(3), v) for v in seen])
    goal = T_init[:3, 3] + T_init[:3, :2] @ np.array(lateral)
    return Circle(T_init, driven, distances, seen, goal)
