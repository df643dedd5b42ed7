"""Points of boards beside markers, planar starts, choice by time, and covariances near the frontal view."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from vision_scenes import deviation, facing_pose, machine, sight, single_marker

from machine.camera import project_stereo
from machine.markers import marker_corners
from machine.poses import transform_points
from machine.rotations import geodesic_angle, rotation_from_rotvec
from server.vision.ambiguity import PRIOR_AGE_MAX_S, PosePrior, mirrored_pose, prior_from
from server.vision.contracts import PoseStatus
from server.vision.object_pose import PoseSettings, estimate_object_pose
from server.vision.planar_pose import planar_poses, point_poses
from server.vision.pose_problem import PointSighting, Sighting

CAMERA = machine().camera
GRID = np.array([[x, y, 0.0] for y in (0.06, 0.02, -0.02, -0.06) for x in (-0.08, -0.04, 0.0, 0.04, 0.08)])
SOLID = np.array(
    [[0.0, 0.0, 0.0], [0.1, 0.0, 0.02], [0.0, 0.12, 0.05], [-0.1, 0.0, 0.08], [0.0, -0.1, 0.03], [0.05, 0.05, 0.1]]
)


def points_seen(points, T, rng=None, sigma_px=0.0, eyes="lr", hidden=((), ())) -> PointSighting:
    pixels = list(project_stereo(CAMERA, transform_points(T, points)))
    for px, rows in zip(pixels, hidden, strict=True):
        px += 0.0 if rng is None else rng.normal(0.0, sigma_px, px.shape)
        px[list(rows)] = np.nan
    left, right = (px if name in eyes else None for px, name in zip(pixels, "lr", strict=True))
    return PointSighting("board 3", 3, points, left, right)


def estimate(sightings, sigma_px=0.1, **more):
    return estimate_object_pose("ooi", sightings, CAMERA, PoseSettings(sigma_px=sigma_px), **more)


@pytest.mark.parametrize("points", [GRID, SOLID], ids=["flat", "solid"])
@pytest.mark.parametrize("eyes", ["l", "r", "lr"])
def test_points_give_the_exact_pose(points, eyes):
    T = facing_pose(0.8, 25.0, 40.0, (0.1, -0.05))
    found, (view,) = estimate((points_seen(points, T, eyes=eyes),))
    assert found.status is PoseStatus.OK
    assert np.abs(deviation(found.T_cam_object, T)).max() < 1e-6, "rad, m"
    assert (view.marker_id, view.used) == (3, True)
    assert found.marker_ids == (3,)


def test_points_that_an_eye_does_not_see_are_left_out():
    T = facing_pose(0.8, 25.0, 40.0)
    seen = points_seen(GRID, T, hidden=(range(0, 12), range(8, 20)))
    found, _ = estimate((seen,))
    assert np.abs(deviation(found.T_cam_object, T)).max() < 1e-6
    nothing, (view,) = estimate((points_seen(GRID, T, hidden=(range(20), range(20))),))
    assert nothing.status is PoseStatus.REJECTED
    assert not view.used


def test_a_board_and_a_marker_are_one_object():
    """Together they are better than the better one alone, and honest."""
    rng, T = np.random.default_rng(2), facing_pose(1.0, 20.0, 100.0)
    squares = []
    exact = (points_seen(GRID, T), *sight([single_marker(0.1)], T))
    together, alone = estimate(exact)[0], estimate(exact[:1])[0]
    assert (np.diag(together.covariance) < np.diag(alone.covariance)).all()
    for _ in range(200):
        both = (points_seen(GRID, T, rng, 0.2), *sight([single_marker(0.1)], T, rng, 0.2))
        found, views = estimate(both, 0.2)
        assert [view.marker_id for view in views] == [3, 7]
        error = deviation(found.T_cam_object, T)
        squares.append(error @ np.linalg.solve(found.covariance, error))
    assert 0.91 < np.mean(np.array(squares) < 12.59) < 0.985, "95 % of chi2 with 6 degrees of freedom"


def test_planar_starts_are_those_of_opencv():
    rng = np.random.default_rng(1)
    for _ in range(100):
        T = facing_pose(rng.uniform(0.3, 2.0), rng.uniform(0, 65), rng.uniform(0, 360), rng.uniform(-0.2, 0.2, 2))
        corners = transform_points(T, marker_corners(0.15))
        rays = corners[:, :2] / corners[:, 2:] + rng.normal(0.0, 3e-4, (4, 2))
        ours = planar_poses(rays, 0.15)
        count, rvecs, tvecs, _ = cv2.solvePnPGeneric(
            marker_corners(0.15), rays.reshape(-1, 1, 2), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        assert len(ours) == count == 2
        for one, rvec, tvec in zip(ours, rvecs, tvecs, strict=True):
            assert geodesic_angle(one[:3, :3], cv2.Rodrigues(rvec)[0]) < 1e-6
            assert one[:3, 3] == pytest.approx(tvec.ravel(), abs=1e-6)


@pytest.mark.parametrize("points", [GRID[:3], GRID[:5]], ids=["three", "on a line"])
def test_points_without_a_pose_have_none(points):
    rays = transform_points(facing_pose(1.0), points)[:, :2]
    assert point_poses(rays, points) == ()


def ambiguous_look():
    """A look at a far, small marker whose two orientations fit alike, and its two poses."""
    rng, T = np.random.default_rng(4), facing_pose(1.8, 12.0, 20.0)
    for _ in range(50):
        seen = sight([single_marker(0.1)], T, rng, 0.2, eyes="l")
        found, _ = estimate(seen, 0.2)
        if found.status is PoseStatus.ORIENTATION_AMBIGUOUS and found.chi2_margin < 4.0:
            return seen, T
    raise AssertionError("no ambiguous look in 50")


def prior_at(T, age_s=0.1):
    return PosePrior(T, np.diag([0.01**2] * 3 + [0.003**2] * 3), age_s)


def test_time_chooses_where_images_cannot():
    seen, T = ambiguous_look()
    found, _ = estimate(seen, 0.2, prior=prior_at(T))
    assert found.status is PoseStatus.OK
    assert "s ago" in found.reason
    assert geodesic_angle(found.T_cam_object[:3, :3], T[:3, :3]) < np.deg2rad(8.0)
    assert prior_from(found, 0.02) is None, "a choice by time must not pass itself on"


def test_a_prior_that_may_not_count_does_not():
    seen, T = ambiguous_look()
    far = T.copy()
    far[:3, :3] = rotation_from_rotvec(np.array([0.0, 0.0, 1.0])) @ far[:3, :3]
    for prior in (
        prior_at(T, age_s=PRIOR_AGE_MAX_S + 0.01),
        prior_at(far),
        replace(prior_at(T), covariance=np.diag([0.5**2] * 3 + [0.01**2] * 3)),
    ):
        assert estimate(seen, 0.2, prior=prior)[0].status is PoseStatus.ORIENTATION_AMBIGUOUS


def test_a_prior_never_overrules_clear_images():
    rng, T = np.random.default_rng(5), facing_pose(0.6, 30.0, 20.0)
    seen = sight([single_marker(0.15)], T, rng, 0.1)
    alone, _ = estimate(seen)
    wrong = mirrored_pose(T, np.zeros((1, 3)), np.array([0.06]))
    with_prior, _ = estimate(seen, prior=prior_at(wrong))
    assert with_prior.T_cam_object == pytest.approx(alone.T_cam_object)
    assert with_prior.reason == ""


def test_ambiguous_covariance_holds_both_orientations():
    seen, T = ambiguous_look()
    found, _ = estimate(seen, 0.2)
    for truth in (T, mirrored_pose(T, np.zeros((1, 3)), np.zeros(1))):
        error = deviation(found.T_cam_object, truth)[:3]
        assert error @ np.linalg.solve(found.covariance[:3, :3], error) < 20.0


@pytest.mark.parametrize(("eyes", "sigma_px"), [("lr", 0.3), ("l", 0.1)])
def test_covariance_near_the_frontal_view_is_honest(eyes, sigma_px):
    """The valley between the two orientations: normal equations alone hold the tilt in 80 to 88 % here."""
    rng = np.random.default_rng(6)
    inside, n = 0, 0
    for _ in range(300):
        T = facing_pose(0.8, rng.uniform(0.0, 3.0), rng.uniform(0, 360), (0.05, 0.03))
        found, _ = estimate(sight([single_marker(0.1)], T, rng, sigma_px, eyes=eyes), sigma_px)
        if found.status is PoseStatus.OK:
            error = deviation(found.T_cam_object, T)[:2]
            inside += error @ np.linalg.solve(found.covariance[:2, :2], error) < 5.99
            n += 1
    assert n > 200
    assert 0.90 < inside / n < 0.99


def test_one_eye_knows_its_range_badly_and_says_so():
    rng, T = np.random.default_rng(7), facing_pose(1.2, 35.0, 60.0, (0.1, 0.0))
    errors, sigmas = [], []
    for _ in range(250):
        found, _ = estimate(sight([single_marker(0.1)], T, rng, 0.2, eyes="r"), 0.2)
        errors.append(found.T_cam_object[2, 3] - T[2, 3])
        sigmas.append(np.sqrt(found.covariance[5, 5]))
    assert np.std(errors) == pytest.approx(np.mean(sigmas), rel=0.12)


def test_raw_noise_near_the_border_is_weighed_by_the_lens():
    """Noise is even in raw pixels; undistorted, it is not."""
    rng, squares = np.random.default_rng(8), []
    T = facing_pose(0.45, 20.0, 60.0, (0.42, 0.2))
    for _ in range(300):
        found, _ = estimate(sight([single_marker(0.1)], T, rng, 0.2), 0.2)
        error = deviation(found.T_cam_object, T)
        squares.append(error @ np.linalg.solve(found.covariance, error))
    assert np.mean(squares) == pytest.approx(6.0, rel=0.12)


def test_a_sighting_still_names_its_marker():
    one = Sighting(single_marker(0.1), None, None)
    assert one.target_id == 7
