"""SE(3): 4x4 poses. `T_a_b` is the pose of b in a: `p_a = T_a_b @ p_b`; neighbours cancel."""

import numpy as np

from machine.rotations import Array


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
