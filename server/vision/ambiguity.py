"""The other orientation of a planar target: where it is, and how much worse it fits."""

import numpy as np

from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from server.vision.contracts import Array
from server.vision.pose_refinement import PointObservations

PROFILE_STEPS = 6


def mirrored_pose(T_cam_object: Array, points_object: Array, eye_x_m: Array, share: float = 1.0) -> Array:
    """The pose whose normal is mirrored at the line of sight, the points' middle kept in place.

    Model:   n' = 2 (n.s) s - n, s from the middle of the seeing eyes to the points' middle: to first order in the
             target's size over its distance both orientations give the same image.
    Args:    share: of the way to the mirrored pose; 0.5 is the frontal one.
    Source:  Schweighofer and Pinz 2006, section 4.
    """
    middle_object = points_object.mean(axis=0)
    rotation = T_cam_object[:3, :3]
    middle = rotation @ middle_object + T_cam_object[:3, 3]
    sight = middle - np.array([float(np.mean(eye_x_m)), 0.0, 0.0])
    sight = -sight / np.linalg.norm(sight)
    normal = rotation[:, 2]
    axis = np.asarray(np.cross(normal, sight), dtype=float)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return T_cam_object.copy()
    angle = 2.0 * share * float(np.arctan2(sine, normal @ sight))
    mirrored = rotation_from_rotvec(axis / sine * angle) @ rotation
    return pose(mirrored, middle - mirrored @ middle_object)


def profile_sum_squares(T_cam_object: Array, observations: PointObservations) -> float:
    """Smallest sum of squared residuals [px^2] that any position reaches with this rotation; inf behind the camera.

    Model:   min over t of sum |pi(R X + t) - u|^2, Gauss-Newton in t.
    """
    arms = observations.points_object @ T_cam_object[:3, :3].T
    position = T_cam_object[:3, 3].copy()
    focal = observations.focal_px
    for _ in range(PROFILE_STEPS):
        residuals, depth, rays = _residuals(arms + position, observations)
        if depth.min() <= 0.0:
            return float("inf")
        J = np.zeros((len(arms), 2, 3))
        J[:, 0, 0], J[:, 1, 1] = focal[0] / depth, focal[1] / depth
        J[:, :, 2] = -rays * focal / depth[:, None]
        J = J.reshape(-1, 3)
        position = position - np.linalg.lstsq(J, residuals.reshape(-1), rcond=None)[0]
    residuals, depth, _ = _residuals(arms + position, observations)
    return float("inf") if depth.min() <= 0.0 else float(np.sum(residuals**2))


def _residuals(points_cam: Array, observations: PointObservations) -> tuple[Array, Array, Array]:
    depth = points_cam[:, 2]
    safe = np.maximum(depth, 1e-6)
    rays = np.column_stack([(points_cam[:, 0] - observations.eye_x_m) / safe, points_cam[:, 1] / safe])
    return rays * observations.focal_px - observations.seen_px, depth, rays
