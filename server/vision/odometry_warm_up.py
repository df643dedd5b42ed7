"""Compiles the odometry's kernels before the first pair; a cold start costs seconds, later ones find the cache."""

from dataclasses import replace

import numpy as np

from server.vision.bundle import adjust_bundle
from server.vision.bundle_contracts import BundleProblem
from server.vision.odometry_align import align_reference_patches
from server.vision.odometry_keyframe import Keyframe
from server.vision.odometry_motions import find_motions
from server.vision.odometry_observation import ObservedPoints
from server.vision.odometry_pose import StereoPoints, pose_problem, refine_camera
from server.vision.odometry_sensitivity import Shutter, fit_sensitivity
from server.vision.odometry_sight import ImageSight


def warm_up_bundle() -> None:
    """Adjust two frames before twelve random points."""
    rng = np.random.default_rng(1)
    points = rng.uniform(-1.0, 1.0, (12, 3)) + np.array([0.0, 0.0, 4.0])
    Ts = np.tile(np.eye(4), (2, 1, 1))
    Ts[1, 0, 3] = 0.1
    frames, seen = np.nonzero(np.ones((2, 12)))
    x, y, z = (points[seen] - Ts[frames, :3, 3]).T
    problem = BundleProblem(
        Ts_vo_cam=Ts,
        points_vo=points,
        frame_indices=frames,
        point_indices=seen,
        rays=np.column_stack([x / z, y / z, (x - 0.1) / z, y / z]),
        sigma_px=np.full((24, 2), 0.1),
        focal_px=(500.0, 500.0),
        baseline_m=0.1,
        fixed_frames=np.array([True, False]),
    )
    adjust_bundle(problem)


def warm_up() -> None:
    """Run every kernel on random texture and points."""
    warm_up_bundle()
    rng = np.random.default_rng(1)
    image = rng.integers(0, 255, (48, 48)).astype(np.uint8)
    middle = np.array([[24.0, 24.0]])
    align_reference_patches(image, middle, np.eye(2)[None], image, middle)
    points = rng.uniform(-1.0, 1.0, (12, 3)) + np.array([0.0, 0.0, 5.0])
    left, right = points[:, :2] / points[:, 2:], (points[:, :2] - [0.1, 0.0]) / points[:, 2:]
    seen = StereoPoints(points, np.tile(1e-6 * np.eye(3), (12, 1, 1)), left, right, 0.1, 500.0, 0.1)
    fit = refine_camera(np.eye(4), seen)
    if fit is None:
        return
    problem = pose_problem(np.eye(4), seen)
    problem.squares(np.eye(4))
    find_motions(problem, replace(fit, inliers=np.zeros(12, dtype=bool)), 3)
    numbers = np.zeros(12, dtype=np.int64)
    observed = ObservedPoints(numbers, numbers, left, right, 12, seen, points, np.zeros(12, dtype=np.int8), np.ones(12))
    shutter = Shutter(left[:, 0], left[:, 0], np.ones(6), 0.01)
    fit_sensitivity(observed, fit, points, shutter, [_dummy_keyframe()])


def _dummy_keyframe() -> Keyframe:
    none, points, black = np.zeros((0, 2)), np.zeros((1, 3)), np.zeros((2, 2), np.uint8)
    return Keyframe(
        image_pair=ImageSight(black, black, (black, black), 0),
        T_vo_cam=np.eye(4),
        places_left_px=none,
        places_right_px=none,
        points_row=points,
        support_row=points[:, None],
        covariances_row=np.eye(3)[None],
        row_fractions=np.zeros(1),
        twist=np.zeros(6),
        points_vo=points,
        support_vo=points[:, None],
        covariances_vo=np.eye(3)[None],
        search_failures=np.zeros(1, dtype=np.int64),
        motion_votes=np.zeros(1, dtype=np.int8),
        keyframe_influence={0: np.eye(3)[None]},
    )
