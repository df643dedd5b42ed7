"""The odometry's parts: gates, rolling shutter, learned readout, recognition, joint covariances, adjustment."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from vision_scenes import deviation, machine, renderer, tcp_in_ooi

from benchmarks.vision.odometry.features import run_points
from machine.camera import project_stereo
from machine.poses import inverse_pose, pose, transform_points
from machine.rotations import rotation_from_rotvec
from server.vision.contracts import OdometryStatus
from server.vision.odometry import OdometrySettings, StereoOdometry
from server.vision.odometry_covariance import KeyframeCovariances, readout_of
from server.vision.odometry_features import recognise
from server.vision.odometry_keyframe import ray_sigma, triangulated
from server.vision.odometry_motion import Motion, moved_by_twist, row_fractions, standing_motion
from server.vision.odometry_sensitivity import Sensitivity
from server.vision.odometry_sight import StereoMatches, optical_flow, plausible_match_mask

CAMERA = machine().camera
PINHOLE = replace(CAMERA, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))


def textured(seed: int, shape=(300, 400)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    base = cv2.GaussianBlur(rng.normal(0.0, 1.0, shape).astype(np.float32), (0, 0), 2.0)
    return np.clip(128 + 40 * base / base.std(), 0, 255).astype(np.uint8)


def test_epipolar_gate_chirality_and_image_border():
    left = np.array([[0.1, 0.1]] * 5)
    centre = np.array([PINHOLE.cx_px, PINHOLE.cy_px])
    place = centre + 52.8
    right = place + np.array([[-30.0, 0.3], [-30.0, 1.4], [30.0, 0.0], [-1.0, 0.0], [-700.0, 0.0]])
    good = plausible_match_mask(PINHOLE, left, right, np.ones(5, dtype=bool))
    assert good.tolist() == [True, False, False, False, False], "row gate, behind the eyes, too far, outside"


def test_flow_that_does_not_come_back_is_refused():
    first = textured(1)
    second = first.copy()
    second[100:200, 100:200] = textured(2)[100:200, 100:200]
    points = np.stack(np.meshgrid(np.arange(40.0, 380, 20), np.arange(40.0, 280, 20)), axis=-1).reshape(-1, 2)
    gone = ((points > 110) & (points < 190)).all(axis=1)
    still = ((points < 80) | (points > 220)).any(axis=1)
    found = optical_flow(first, second, points)
    assert found.valid[still].all()
    assert found.valid[gone].mean() < 0.5


def test_triangulation_and_its_covariance_are_those_of_many_draws():
    rng = np.random.default_rng(3)
    point = np.array([[0.7, -0.4, 1.3]])
    exact = np.concatenate(project_stereo(CAMERA, point), axis=1)
    noisy = exact + rng.normal(0.0, 0.1, (20_000, 4))
    found, _ = triangulated(CAMERA, StereoMatches(noisy[:, :2], noisy[:, 2:]), 0.1)
    _, covariance = triangulated(CAMERA, StereoMatches(exact[:, :2], exact[:, 2:]), 0.1)
    assert np.cov(found.T) == pytest.approx(covariance[0], abs=0.04 * np.abs(covariance[0]).max())
    assert found.mean(axis=0) == pytest.approx(point[0], abs=1e-4), "m"


def test_a_pixel_at_the_border_is_worth_more_than_one_in_the_middle():
    sigma = ray_sigma(CAMERA, np.array([[0.0, 0.0], [1.1, 0.6], [np.nan, np.nan]]))
    assert sigma[0] == pytest.approx(1.0)
    assert sigma[1] > 1.05
    assert sigma[2] == 1.0


def test_points_of_a_moving_camera_go_the_other_way():
    twist = np.array([0.0, 0.1, 0.0, 0.2, 0.0, 0.0])
    point = np.array([[0.3, 0.2, 1.5]])
    T = pose(rotation_from_rotvec(0.01 * twist[:3]), 0.01 * twist[3:])
    moved = moved_by_twist(point, twist, np.array([0.01]))
    assert moved == pytest.approx(transform_points(inverse_pose(T), point), abs=5e-6)
    assert row_fractions(np.array([0.0, 359.5, 719.0]), 720) == pytest.approx([-0.5, 0.0, 0.5])


def test_velocity_is_carried_on_and_unknown_after_a_gap():
    def at(t_s: float) -> np.ndarray:
        return pose(np.eye(3), np.array([0.1 * t_s + 0.15 * t_s**2, 0.0, 0.0]))

    motion: Motion = standing_motion(at(0.0), 0)
    assert not motion.is_velocity_known
    for k in (1, 2, 3):
        motion = motion.moved_to(at(0.03 * k), 30_000_000 * k)
    assert motion.twist().velocity[3] == pytest.approx(0.1 + 0.3 * 0.09, abs=1e-6), "m/s at the last pose"
    late = motion.moved_to(at(2.0), 2_000_000_000)
    assert not late.is_velocity_known
    assert late.twist().sigma[3] > 0.1, "m/s: nothing is known"


def test_a_told_readout_stays_and_an_unknown_one_is_learned():
    assert readout_of(0.011).updated_with_step(0.5, 1e9).value_s == 0.011
    readout = readout_of(None)
    for _ in range(60):
        readout = readout.updated_with_step(0.011 - readout.value_s, 2e7)
    assert readout.value_s == pytest.approx(0.011, abs=3e-4), "s"
    assert readout.sigma_s < 1e-3


def test_recognition_finds_a_turned_and_shifted_image():
    first = textured(5, (480, 640))
    turn = np.asarray(cv2.getRotationMatrix2D((320, 240), 12.0, 1.0)) + np.array([[0, 0, 60.0], [0, 0, -35.0]])
    second = np.asarray(cv2.warpAffine(first, turn, (640, 480)), np.uint8)
    mask = np.full(first.shape, 255, np.uint8)
    places, found = recognise(first, mask, second, mask)
    truth = places @ turn[:, :2].T + turn[:, 2]
    assert len(places) > 50
    assert np.mean(np.linalg.norm(found - truth, axis=1) < 3.0) > 0.5
    black = np.zeros_like(first)
    assert len(recognise(first, mask, black, mask)[0]) == 0


def test_an_error_taken_over_from_a_keyframe_is_told_once():
    known = KeyframeCovariances()
    known.add(np.diag([0, 0, 0, 4.0, 4.0, 4.0]), None, np.zeros(6))
    follow = np.concatenate([np.eye(6), np.zeros((6, 6))], axis=1)
    one = Sensitivity((0,), follow[None], np.zeros((6, 6)), np.zeros(6), 0.0, 0.0)
    known.add(known.pose_covariance(one), one, np.zeros(6))
    both = Sensitivity((0, 1), 0.5 * np.stack([follow, follow]), np.zeros((6, 6)), np.zeros(6), 0.0, 0.0)
    assert known.pose_covariance(both)[3, 3] == pytest.approx(4.0), "the same error twice: no averaging"
    known.remove(0)
    assert known.pose_covariance(one)[3, 3] == pytest.approx(4.0)


def test_simulated_points_are_inside_their_ellipsoids():
    runs = [run_points(seed) for seed in range(900, 905)]
    squares = np.concatenate([run["position_chi2"] + run["rotation_chi2"] for run in runs])
    assert len(squares) > 180
    assert 0.85 < np.mean(squares < 7.81) < 1.0
    assert max(run["n_keyframes"] for run in runs) > 1, "the map's adjustment took part"
    assert sum(run["n_lost"] for run in runs) == 0


def test_moved_in_the_dark_the_map_is_recognised():
    odometry = StereoOdometry(CAMERA, OdometrySettings(readout_s=0.0))
    start = tcp_in_ooi(0.75)
    odometry.process(*renderer().render_static(start), 0)
    odometry.process(*renderer().render_static(tcp_in_ooi(0.75, (0.01, 0.0))), 100_000_000)
    black = np.zeros((720, 1280), np.uint8)
    assert odometry.process(black, black, 200_000_000).status is OdometryStatus.LOST
    moved = tcp_in_ooi(0.75, (0.25, -0.15), (4.0, -5.0, 15.0))
    found = odometry.process(*renderer().render_static(moved), 3_000_000_000)
    T_tcp_cam = machine().T_tcp_cam_left
    truth = inverse_pose(start @ T_tcp_cam) @ moved @ T_tcp_cam
    assert found.status is not OdometryStatus.LOST, found.reason
    assert np.linalg.norm(deviation(found.T_vo_cam, truth)[3:]) < 2e-3, "m"


def test_darkness_is_not_held_against_the_map():
    odometry = StereoOdometry(CAMERA, OdometrySettings(readout_s=0.0))
    pair = renderer().render_static(tcp_in_ooi(0.75))
    first = odometry.process(*pair, 0)
    black = np.zeros((720, 1280), np.uint8)
    for k in range(1, 12):
        odometry.process(black, black, 30_000_000 * k)
    again = odometry.process(*pair, 400_000_000)
    assert again.n_points > 0.9 * first.n_points
