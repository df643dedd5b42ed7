"""Keyframes and their points adjusted together, so that all that was seen of a point places it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machine.camera import undistort_to_rays
from machine.description import StereoCamera
from machine.poses import inverse_pose, transform_points
from server.vision.bundle import adjust_bundle
from server.vision.bundle_contracts import BundleLoss, BundleProblem, BundleSettings, BundleStatus
from server.vision.contracts import Array
from server.vision.odometry_keyframe import Keyframe, ray_sigma
from server.vision.odometry_motion import moved_by_twist, row_fractions

BUNDLE_SETTINGS = BundleSettings(loss=BundleLoss.CAUCHY, loss_scale=3.0)
Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class TrackedPoints:
    """Points that more than one keyframe of the window saw: their host's number in the window and place in it (m,)."""

    host_indices: Indices
    indices: Indices

    def points_in_vo(self, window: Sequence[Keyframe]) -> Array:
        """The points (m, 3) in vo."""
        points = np.empty((len(self.host_indices), 3))
        for host in np.unique(self.host_indices):
            on = self.host_indices == host
            points[on] = window[host].points_vo[self.indices[on]]
        return points


@dataclass(frozen=True, slots=True)
class WindowObservations:
    """Observations (n,): numbers of the keyframe in the window and of the point, raw pixels (n, 2) in both eyes."""

    keyframe_indices: Indices
    point_indices: Indices
    left_px: Array
    right_px: Array


def adjust_keyframes(
    camera: StereoCamera, window: Sequence[Keyframe], readout_s: float, sigma_px: float, noise_factor: float = 1.0
) -> Array | None:
    """Moves the keyframes of a window and their points to where they fit best; the first one stays.

    Args:    sigma_px: assumed of a coordinate, in which points' covariances are given. noise_factor: how many times
             noisier the images turned out to be.
    Returns: joint covariance (6 k, 6 k) of the keyframes' poses, given the first; None where nothing was changed.
    """
    tracked, seen = collect(window)
    if len(tracked.host_indices) == 0:
        return None
    rays = np.column_stack([undistort_to_rays(camera, seen.left_px), undistort_to_rays(camera, seen.right_px)])
    sigma = np.column_stack([ray_sigma(camera, rays[:, :2]), ray_sigma(camera, rays[:, 2:])])
    problem = BundleProblem(
        Ts_vo_cam=np.array([keyframe.T_vo_cam for keyframe in window]),
        points_vo=tracked.points_in_vo(window),
        frame_indices=seen.keyframe_indices,
        point_indices=seen.point_indices,
        rays=rays + _rolling_shutter_correction(camera, window, tracked, seen, readout_s),
        sigma_px=noise_factor * sigma_px * sigma,
        focal_px=(camera.fx_px, camera.fx_px),
        baseline_m=camera.baseline_m,
        fixed_frames=np.arange(len(window)) == 0,
    )
    result = adjust_bundle(problem, BUNDLE_SETTINGS)
    if result.status is not BundleStatus.OK:
        return None
    covariances, mixings = given_the_poses(problem, result.Ts_vo_cam, result.points_vo)
    covariances /= noise_factor**2
    for number, keyframe in enumerate(window):
        keyframe.place_points(result.Ts_vo_cam[number], keyframe.twist, readout_s)
        on = tracked.host_indices == number
        at = tracked.indices[on]
        keyframe.move_points(at, result.points_vo[on], covariances[on], readout_s)
        _store_point_mixings(keyframe, at, mixings[on], [held.serial for held in window])
    return result.joint_covariance


def _store_point_mixings(keyframe: Keyframe, at: Indices, mixings: Array, serials: Sequence[int]) -> None:
    """Which keyframes points of this one go with from now on: mixings (m, k, 3, 3) for the window's serials."""
    for serial in keyframe.keyframe_influence.keys() - set(serials):
        keyframe.keyframe_influence[serial][at] = 0.0
    for number, serial in enumerate(serials):
        if mixings[:, number].any():
            mixing = keyframe.keyframe_influence.setdefault(serial, np.zeros((keyframe.n_points, 3, 3)))
            mixing[at] = mixings[:, number]


def collect(window: Sequence[Keyframe]) -> tuple[TrackedPoints, WindowObservations]:
    """Points that another keyframe of the window saw again, and all observations of them, their host's first."""
    numbers = {keyframe.serial: number for number, keyframe in enumerate(window)}
    frames, keys, left_px, right_px = [], [], [], []
    for number, keyframe in enumerate(window):
        again = keyframe.seen_here
        if again is None:
            continue
        on = np.flatnonzero([int(serial) in numbers for serial in again.keyframe_serials])
        hosts = [numbers[int(serial)] for serial in again.keyframe_serials[on]]
        frames.append(np.full(len(on), number))
        keys.append(np.column_stack([hosts, again.indices[on]]).reshape(-1, 2))
        left_px.append(again.left_px[on])
        right_px.append(again.right_px[on])
    none = np.zeros((0, 2))
    unique, points = np.unique(np.concatenate([none, *keys]).astype(np.int64), axis=0, return_inverse=True)
    hosts, indices = unique[:, 0], unique[:, 1]
    for host in np.unique(hosts):
        on = hosts == host
        left_px.append(window[host].places_left_px[indices[on]])
        right_px.append(window[host].places_right_px[indices[on]])
    seen = WindowObservations(
        np.concatenate([np.zeros(0), *frames, hosts]).astype(np.int64),
        np.concatenate([points.reshape(-1), np.arange(len(hosts))]),
        np.concatenate([none, *left_px]),
        np.concatenate([none, *right_px]),
    )
    return TrackedPoints(hosts, indices), seen


def _rolling_shutter_correction(
    camera: StereoCamera, window: Sequence[Keyframe], tracked: TrackedPoints, seen: WindowObservations, readout_s: float
) -> Array:
    """What has to be added to rays (n, 4) so that they are those of the middle row's exposure."""
    change = np.zeros((len(seen.left_px), 4))
    if readout_s == 0.0:
        return change
    points_vo = tracked.points_in_vo(window)
    for number, keyframe in enumerate(window):
        on = seen.keyframe_indices == number
        middle = transform_points(inverse_pose(keyframe.T_vo_cam), points_vo[seen.point_indices[on]])
        times_s = row_fractions(seen.left_px[on, 1], camera.height_px) * readout_s
        rolled = moved_by_twist(middle, keyframe.twist, times_s)
        change[on] = _four_rays(middle, camera.baseline_m) - _four_rays(rolled, camera.baseline_m)
    return change


def _four_rays(points_cam: Array, baseline_m: float) -> Array:
    x, y, z = points_cam.T
    return np.column_stack([x / z, y / z, (x - baseline_m) / z, y / z])


def given_the_poses(problem: BundleProblem, Ts_vo_cam: Array, points_vo: Array) -> tuple[Array, Array]:
    """Per point: covariance (m, 3, 3) if all poses were exact, and how far it goes with each keyframe (m, k, 3, 3).

    Model:   V = sum over its observations of S, S = P^T P / sigma^2; the covariance is V^-1, the share of a keyframe
             V^-1 S (shares sum to the identity).
    """
    shares = np.zeros((len(points_vo), len(Ts_vo_cam), 3, 3))
    Ts_cam_vo = np.array([inverse_pose(T) for T in Ts_vo_cam])[problem.frame_indices]
    R = Ts_cam_vo[:, :3, :3]
    cams = np.einsum("nij,nj->ni", R, points_vo[problem.point_indices]) + Ts_cam_vo[:, :3, 3]
    slopes, z = np.zeros((len(cams), 4, 3)), cams[:, 2]
    for eye in range(2):
        seen = problem.focal_px[0] / problem.sigma_px[:, eye] * ~np.isnan(problem.rays[:, 2 * eye])
        slopes[:, 2 * eye, 0] = slopes[:, 2 * eye + 1, 1] = seen / z
        slopes[:, 2 * eye, 2] = -seen * (cams[:, 0] - eye * problem.baseline_m) / z**2
        slopes[:, 2 * eye + 1, 2] = -seen * cams[:, 1] / z**2
    slopes = slopes @ R
    np.add.at(shares, (problem.point_indices, problem.frame_indices), slopes.transpose(0, 2, 1) @ slopes)
    inverse = np.asarray(np.linalg.inv(shares.sum(axis=1)), float)
    return inverse, inverse[:, None] @ shares
