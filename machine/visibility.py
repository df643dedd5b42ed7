"""Whether a camera can see an object: inside the image, in front, and facing it. Geometry only, no occlusion."""

import numpy as np

from machine.camera import project_stereo
from machine.description import Marker, StereoCamera
from machine.markers import marker_corners
from machine.poses import transform_points
from machine.rotations import Array

FACING_COSINE_MIN = 0.2  # seen flatter than 78 deg a marker cannot be read


def in_both_eyes(camera: StereoCamera, points_cam: Array, margin_px: float) -> bool:
    """Whether all points (n, 3) [m] of the left eye's frame lie inside both images by a margin."""
    if np.any(points_cam[:, 2] <= 0.05):
        return False
    limit = np.array([camera.width_px - 1.0 - margin_px, camera.height_px - 1.0 - margin_px])
    return all(bool(np.all((px >= margin_px) & (px <= limit))) for px in project_stereo(camera, points_cam))


def marker_in_view(camera: StereoCamera, T_cam_object: Array, marker: Marker, margin_px: float) -> bool:
    """Whether a marker of an object is inside both images and faces the camera."""
    T_cam_marker = T_cam_object @ marker.T_on_marker
    centre = T_cam_marker[:3, 3]
    cosine = float(-T_cam_marker[:3, 2] @ centre / np.linalg.norm(centre))
    corners = transform_points(T_cam_marker, marker_corners(marker.side_m))
    return cosine > FACING_COSINE_MIN and in_both_eyes(camera, corners, margin_px)
