"""SE(3): 4x4 poses. `T_a_b` is the pose of b in a: `p_a = T_a_b @ p_b`; neighbours cancel."""

import numpy as np

from machine.rotations import Array, rotation_from_rotvec, rotvec_from_rotation


def pose(rotation: Array, position: Array) -> Array:
    """4x4 pose from a rotation (3, 3) and a position (3,) [m]."""
    result = np.eye(4)
    result[:3, :3] = rotation
    result[:3, 3] = position
    return result


def inverse_pose(T_a_b: Array) -> Array:
    """T_b_a from T_a_b, without a general inverse."""
    rotation = T_a_b[:3, :3].T
    return pose(rotation, -rotation @ T_a_b[:3, 3])


def transform_points(T_a_b: Array, points_b: Array) -> Array:
    """Points (n, 3) of frame b expressed in frame a."""
    return points_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def pose_difference(T_one: Array, T_other: Array) -> Array:
    """The step (6,) from one pose to another: rotation vector [rad] by left perturbation, then translation [m]."""
    return np.concatenate([rotvec_from_rotation(T_other[:3, :3] @ T_one[:3, :3].T), T_other[:3, 3] - T_one[:3, 3]])


def moved_pose(T: Array, step: Array) -> Array:
    """The pose after a step (6,) as `pose_difference` gives it: R <- exp(w) R, t <- t + dt."""
    return pose(rotation_from_rotvec(step[:3]) @ T[:3, :3], T[:3, 3] + step[3:])
