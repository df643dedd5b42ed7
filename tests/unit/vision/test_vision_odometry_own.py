"""Own structure in the odometry's picture: two rigid motions, and which of them is the camera's through the world."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.vision.odometry.features import BORDER_PX, PointSight
from benchmarks.vision.odometry.film import nominal_machine
from machine.camera import project_stereo
from machine.poses import inverse_pose, pose, transform_points
from server.vision.contracts import OdometryStatus
from server.vision.odometry import OdometrySettings, StereoOdometry
from server.vision.odometry_pose import StereoPoints, row_factor

CAMERA = nominal_machine().camera
SIZE = np.array([CAMERA.width_px, CAMERA.height_px])
SETTINGS = OdometrySettings(readout_s=0.0, sigma_scale_frac=0.0)
WALL_M, STRUCTURE_M = 1.6, 0.8
START = pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, WALL_M]))  # looks at the wall z = 0
PERIOD_NS = 66_000_000


def wall(rng):
    return np.column_stack([rng.uniform([-3.0, -2.4], [3.0, 2.4], (9000, 2)), rng.uniform(-0.03, 0.03, 9000)])


def structure(frac, rng, count=3000):
    """Points (n, 3) in camera axes that fill the bottom of the picture, this share of its area."""
    half = 0.5 * SIZE / [CAMERA.fx_px, CAMERA.fy_px] * STRUCTURE_M
    side = np.sqrt(frac)
    flat = rng.uniform([-side * half[0], (1.0 - 2.0 * side) * half[1]], [side * half[0], half[1]], (count, 2))
    return np.column_stack([flat, STRUCTURE_M + rng.uniform(-0.05, 0.05, count)])


def sight(world, T_world_cam, own, k, rng):
    """One pair; what lies behind the structure's rectangle is hidden by it."""
    seen = transform_points(inverse_pose(T_world_cam), world)
    eyes = []
    for places, fixed in zip(project_stereo(CAMERA, seen), project_stereo(CAMERA, own), strict=True):
        if len(own):
            low, high = np.nanmin(fixed, axis=0), np.nanmax(fixed, axis=0)
            places[((places > low) & (places < high)).all(axis=1)] = np.nan
        both = np.concatenate([places, fixed]) + rng.normal(0.0, 0.08, (len(places) + len(fixed), 2))
        both[((both < BORDER_PX) | (both > SIZE - BORDER_PX)).any(axis=1)] = np.nan
        eyes.append(both)
    return PointSight(k * PERIOD_NS + 1, CAMERA, eyes[0], eyes[1], rng)


def drive(frac, step_m, n=14, rest=2, own_moves=None):
    """(found, true offset (3,) in vo) of a camera that stands, then goes sideways past the wall."""
    rng = np.random.default_rng(3)
    world, own, odometry, out = wall(rng), structure(frac, rng), StereoOdometry(CAMERA, SETTINGS), []
    for k in range(n):
        way = step_m * max(0, k - rest)
        T = START @ pose(np.eye(3), np.array([way, 0.0, 0.0]))
        shifted = own if own_moves is None else own + own_moves * k
        found = odometry.process_sight(sight(world, T, shifted, k, rng))
        out.append((found, np.array([way, 0.0, 0.0])))
    return odometry, out


def off_m(found, true):
    return float(np.linalg.norm(found.T_vo_cam[:3, 3] - true))


def is_held(found, true):
    error = found.T_vo_cam[:3, 3] - true
    return bool(error @ np.linalg.solve(found.covariance[3:, 3:], error) < 16.0)


@pytest.mark.parametrize("step_m", [0.0003, 0.002, 0.004, 0.012])
@pytest.mark.parametrize("frac", [0.12, 0.24, 0.3, 0.4])
def test_structure_that_moves_with_the_camera_does_not_pull_the_pose(frac, step_m):
    _, out = drive(frac, step_m)
    assert all(found.status is OdometryStatus.OK for found, _ in out), [found.reason for found, _ in out]
    assert max(off_m(*one) for one in out) < 1.5e-3, "m"
    assert all(off_m(*one) < 1e-3 or is_held(*one) for one in out), "slow motion that hides in the noise is held"


def test_what_was_recognised_as_own_stays_out():
    odometry, out = drive(0.3, 0.004, n=30)
    own = structure(0.3, np.random.default_rng(3), 400)
    left_px = project_stereo(CAMERA, own)[0]
    inside = ((left_px > 60) & (left_px < SIZE - 60)).all(axis=1)
    assert odometry.on_own_structure(left_px[inside]).mean() > 0.9
    above = np.array([[300.0, 100.0], [900.0, 150.0], [640.0, 60.0]])
    assert not odometry.on_own_structure(above).any()
    assert out[-1][0].n_points > 100


def test_a_thing_that_moves_before_a_standing_camera_is_not_the_world():
    moving = np.array([0.002, 0.0, 0.0])
    odometry, out = drive(0.3, 0.0, n=14, own_moves=moving)
    for found, true in out:
        assert off_m(found, true) < 6e-4 or found.status is not OdometryStatus.OK
    assert out[-1][0].status is OdometryStatus.OK
    assert not odometry.on_own_structure(np.array([[300.0, 100.0], [900.0, 150.0]])).any()


def test_half_a_picture_that_stands_still_is_doubtful():
    _, out = drive(0.62, 0.004, rest=0)
    assert out[-1][0].status is not OdometryStatus.OK
    for found, true in out:
        assert found.status is not OdometryStatus.OK or off_m(found, true) < 6e-4
        assert off_m(found, true) < 6e-4 or is_held(found, true)


def test_the_rows_of_both_eyes_tell_the_noise_whatever_moves():
    rng = np.random.default_rng(5)
    points = rng.uniform([-0.8, -0.5, 1.0], [0.8, 0.5, 1.6], (400, 3))
    points[200:, 0] += 0.05  # a second motion
    left = points[:, :2] / points[:, 2:]
    right = (points[:, :2] - [0.12, 0.0]) / points[:, 2:]
    for factor in (1.0, 2.5):
        noise = rng.normal(0.0, factor * 0.08 / 528.0, (2, 400, 2))
        seen = StereoPoints(points, np.zeros((400, 3, 3)), left + noise[0], right + noise[1], 0.08, 528.0, 0.12)
        assert row_factor(seen) == pytest.approx(factor, rel=0.15)
    assert row_factor(replace(seen, rays_right=np.full((400, 2), np.nan))) == 1.0


def test_a_smaller_picture_has_room_for_fewer_points():
    settings = OdometrySettings()
    assert settings.count_good((720, 1280)) == 60
    assert settings.count_good((480, 752)) == 24, "EuRoC: 53 points were right to 0.2 mm"
    assert settings.count_good((2160, 3840)) == 60, "no more than are tracked"
    assert settings.count_good((120, 160)) == settings.inliers_min
