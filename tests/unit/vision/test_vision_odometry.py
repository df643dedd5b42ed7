"""Stereo odometry on the rendered wall: millimetres over a folded path, honest states, no drift on return."""

from itertools import pairwise

import cv2
import numpy as np
import pytest
from vision_scenes import deviation, machine, renderer, tcp_in_ooi

from machine.camera import project_stereo
from machine.markers import marker_corners
from machine.poses import inverse_pose, pose, transform_points
from machine.rotations import rotation_from_rotvec
from server.vision.contracts import OdometryStatus
from server.vision.odometry import StereoOdometry
from server.vision.odometry_align import align_reference_patches
from server.vision.odometry_features import allowed_mask, covered_cell_count, inside_mask, spread_corners
from server.vision.odometry_motion import covariance_in_vo, predict_pose, with_scale_error
from server.vision.odometry_pose import StereoPoints, coarse_pose, refine_camera

CAMERA = machine().camera
DISTANCE_M = 0.75  # of the tool; the wall is 1.3 m from the camera
PERIOD_NS = 100_000_000


def tool_polygons():
    T_cam_tool = inverse_pose(machine().T_tcp_cam_left) @ machine().T_tcp_tool
    return [[eye] for eye in project_stereo(CAMERA, transform_points(T_cam_tool, marker_corners(0.17)))]


def folded_path(points_per_leg: int):
    """T_ooi_tcp along a folded, asymmetric path of 1.0 m that ends where it began, with some rotation."""
    corners = np.array([[0.0, 0.0], [0.3, 0.0], [0.12, 0.2], [0.0, 0.05], [0.2, 0.1], [0.0, 0.0]])
    for start, end in pairwise(corners):
        for s in np.linspace(0.0, 1.0, points_per_leg, endpoint=False):
            x, y = start + (end - start) * (s * s * (3.0 - 2.0 * s))
            yield tcp_in_ooi(DISTANCE_M, (x, y), (6.0 * x, 10.0 * y, 5.0 * x))
    yield tcp_in_ooi(DISTANCE_M, tuple(corners[-1]))


def run(odometry, poses, contrast_frac=1.0, seed=1):
    """(found poses, T_vo_cam truths); the first truth is identity."""
    rng = np.random.default_rng(seed)
    found, truths, T_first = [], [], None
    for k, T_ooi_tcp in enumerate(poses):
        T_ooi_cam = T_ooi_tcp @ machine().T_tcp_cam_left
        T_first = T_ooi_cam if T_first is None else T_first
        pair = renderer(contrast_frac).render_static(T_ooi_tcp, rng)
        found.append(odometry.process(*pair, k * PERIOD_NS, *tool_polygons()))
        truths.append(inverse_pose(T_first) @ T_ooi_cam)
    return found, truths


@pytest.fixture(scope="module")
def folded():
    odometry = StereoOdometry(CAMERA)
    found, truths = run(odometry, folded_path(7))
    return odometry, found, truths


def test_folded_path_is_right_to_a_fraction_of_a_millimetre(folded, record_property):
    _, found, truths = folded
    errors = np.array([deviation(one.T_vo_cam, T) for one, T in zip(found, truths, strict=True)])
    worst_mm = 1e3 * np.linalg.norm(errors[:, 3:], axis=1).max()
    record_property("worst_mm", float(worst_mm))
    assert all(one.status is OdometryStatus.OK for one in found)
    assert worst_mm < 1.0, "mm over 1 m; the goal is 3"
    assert np.rad2deg(np.linalg.norm(errors[:, :3], axis=1)).max() < 0.05, "deg"


def test_coming_back_costs_no_drift(folded):
    _, found, _ = folded
    assert np.linalg.norm(found[-1].T_vo_cam[:3, 3]) < 2e-4, "m"


def test_covariance_holds_the_error(folded):
    _, found, truths = folded
    squares = []
    for one, T in zip(found[1:], truths[1:], strict=True):
        error = deviation(one.T_vo_cam, T)
        squares.append(error @ np.linalg.solve(one.covariance, error))
    assert np.median(squares) < 16.8, "99 % of chi2 with 6 degrees of freedom"
    assert np.sqrt(np.diag(found[-1].covariance)[3:]).max() < 1e-3, "m: and it is no empty promise"


def test_slow_motion_stays_on_the_first_keyframe(folded):
    odometry, _, _ = folded
    assert len(odometry.keyframes) <= 3


def test_black_pairs_are_lost_and_the_map_survives():
    odometry = StereoOdometry(CAMERA)
    found, _ = run(odometry, list(folded_path(7))[:4])
    black = np.zeros((720, 1280), np.uint8)
    for k in range(3):
        lost = odometry.process(black, black, (4 + k) * PERIOD_NS)
        assert lost.status is OdometryStatus.LOST
        assert lost.reason
        assert lost.T_vo_cam == pytest.approx(found[-1].T_vo_cam)
        assert lost.covariance[3, 3] > 1.0, "m^2: nothing is known"
    T_ooi_tcp = tcp_in_ooi(DISTANCE_M, (0.1, 0.05))
    again = odometry.process(*renderer().render_static(T_ooi_tcp), 9 * PERIOD_NS, *tool_polygons())
    T_first = tcp_in_ooi(DISTANCE_M) @ machine().T_tcp_cam_left
    truth = inverse_pose(T_first) @ T_ooi_tcp @ machine().T_tcp_cam_left
    assert again.status is OdometryStatus.OK
    assert np.linalg.norm(deviation(again.T_vo_cam, truth)[3:]) < 1e-3, "m"


def test_a_start_without_texture_is_lost_and_recovers():
    odometry = StereoOdometry(CAMERA)
    grey = np.full((720, 1280), 120, np.uint8)
    first = odometry.process(grey, grey, 0)
    assert first.status is OdometryStatus.LOST
    assert "texture" in first.reason
    found, _ = run(odometry, list(folded_path(7))[:2])
    assert found[0].status is OdometryStatus.OK
    assert found[0].T_vo_cam == pytest.approx(np.eye(4))


def test_little_texture_is_degraded_or_lost_before_it_is_wrong():
    rng = np.random.default_rng(4)
    left, right = renderer().render_static(tcp_in_ooi(DISTANCE_M), rng)
    covered = [
        np.array([[0.0, 0.0], [1280, 0], [1280, 520], [0, 520]]),
        np.array([[300, 500], [1280, 500], [1280, 720], [300, 720]]),
    ]
    odometry = StereoOdometry(CAMERA)
    first = odometry.process(left, right, 0, covered, covered)
    assert first.status is not OdometryStatus.OK
    assert first.reason


def test_another_image_size_is_lost_by_name():
    odometry = StereoOdometry(CAMERA)
    small = np.zeros((360, 640), np.uint8)
    assert "360" in odometry.process(small, small, 0).reason


def test_reset_starts_a_new_frame(folded):
    odometry = StereoOdometry(CAMERA)
    run(odometry, list(folded_path(7))[:3])
    odometry.reset()
    found, _ = run(odometry, list(folded_path(7))[4:5])
    assert found[0].T_vo_cam == pytest.approx(np.eye(4))
    assert odometry.keyframes[0].n_points > 100


def test_masked_places_hold_no_features():
    rng = np.random.default_rng(2)
    image = rng.integers(0, 255, (720, 1280)).astype(np.uint8)
    polygon = np.array([[200.0, 100.0], [700.0, 120.0], [650.0, 500.0]])
    mask = allowed_mask(image.shape, [polygon])
    corners = spread_corners(image, mask, 400, np.array([[900.0, 400.0]]))
    assert len(corners) > 150
    assert inside_mask(mask, corners).all()
    assert np.linalg.norm(corners - [900, 400], axis=1).min() > 20
    assert covered_cell_count(corners, image.shape) > 25
    assert not inside_mask(mask, np.array([[np.nan, 3.0], [-4.0, 9.0], [1e9, 5.0]])).any()


def test_patches_are_found_to_a_hundredth_of_a_pixel():
    rng = np.random.default_rng(3)
    base = cv2.GaussianBlur(rng.integers(0, 255, (400, 400)).astype(np.float32), (0, 0), 2.0) * 4 - 380
    shift = np.array([0.375, -0.625])  # thirty-seconds: OpenCV's warp rounds to them
    moved = cv2.warpAffine(base, np.array([[1, 0, shift[0]], [0, 1, shift[1]]]), (400, 400), flags=cv2.INTER_LANCZOS4)
    reference, image = (np.clip(one, 0, 255).astype(np.uint8) for one in (base, 0.8 * moved + 20))
    points = rng.uniform(60, 340, (60, 2)).round()
    found = align_reference_patches(
        reference, points, np.tile(np.eye(2), (60, 1, 1)), image, points + rng.uniform(-1, 1, (60, 2))
    )
    assert found.valid.mean() > 0.9
    error = (found.points_px - points - shift)[found.valid]
    assert np.abs(error.mean(axis=0)).max() < 0.01, "px"
    assert error.std() < 0.05, "px"


def stereo_points(rng, n=120, sigma_px=0.1, outliers=0):
    T_cam_vo = pose(rotation_from_rotvec(np.array([0.02, -0.03, 0.05])), np.array([0.1, -0.05, 0.02]))
    points = rng.uniform([-0.8, -0.5, 1.0], [0.8, 0.5, 1.6], (n, 3))
    cam = transform_points(T_cam_vo, points)
    noise = rng.normal(0.0, sigma_px / 528.0, (2, n, 2))
    left = cam[:, :2] / cam[:, 2:] + noise[0]
    right = (cam[:, :2] - [0.12, 0.0]) / cam[:, 2:] + noise[1]
    left[:outliers] += rng.uniform(-0.2, 0.2, (outliers, 2))
    right[n - 10 :] = np.nan
    return T_cam_vo, StereoPoints(points, np.zeros((n, 3, 3)), left, right, sigma_px, 528.0, 0.12)


def test_camera_pose_is_at_the_bound_and_survives_outliers():
    rng = np.random.default_rng(8)
    squares = []
    for outliers in [0] * 40 + [25] * 40:
        T_cam_vo, seen = stereo_points(rng, outliers=outliers)
        coarse = coarse_pose(seen.points_vo, seen.rays_left, seen.focal_px)
        assert coarse is not None
        fit = refine_camera(coarse.T_cam_vo, seen)
        assert fit is not None
        error = deviation(fit.T_cam_vo, T_cam_vo)
        squares.append(error @ np.linalg.solve(fit.covariance, error))
        assert not fit.inliers[:outliers].any() or fit.inliers[:outliers].mean() < 0.1
    assert 4.0 < np.mean(squares) < 8.0, "chi2 of 6 degrees of freedom has mean 6"


def test_too_few_or_degenerate_points_give_no_pose():
    rng = np.random.default_rng(9)
    _, seen = stereo_points(rng)
    assert coarse_pose(seen.points_vo[:5], seen.rays_left[:5], 528.0) is None
    same = StereoPoints(np.ones((4, 3)), np.zeros((4, 3, 3)), np.ones((4, 2)), np.ones((4, 2)), 1.0, 528.0, 0.12)
    assert refine_camera(np.eye(4), same) is None


def test_prediction_follows_the_last_motion():
    step = pose(rotation_from_rotvec(np.array([0.0, 0.02, 0.0])), np.array([0.01, 0.0, 0.0]))
    T = pose(rotation_from_rotvec(np.array([0.1, 0.0, 0.2])), np.array([1.0, 2.0, 3.0]))
    assert predict_pose(T, step, 100, 200) == pytest.approx(T @ step @ step, abs=1e-3)
    assert predict_pose(T, step, 100, 0) == pytest.approx(T)
    assert predict_pose(T, step, 100, -5) == pytest.approx(T)
    assert predict_pose(T, step, 100, 10_000) == pytest.approx(T)


def test_covariance_of_the_inverse_pose_is_that_of_many_draws():
    rng = np.random.default_rng(10)
    T = pose(rotation_from_rotvec(np.array([0.3, -0.2, 0.5])), np.array([0.4, -0.3, 1.2]))
    root = rng.normal(size=(6, 6)) * 1e-3
    draws = []
    for _ in range(4000):
        step = root @ rng.normal(size=6)
        disturbed = pose(rotation_from_rotvec(step[:3]) @ T[:3, :3], T[:3, 3] + step[3:])
        draws.append(deviation(inverse_pose(disturbed), inverse_pose(T)))
    predicted = covariance_in_vo(T, root @ root.T)
    assert np.cov(np.array(draws).T) == pytest.approx(predicted, abs=0.08 * np.abs(predicted).max())


def test_unknown_scale_grows_with_the_way():
    grown = with_scale_error(np.zeros((6, 6)), np.array([0.3, 0.0, 0.0]), 0.004)
    assert np.sqrt(np.diag(grown)) == pytest.approx([0, 0, 0, 0.0012, 0, 0])
