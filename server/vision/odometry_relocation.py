"""A start for the fit when prediction fails: flow from what was seen last, then recognition of any keyframe."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from machine.camera import undistort_to_rays
from machine.description import StereoCamera
from machine.poses import inverse_pose, transform_points
from server.vision.contracts import Array
from server.vision.odometry_keyframe import Keyframe
from server.vision.odometry_pose import coarse_pose
from server.vision.odometry_sight import Sight

NEIGHBOUR_MAX_PX = 60.0  # a recognised place takes the depth of the map point next to it
RECOGNISED_PER_PAIR = 3  # keyframes; the rest has its turn with the next pair


def by_flow(
    camera: StereoCamera, sight: Sight, sources: Sequence[tuple[Sight, Array, Array]], inliers_min: int
) -> Array | None:
    """T_vo_cam by flow from earlier pairs, tried in this order: (pair, places (n, 2) [px], points (n, 3) in vo)."""
    for source, places_px, points_vo in sources:
        found = sight.flow_from(source, places_px)
        T_vo_cam = _start(camera, points_vo[found.good], found.points_px[found.good], inliers_min)
        if T_vo_cam is not None:
            return T_vo_cam
    return None


def by_recognition(
    camera: StereoCamera, sight: Sight, keyframes: Sequence[Keyframe], turn: int, inliers_min: int
) -> Array | None:
    """T_vo_cam by likeness to some of the keyframes; `turn` counts the pairs for which this was asked.

    Model:   a recognised place of the keyframe lies on its ray at the depth of the nearest map point; PnP with RANSAC.
    """
    n = min(RECOGNISED_PER_PAIR, len(keyframes))
    for k in range(n):
        keyframe = keyframes[(turn * n + k) % len(keyframes)]
        kept_px, here_px = sight.recognise(keyframe.sight)
        if len(kept_px) == 0 or keyframe.n_points == 0:
            continue
        points_vo, near = _points_at(camera, keyframe, kept_px)
        T_vo_cam = _start(camera, points_vo[near], here_px[near], inliers_min)
        if T_vo_cam is not None:
            return T_vo_cam
    return None


def _points_at(camera: StereoCamera, keyframe: Keyframe, places_px: Array) -> tuple[Array, NDArray[np.bool_]]:
    away = np.linalg.norm(places_px[:, None] - keyframe.places_left_px[None], axis=2)
    nearest = away.argmin(axis=1)
    depth = keyframe.points_row[nearest, 2]
    rays = np.column_stack([undistort_to_rays(camera, places_px), np.ones(len(places_px))])
    points_vo = transform_points(keyframe.T_vo_cam, rays * depth[:, None])
    return points_vo, np.asarray(away.min(axis=1) < NEIGHBOUR_MAX_PX)


def _start(camera: StereoCamera, points_vo: Array, here_px: Array, inliers_min: int) -> Array | None:
    start = coarse_pose(points_vo, undistort_to_rays(camera, here_px), camera.fx_px)
    return inverse_pose(start.T_cam_vo) if start is not None and start.n_inliers >= inliers_min else None
