"""Pose of one square marker in one eye: both planar solutions, never one alone."""

import cv2
import numpy as np

from machine.markers import marker_corners
from machine.poses import pose
from machine.rotations import nearest_rotation
from server.vision.contracts import Array


def planar_poses(rays: Array, side_m: float) -> tuple[Array, ...]:
    """Both poses T_eye_marker that four corners allow, the better fitting one first; empty when there is none.

    Model:   homography of a square split into its two rigid decompositions (infinitesimal plane-based pose).
    Args:    rays: undistorted corners (4, 2) as x/z, y/z, OpenCV order. side_m: printed side [m].
    Returns: up to two (4, 4) poses in front of the eye.
    Source:  Collins and Bartoli 2014 (IPPE), OpenCV's SOLVEPNP_IPPE_SQUARE.
    """
    try:
        count, rvecs, tvecs, _ = cv2.solvePnPGeneric(
            marker_corners(side_m), rays.reshape(-1, 1, 2), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
    except cv2.error:  # four points on a line and the like: no pose, and that is an answer
        return ()
    found = []
    for rvec, tvec in zip(rvecs[:count], tvecs[:count], strict=True):
        rotation = np.asarray(cv2.Rodrigues(rvec)[0], dtype=float)
        position = np.asarray(tvec, dtype=float).reshape(3)
        if np.isfinite(rotation).all() and np.isfinite(position).all() and position[2] > 0.0:
            found.append(pose(nearest_rotation(rotation), position))
    return tuple(found)
