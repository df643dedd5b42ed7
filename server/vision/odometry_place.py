"""Whether a place found again after a gap is the only one: a wall of bricks looks alike one brick farther on."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from machine.camera import undistort_to_rays
from machine.description import StereoCamera
from machine.poses import inverse_pose, pose, transform_points
from server.vision.contracts import Array
from server.vision.odometry_align import PATCH_CORRELATION_MIN
from server.vision.odometry_features import UNIQUE_RATIO_MAX
from server.vision.odometry_keyframe import Keyframe
from server.vision.odometry_motion import TYPICAL_ACCELERATION, Motion
from server.vision.odometry_motions import LocatedPose
from server.vision.odometry_pose import coarse_pose
from server.vision.odometry_sight import Sight

PLACE_STEPS_MAX = 8  # from place to better place in one pair

DEPTH_NEIGHBOUR_MAX_PX = 60.0  # a recognised place takes the depth of the map point next to it
RECOGNITION_KEYFRAMES_MAX = 3  # keyframes; the rest has its turn with the next pair


def by_flow(
    camera: StereoCamera, sight: Sight, sources: Sequence[tuple[Sight, Array, Array]], inliers_min: int
) -> Array | None:
    """T_vo_cam by flow from earlier pairs, tried in this order: (pair, places (n, 2) [px], points (n, 3) in vo)."""
    for source, places_px, points_vo in sources:
        found = sight.flow_from(source, places_px)
        T_vo_cam = _start(camera, points_vo[found.valid], found.points_px[found.valid], inliers_min)
        if T_vo_cam is not None:
            return T_vo_cam
    return None


def by_recognition(
    camera: StereoCamera, sight: Sight, keyframes: Sequence[Keyframe], turn: int, inliers_min: int
) -> Array | None:
    """T_vo_cam by likeness to some of the keyframes; `turn` counts the pairs for which this was asked.

    Model:   a recognised place of the keyframe lies on its ray at the depth of the nearest map point; PnP with RANSAC.
    """
    n = min(RECOGNITION_KEYFRAMES_MAX, len(keyframes))
    for k in range(n):
        keyframe = keyframes[(turn * n + k) % len(keyframes)]
        kept_px, here_px = sight.recognise(keyframe.image_pair)
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
    return points_vo, np.asarray(away.min(axis=1) < DEPTH_NEIGHBOUR_MAX_PX)


def _start(camera: StereoCamera, points_vo: Array, here_px: Array, inliers_min: int) -> Array | None:
    start = coarse_pose(points_vo, undistort_to_rays(camera, here_px), camera.fx_px)
    return inverse_pose(start.T_cam_vo) if start is not None and start.n_inliers >= inliers_min else None


def shifted_pose(camera: StereoCamera, located: LocatedPose, way_px: Array) -> Array:
    """T_vo_cam from which the points would appear this way (2,) [px] from where they are seen.

    Model:   the camera goes along the plane that fits the points best (inverse depth is linear in the picture).
    """
    T_cam_vo = located.fit.T_cam_vo
    points_cam = transform_points(T_cam_vo, located.points_vo[located.fit.inliers])
    rays = points_cam / points_cam[:, 2:]
    plane = np.linalg.lstsq(rays, 1.0 / points_cam[:, 2], rcond=None)[0]
    half = np.array([0.5 * way_px[0] / camera.fx_px, 0.5 * way_px[1] / camera.fy_px, 0.0])
    ends = [ray / (plane @ ray) for ray in (np.array([0.0, 0.0, 1.0]) + half, np.array([0.0, 0.0, 1.0]) - half)]
    return np.asarray(inverse_pose(T_cam_vo) @ pose(np.eye(3), ends[1] - ends[0]))


def dissimilarity(located: LocatedPose) -> float:
    """How unlike their kept patches the expected points look here: mean of 1 - correlation^2, a missed one at most."""
    observed, worst = located.observed_points, 1.0 - PATCH_CORRELATION_MIN**2
    on = located.fit.inliers
    found = np.minimum(1.0 - observed.correlations[on] ** 2, worst)
    return float((found.sum() + worst * (observed.n_expected - len(found))) / max(observed.n_expected, 1))


def best_place(
    camera: StereoCamera, ways_px: Array, located: LocatedPose, fit: Callable[[Array], LocatedPose | None]
) -> tuple[LocatedPose, list[Array]]:
    """The place among its repetitions that looks most like the map, and the ways (3,) in vo [m] to others that cannot
    be excluded. `fit`: an accepted fit about a pose, or None."""
    best = located
    others: list[tuple[float, LocatedPose]] = []
    for _ in range(PLACE_STEPS_MAX):
        found = [fit(shifted_pose(camera, best, way)) for way in ways_px]
        others = [
            (dissimilarity(fitted), fitted)
            for fitted in found
            if fitted is not None and _is_different_place(best, fitted, ways_px, camera.fx_px)
        ]
        nearest = min(others, default=None, key=lambda pair: pair[0])
        if nearest is None or nearest[0] >= dissimilarity(best):
            break
        best = nearest[1]
    alike = [located for unlike, located in others if dissimilarity(best) > UNIQUE_RATIO_MAX * unlike]
    return best, [_camera_position(located) - _camera_position(best) for located in alike]


def _camera_position(located: LocatedPose) -> Array:
    return inverse_pose(located.fit.T_cam_vo)[:3, 3]


def _is_different_place(one: LocatedPose, other: LocatedPose, ways_px: Array, focal_px: float) -> bool:
    """Whether two fits did not end at the same place: more than half of the shortest repetition between them."""
    points_cam = transform_points(one.fit.T_cam_vo, one.points_vo[one.fit.inliers])
    half_px = 0.5 * np.linalg.norm(ways_px, axis=1).min()
    half_m = half_px / focal_px * float(np.median(points_cam[:, 2]))
    return bool(np.linalg.norm(_camera_position(one) - _camera_position(other)) > half_m)


def travel_limit_m(motion: Motion, t_ns: int) -> float:
    """How far [m] the camera may have come since its last pose: at its speed and with a boom's acceleration."""
    elapsed_s = 1e-9 * (t_ns - motion.t_ns)
    speed_m_s = float(np.linalg.norm(motion.twist().velocity[3:]))
    return speed_m_s * elapsed_s + 0.5 * float(TYPICAL_ACCELERATION[3]) * elapsed_s**2
