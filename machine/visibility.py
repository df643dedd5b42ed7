"""Visibility of an object: inside the image, in front of the camera, and facing it; no occlusion."""

import numpy as np

from machine.camera import project
from machine.description import Marker, StereoCamera
from machine.errors import MachineError
from machine.lens import fold_radius
from machine.markers import marker_corners
from machine.poses import transform_points
from machine.rotations import Array

FACING_COSINE_MIN = 0.2  # seen flatter than 78 deg a marker cannot be read
FOCUS_DEPTH_MIN_M = 0.05  # nearer than this nothing is in focus


def in_eye(camera: StereoCamera, points_eye: Array, margin_px: float) -> bool:
    """Whether all points (n, 3) [m] of one eye's own frame lie in front of it and inside its image by a margin.

    Points so far off the axis that the lens model folds them back into the image count as outside.
    """
    if points_eye.ndim != 2 or points_eye.shape[1] != 3 or not len(points_eye):
        raise MachineError(f"points have shape {points_eye.shape}; give (n, 3) [m], at least one")
    depth = points_eye[:, 2]
    if not np.all(depth > FOCUS_DEPTH_MIN_M):
        return False
    if np.any(np.hypot(points_eye[:, 0], points_eye[:, 1]) / depth >= fold_radius(camera.distortion)):
        return False
    limit = np.array([camera.width_px - 1.0 - margin_px, camera.height_px - 1.0 - margin_px])
    pixels = project(camera, points_eye)
    return bool(np.all((pixels >= margin_px) & (pixels <= limit)))


def _points_in_both_eyes(camera: StereoCamera, points_cam_left: Array) -> tuple[Array, Array]:
    return points_cam_left, points_cam_left - np.array([camera.baseline_m, 0.0, 0.0])


def in_both_eyes(camera: StereoCamera, points_cam_left: Array, margin_px: float) -> bool:
    """Whether all points (n, 3) [m] of the left eye's frame lie inside both images by a margin."""
    return all(in_eye(camera, points, margin_px) for points in _points_in_both_eyes(camera, points_cam_left))


def object_in_view(camera: StereoCamera, T_cam_object: Array, corners: Array, margin_px: float) -> tuple[bool, bool]:
    """Whether the left and the right eye see a flat object whole.

    Args:    T_cam_object: pose in the left eye's frame (4, 4). corners: (n, 3) [m], object frame, its face looks
             along +z. margin_px: distance to keep from the image's edge [px], 0 or more.
    Returns: (left, right).
    """
    points = transform_points(T_cam_object, corners)
    left, right = _points_in_both_eyes(camera, points)
    normal = T_cam_object[:3, 2]
    return (
        faces_eye(normal, left.mean(axis=0)) and in_eye(camera, left, margin_px),
        faces_eye(normal, right.mean(axis=0)) and in_eye(camera, right, margin_px),
    )


def faces_eye(normal: Array, centre: Array) -> bool:
    """Whether a face with an outward unit normal (3,), its centre at (3,) [m] in an eye's frame, turns to that eye.

    The angle between normal and line of sight stays below 78 deg.
    """
    return float(-normal @ centre) > FACING_COSINE_MIN * float(np.linalg.norm(centre))


def marker_in_view(camera: StereoCamera, T_cam_object: Array, marker: Marker, margin_px: float) -> bool:
    """Whether a marker of an object is inside both images and faces both eyes."""
    return all(object_in_view(camera, T_cam_object @ marker.T_on_marker, marker_corners(marker.side_m), margin_px))
