"""Keyframes: a stereo pair that is kept, and the points it put into the map."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machine.camera import project_stereo, undistort_to_rays
from machine.description import StereoCamera
from machine.poses import inverse_pose, transform_points
from server.vision.contracts import Array, Image
from server.vision.odometry_features import inside_mask, spread_corners
from server.vision.odometry_flow import flow

EPIPOLAR_MAX_PX = 1.0
DISPARITY_MIN_PX = 1.5
FAILURES_MAX = 8  # more failed than found, and this often: the point is no good


@dataclass(slots=True)
class Keyframe:
    """Images and n map points. Mutable only in its points' failure counts.

    places_left_px, places_right_px (n, 2): raw pixels. points_vo (n, 3) [m]. support_vo (n, 2, 3): the points one raw
    pixel to the right and below, at the same depth. depth_step_vo (n, 3): what one sigma of the disparity moves the
    point by. depth_step_right (n, 2) [px]: what that moves it by in this keyframe's own right eye.
    """

    left: Image
    right: Image
    T_vo_cam: Array
    covariance: Array
    places_left_px: Array
    places_right_px: Array
    points_vo: Array
    support_vo: Array
    depth_step_vo: Array
    depth_step_right: Array
    failures: NDArray[np.int64]

    @property
    def n_points(self) -> int:
        """Points this keyframe put into the map."""
        return len(self.points_vo)


@dataclass(frozen=True, slots=True)
class StereoMatches:
    """Raw pixels (n, 2) of the same points in both eyes, their rays and depths (n,) [m]."""

    left_px: Array
    right_px: Array
    rays_left: Array
    depth_m: Array


def match_eyes(
    camera: StereoCamera, left: Image, right: Image, masks: tuple[Image, Image], count: int, occupied_px: Array
) -> StereoMatches:
    """New corners of the left eye found again in the right one and triangulated.

    Model:   depth z = f b / (x_left - x_right) on undistorted rays; kept where |y_left - y_right| < 1 px and the
             disparity is at least 1.5 px. Flow runs twice: what fails starts again at the disparity of its neighbours.
    """
    corners = spread_corners(left, masks[0], count, occupied_px)
    found = flow(left, right, corners)
    rays_left = undistort_to_rays(camera, corners)
    right_px, good = found.points_px, _plausible(camera, rays_left, found.points_px, found.good)
    if 0 < good.sum() < len(good):
        shift = np.median(right_px[good] - corners[good], axis=0)
        again = flow(left, right, corners[~good], corners[~good] + shift)
        right_px = right_px.copy()
        right_px[~good] = again.points_px
        retried = good.copy()
        retried[~good] = again.good
        good = _plausible(camera, rays_left, right_px, retried)
    good &= inside_mask(masks[1], right_px)
    rays_right = undistort_to_rays(camera, right_px[good])
    depth = camera.baseline_m / (rays_left[good, 0] - rays_right[:, 0])
    return StereoMatches(corners[good], right_px[good], rays_left[good], depth)


def _plausible(camera: StereoCamera, rays_left: Array, right_px: Array, good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    height, width = camera.height_px, camera.width_px
    inside = np.asarray((right_px >= 0.0).all(axis=1) & (right_px < [width, height]).all(axis=1))
    rays_right = undistort_to_rays(camera, np.where(inside[:, None], right_px, 0.0))
    disparity = (rays_left[:, 0] - rays_right[:, 0]) * camera.fx_px
    row = np.abs(rays_left[:, 1] - rays_right[:, 1]) * camera.fy_px
    return np.asarray(good & inside & (row < EPIPOLAR_MAX_PX) & (disparity > DISPARITY_MIN_PX))


def make_keyframe(
    camera: StereoCamera,
    images: tuple[Image, Image],
    pose_vo: tuple[Array, Array],
    found: StereoMatches,
    sigma_px: float,
) -> Keyframe:
    """A keyframe at a known pose (T_vo_cam, covariance) with its triangulated points.

    Model:   sigma of the depth = z^2 sqrt(2) sigma / (f b), along the left ray.
    """
    T_vo_cam, covariance = pose_vo
    ones = np.ones((len(found.depth_m), 1))
    rays = np.concatenate([found.rays_left, ones], axis=1)
    points_cam = rays * found.depth_m[:, None]
    support = []
    for offset in (np.array([1.0, 0.0]), np.array([0.0, 1.0])):
        neighbour = undistort_to_rays(camera, found.left_px + offset)
        beside = np.concatenate([neighbour, ones], axis=1) * found.depth_m[:, None]
        support.append(transform_points(T_vo_cam, beside))
    sigma_depth = found.depth_m**2 * np.sqrt(2.0) * sigma_px / (camera.fx_px * camera.baseline_m)
    step_cam = rays * sigma_depth[:, None]
    return Keyframe(
        left=images[0],
        right=images[1],
        T_vo_cam=T_vo_cam,
        covariance=covariance,
        places_left_px=found.left_px,
        places_right_px=found.right_px,
        points_vo=transform_points(T_vo_cam, points_cam),
        support_vo=np.stack(support, axis=1),
        depth_step_vo=step_cam @ T_vo_cam[:3, :3].T,
        depth_step_right=_right_step(camera, points_cam, step_cam),
        failures=np.zeros(len(points_cam), dtype=np.int64),
    )


def _pinhole_px(camera: StereoCamera, points_cam: Array, eye: int) -> Array:
    shifted = points_cam[:, :2] - np.array([eye * camera.baseline_m, 0.0])
    return shifted / points_cam[:, 2:] * camera.fx_px


def _right_step(camera: StereoCamera, points_cam: Array, step_cam: Array) -> Array:
    return _pinhole_px(camera, points_cam + step_cam, 1) - _pinhole_px(camera, points_cam, 1)


@dataclass(frozen=True, slots=True)
class Expected:
    """Points of one keyframe that the new pair should show: their indices, where, how warped, and how well known.

    indices (m,); left_px, right_px (m, 2) raw; warps (m, 2, 2) = d(keyframe px)/d(new px); map_sigma_px (m, 2): what
    the point's own depth error amounts to in each eye [px].
    """

    indices: NDArray[np.int64]
    left_px: Array
    right_px: Array
    warps: Array
    map_sigma_px: Array


def expect_points(camera: StereoCamera, keyframe: Keyframe, T_vo_cam: Array, mask: Image) -> Expected:
    """Which of a keyframe's points a pair taken at `T_vo_cam` shows, and where.

    A point is left out where it lies outside the mask, where the patch would be seen at less than 0.4 or more than 2.5
    times its area, or where it has failed too often.
    """
    T_cam_vo = inverse_pose(T_vo_cam)
    points_cam = transform_points(T_cam_vo, keyframe.points_vo)
    indices = np.flatnonzero((points_cam[:, 2] > 0.05) & (keyframe.failures < FAILURES_MAX))
    left_px, right_px = project_stereo(camera, points_cam[indices])
    near = inside_mask(mask, left_px)
    indices, left_px, right_px = indices[near], left_px[near], right_px[near]
    columns = [
        project_stereo(camera, transform_points(T_cam_vo, keyframe.support_vo[indices, k]))[0] - left_px
        for k in range(2)
    ]
    growth = np.stack(columns, axis=2)  # d(new px)/d(keyframe px)
    area = np.linalg.det(growth) if len(growth) else np.zeros(0)
    usable = (area > 0.4) & (area < 2.5)
    indices, growth = indices[usable], growth[usable]
    map_sigma = _map_sigma(camera, keyframe, T_cam_vo, indices)
    return Expected(indices, left_px[usable], right_px[usable], np.asarray(np.linalg.inv(growth), float), map_sigma)


def _map_sigma(camera: StereoCamera, keyframe: Keyframe, T_cam_vo: Array, indices: NDArray[np.int64]) -> Array:
    """Effect of one sigma of disparity on both eyes; at the keyframe itself it is nil, for the patches share it."""
    near = transform_points(T_cam_vo, keyframe.points_vo[indices])
    far = transform_points(T_cam_vo, keyframe.points_vo[indices] + keyframe.depth_step_vo[indices])
    left = _pinhole_px(camera, far, 0) - _pinhole_px(camera, near, 0)
    right = _pinhole_px(camera, far, 1) - _pinhole_px(camera, near, 1) - keyframe.depth_step_right[indices]
    return np.stack([np.linalg.norm(left, axis=1), np.linalg.norm(right, axis=1)], axis=1) / np.sqrt(2.0)
