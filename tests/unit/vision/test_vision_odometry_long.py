"""Stereo odometry over a long way, behind a cover, and with a right eye that lies: points instead of pictures."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.vision.odometry.features import BORDER_PX, PointSight
from benchmarks.vision.odometry.film import nominal_machine
from machine.camera import project_stereo
from machine.poses import inverse_pose, pose, transform_points
from machine.rotations import rotation_from_rotvec
from server.vision.contracts import OdometryStatus
from server.vision.odometry import OdometrySettings, StereoOdometry

CAMERA = nominal_machine().camera
FACING = np.diag([1.0, -1.0, -1.0])  # the camera looks at the wall z = 0 from above
SETTINGS = OdometrySettings(readout_s=0.0, sigma_scale_frac=0.0)


def wall(rng, length_m=1.0, count=6000):
    flat = rng.uniform([-2.2, -1.8], [2.2 + length_m, 1.8], (count, 2))
    return np.column_stack([flat, rng.uniform(-0.05, 0.05, count)])


def sight(points, T_wall_cam, t_ns, rng):
    """Both eyes' view of the points that are not NaN."""
    seen = transform_points(inverse_pose(T_wall_cam), points)
    eyes = []
    for places in project_stereo(CAMERA, seen):
        noisy = places + rng.normal(0.0, 0.08, places.shape)
        size = np.array([CAMERA.width_px, CAMERA.height_px])
        outside = ((noisy < BORDER_PX) | (noisy > size - BORDER_PX)).any(axis=1) | (seen[:, 2] < 0.05)
        noisy[outside | np.isnan(noisy).any(axis=1)] = np.nan
        eyes.append(noisy)
    return PointSight(t_ns, CAMERA, eyes[0], eyes[1], rng)


def swayed(x):
    turn = rotation_from_rotvec(np.deg2rad([2.0 * np.sin(3.0 * x), 3.0 * np.sin(2.0 * x), 4.0 * np.sin(x)]))
    return pose(FACING @ turn, np.array([x, 0.1 * np.sin(2.0 * x), 0.8]))


def test_more_keyframes_than_are_kept_do_no_harm():
    """Forgetting one renumbers the list: what was seen belongs to the keyframe it was seen of, by serial."""
    rng = np.random.default_rng(0)
    points = wall(rng, 14.0, 30_000)
    odometry = StereoOdometry(CAMERA, replace(SETTINGS, keyframes_max=5))
    T_first, made, squares = swayed(0.0), 0, []
    for k, x in enumerate(np.linspace(0.0, 14.0, 100)):
        found = odometry.process_sight(sight(points, swayed(x), k * 150_000_000 + 1, rng))
        assert found.status is not OdometryStatus.LOST
        newest = odometry.keyframes[-1]
        made = max(made, newest.serial)
        if newest.seen_here is not None:
            assert set(newest.seen_here.keyframe_serials.tolist()) <= set(range(1, newest.serial))
        if k > 50:
            error = found.T_vo_cam[:3, 3] - (inverse_pose(T_first) @ swayed(x))[:3, 3]
            squares.append(error @ np.linalg.solve(found.covariance[3:, 3:], error))
    assert made > 2 * len(odometry.keyframes)
    assert np.mean(squares) < 8.0  # 3 where no keyframe is forgotten


def test_what_was_covered_for_a_while_comes_back():
    rng = np.random.default_rng(0)
    points = wall(rng)
    half = 0.5 * CAMERA.width_px / CAMERA.fx_px * 1.3
    covered = points[:, 0] > 0.16 * half
    odometry, counts = StereoOdometry(CAMERA, SETTINGS), []
    for k in range(60):
        now = points.copy()
        if 5 <= k < 17:
            now[covered] = np.nan
        there = pose(FACING, np.array([0.0, 0.0, 1.3]))
        counts.append(odometry.process_sight(sight(now, there, k * 16_000_000 + 1, rng)).n_points)
    assert counts[10] < 0.7 * counts[4]
    assert counts[-1] > 0.95 * counts[4]


@pytest.mark.parametrize("kind", ["right", "swapped", "dark"])
def test_a_right_eye_that_shows_nothing_of_the_map_is_told(kind):
    rng = np.random.default_rng(1)
    points = wall(rng)
    odometry, held = StereoOdometry(CAMERA, SETTINGS), None
    for k in range(6):
        now = sight(points, pose(FACING, np.array([0.02 * k, 0.0, 0.8])), k * 100_000_000 + 1, rng)
        held = held or now
        if k >= 3 and kind == "swapped":
            now = replace(now, left_px=now.right_px, right_px=now.left_px)
        elif k >= 3 and kind == "dark":
            now = replace(now, right_px=np.full_like(now.right_px, np.nan))
        found = odometry.process_sight(now)
        if k < 3 or kind == "right":
            assert found.status is OdometryStatus.OK
        elif kind != "swapped":
            assert found.status is OdometryStatus.DEGRADED
            assert "the right eye shows 0 % of the known points" in found.reason
        else:
            assert found.status is not OdometryStatus.OK
