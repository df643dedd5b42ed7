"""A X = X B and A X = Y B: exact recovery, noise, outliers, scale, clock offset, covariance; real arms and kinhec."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.hand_eye.kinhec_tracks import kinhec_available
from benchmarks.hand_eye.real_pairs import align_trajectories, hand_eye_residuals
from machine.poses import moved_pose, pose
from machine.rotations import geodesic_angle, rotation_from_rotvec, rotvec_from_rotation
from server.calibration.checks import CalibrationInputError
from server.calibration.contracts import CalibrationStatus
from server.calibration.hand_eye import HandEyeSettings, estimate_hand_eye, solve_ax_yb
from server.calibration.hand_eye_fit import HandEyeUnknowns, PoseModel, inverse_poses, park_martin

DATA = Path(__file__).parents[4] / "shared" / "data"
X_TRUE = pose(rotation_from_rotvec(np.array([0.3, -0.8, 1.1])), np.array([0.05, -0.02, 0.11]))
Y_TRUE = pose(rotation_from_rotvec(np.array([-1.0, 0.4, 0.2])), np.array([0.9, 0.1, 0.4]))


def hand_poses(t):
    """A smooth motion of the hand: turns by up to 0.5 rad about all axes, moves by 0.2 m."""
    vectors = 0.5 * np.column_stack((np.sin(1.1 * t), np.sin(0.7 * t + 1.0), np.cos(0.9 * t)))
    As = np.tile(np.eye(4), (len(t), 1, 1))
    As[:, :3, :3] = Rotation.from_rotvec(vectors).as_matrix()
    As[:, :3, 3] = 0.2 * np.column_stack((np.cos(0.8 * t), np.sin(1.3 * t), np.sin(0.5 * t)))
    return As


def seen_target(As, rng, rotation_deg=0.0, position_m=0.0):
    """Target in the camera, with noise in camera axes."""
    Ts = inverse_poses(As @ X_TRUE) @ Y_TRUE
    noise = np.deg2rad(rotation_deg) * rng.normal(size=(len(As), 3))
    Ts[:, :3, :3] = Rotation.from_rotvec(noise).as_matrix() @ Ts[:, :3, :3]
    Ts[:, :3, 3] += position_m * rng.normal(size=(len(As), 3))
    return Ts


def errors_of(found):
    assert found.status is CalibrationStatus.OK, found.reason
    assert found.T_hand_cam is not None
    return np.rad2deg(geodesic_angle(found.T_hand_cam, X_TRUE)), 1e3 * np.linalg.norm(
        found.T_hand_cam[:3, 3] - X_TRUE[:3, 3]
    )


def test_exact_poses_give_exact_x_and_y():
    As = hand_poses(np.arange(0.0, 12.0, 0.4))
    found = solve_ax_yb(As, inverse_poses(seen_target(As, np.random.default_rng(0))))
    degrees, millimetres = errors_of(found)
    assert degrees < 1e-4
    assert millimetres < 1e-2
    np.testing.assert_allclose(found.T_base_target, Y_TRUE, atol=1e-5)


def test_park_martin_on_motions():
    As = hand_poses(np.arange(0.0, 12.0, 0.4))
    Bs = inverse_poses(seen_target(As, np.random.default_rng(1), 0.1, 0.0005))
    motions = [inverse_poses(Ts[:-5]) @ Ts[5:] for Ts in (As, Bs)]
    assert np.rad2deg(geodesic_angle(park_martin(*motions), X_TRUE)) < 0.2


@pytest.mark.parametrize("share", [0.2, 0.4])
def test_outliers_do_not_matter(share):
    rng = np.random.default_rng(2)
    As = hand_poses(np.arange(0.0, 15.0, 0.25))
    Ts = seen_target(As, rng, 0.2, 0.001)
    wrong = rng.choice(len(Ts), int(share * len(Ts)), replace=False)
    Ts[wrong, :3, :3] = Rotation.random(len(wrong), random_state=4).as_matrix()
    Ts[wrong, :3, 3] += 0.2 * rng.normal(size=(len(wrong), 3))
    degrees, millimetres = errors_of(solve_ax_yb(As, inverse_poses(Ts)))
    assert degrees < 0.3
    assert millimetres < 2.0


@pytest.mark.parametrize("offset_s", [-0.12, 0.0, 0.07])
def test_clock_offset_is_found_and_told(offset_s):
    rng = np.random.default_rng(4)
    t_cam, t_hand = np.arange(0.5, 14.5, 1 / 15), np.arange(0.0, 15.0, 0.02)
    Ts = seen_target(hand_poses(t_cam), rng, 0.2, 0.001)
    found = estimate_hand_eye(t_hand, hand_poses(t_hand), t_cam - offset_s, Ts)
    degrees, millimetres = errors_of(found)
    assert found.time_offset_s == pytest.approx(offset_s, abs=0.003)
    assert abs(found.time_offset_s - offset_s) < 4.0 * found.time_offset_sigma_s + 5e-4
    assert "time offset" in found.reason
    assert degrees < 0.2
    assert millimetres < 2.0


def test_offset_beyond_the_bound_is_refused():
    t_cam, t_hand = np.arange(2.0, 13.0, 1 / 15), np.arange(0.0, 15.0, 0.02)
    Ts = seen_target(hand_poses(t_cam), np.random.default_rng(5), 0.2, 0.001)
    found = estimate_hand_eye(t_hand, hand_poses(t_hand), t_cam - 0.4, Ts)
    assert found.status is CalibrationStatus.POOR_FIT
    assert found.T_hand_cam is None


def test_covariance_is_honest():
    chi2 = []
    quick = HandEyeSettings(n_random_starts=5)
    for seed in range(60):
        As = hand_poses(np.arange(0.0, 15.0, 0.5))
        found = solve_ax_yb(As, inverse_poses(seen_target(As, np.random.default_rng(seed), 0.3, 0.002)), settings=quick)
        assert found.T_hand_cam is not None
        assert found.covariance is not None
        error = np.concatenate(
            (rotvec_from_rotation(X_TRUE[:3, :3] @ found.T_hand_cam[:3, :3].T), (X_TRUE - found.T_hand_cam)[:3, 3])
        )
        chi2.append(error @ np.linalg.solve(found.covariance[:6, :6], error))
    assert 0.6 < np.mean(chi2) / 6.0 < 1.6
    assert np.mean(np.array(chi2) < 12.59) > 0.87


def test_as_few_poses_as_are_taken_tell_an_honest_covariance():
    """Two poses can be fitted exactly, and a distribution with heavy tails then forgets the others."""
    quick = HandEyeSettings(n_random_starts=5)
    inside, told = 0, 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        turns = rng.normal(0.0, np.deg2rad(25.0), (quick.poses_min, 3))
        As = np.array([pose(rotation_from_rotvec(turn), rng.uniform(-0.3, 0.3, 3)) for turn in turns])
        found = solve_ax_yb(As, inverse_poses(seen_target(As, rng, 0.2, 0.002)), quick)
        if found.T_hand_cam is None or found.covariance is None:
            continue
        error = np.concatenate(
            (rotvec_from_rotation(X_TRUE[:3, :3] @ found.T_hand_cam[:3, :3].T), (X_TRUE - found.T_hand_cam)[:3, 3])
        )
        inside += bool(error @ np.linalg.solve(found.covariance[:6, :6], error) < 12.59)
        told += 1
    assert told > 50
    assert inside > 0.83 * told


def test_too_few_poses_are_refused():
    As = hand_poses(np.arange(0.0, 5.5, 0.5))
    assert len(As) == HandEyeSettings().poses_min - 1
    found = solve_ax_yb(As, inverse_poses(seen_target(As, np.random.default_rng(1))))
    assert (found.status, found.reason) == (
        CalibrationStatus.TOO_FEW,
        "11 usable pairs, at least 12 are needed; record more poses",
    )


def test_the_jacobian_against_finite_differences():
    times = np.arange(0.0, 5.0, 0.5)
    Ts = seen_target(hand_poses(times), np.random.default_rng(6))
    model = PoseModel(lambda offset_s: hand_poses(times + offset_s), Ts, free_offset=True)
    at = HandEyeUnknowns(X_TRUE, Y_TRUE)
    residuals, J = model.evaluate(at)
    assert np.abs(residuals).max() < 1e-9
    for k in range(J.shape[2]):
        step = np.zeros(J.shape[2])
        step[k] = 1e-6
        ahead, behind = (model.evaluate(at.moved_by(sign * step))[0] for sign in (1.0, -1.0))
        np.testing.assert_allclose(J[:, :, k], (ahead - behind) / 2e-6, atol=2e-5)


def test_wrong_shapes_raise():
    with pytest.raises(CalibrationInputError, match="must both be"):
        solve_ax_yb(np.zeros((3, 4, 4)), np.zeros((2, 4, 4)))


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "hand_eye").is_dir(), reason="no hand-eye data beside the checkout")
@pytest.mark.parametrize(
    ("name", "degrees", "in_camera_mm", "in_base_mm", "offset_ms"),
    [("real", 0.47, 7.2, 7.4, 25), ("sim", 0.17, 2.0, 2.0, 5)],
)
def test_arms_leave_small_residuals(name, degrees, in_camera_mm, in_base_mm, offset_ms):
    found = hand_eye_residuals(DATA / "hand_eye", name)
    assert found.median_deg <= degrees
    assert found.camera_median_mm <= in_camera_mm
    assert found.base_median_mm <= in_base_mm
    assert 1e3 * abs(found.estimate.time_offset_s) <= offset_ms


@pytest.mark.skipif(not (DATA / "trajectories").is_dir(), reason="no trajectories beside the checkout")
@pytest.mark.parametrize(("name", "rigid_mm"), [("fr2_desk ORB", 8.2), ("fr1_xyz RGB-D SLAM", 13.6)])
def test_alignment_is_evos(name, rigid_mm):
    pytest.importorskip("evo")
    found = align_trajectories(DATA / "trajectories", name)
    assert found.ate_m == pytest.approx(found.evo_ate_m, abs=1e-6)
    assert 1e3 * found.rigid_ate_m < rigid_mm
    assert found.chords_turned_deg < 1.5


@pytest.mark.slow
@pytest.mark.skipif(not kinhec_available(), reason="kinhec is not installed")
@pytest.mark.slow
def test_kinhec_outliers_no_worse_than_its_best_solver(tmp_path):
    from benchmarks.hand_eye.kinhec_tracks import generate, run_track

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        generate(tmp_path)
        found, _ = run_track(tmp_path, "outliers")
    assert found.refused == 0
    assert found.rotation_deg <= 1.1 * found.best_rotation[1]
    assert found.translation_mm <= 1.1 * found.best_translation[1]


T_CAM_S = np.arange(0.4, 12.5, 0.4)


@pytest.mark.parametrize("n", [5, pytest.param(12, marks=pytest.mark.slow)])
def test_poses_weigh_by_what_their_images_say_of_them(n):
    """Each image is poor in its own direction: depth and tilt there have eight times the noise of the others."""
    As = hand_poses(T_CAM_S)
    errors = {"alike": [], "weighted": []}
    for seed in range(n):
        rng = np.random.default_rng(seed)
        axes = Rotation.random(len(As), random_state=seed).as_matrix()
        halves = [(axes * np.square([1.0, 1.0, 8.0]) * s**2) @ np.swapaxes(axes, 1, 2) for s in (np.deg2rad(0.1), 5e-4)]
        covariances = np.zeros((len(As), 6, 6))
        covariances[:, :3, :3], covariances[:, 3:, 3:] = halves
        Ts = seen_target(As, rng)
        noise = np.einsum("nij,nj->ni", np.linalg.cholesky(covariances), rng.normal(size=(len(As), 6)))
        Ts[:, :3, :3] = Rotation.from_rotvec(noise[:, :3]).as_matrix() @ Ts[:, :3, :3]
        Ts[:, :3, 3] += noise[:, 3:]
        Bs = inverse_poses(Ts)
        errors["alike"].append(errors_of(solve_ax_yb(As, Bs)))
        errors["weighted"].append(errors_of(solve_ax_yb(As, Bs, camera_covariances=covariances)))
    alike, weighted = (np.sqrt(np.mean(np.square(errors[key]), axis=0)) for key in ("alike", "weighted"))
    assert (weighted < 0.75 * alike).all(), (alike, weighted)


FOCAL_PX, NOISE_PX = 700.0, 0.3
BOARD = np.stack([*np.meshgrid(np.arange(-3.0, 4.0), np.arange(-2.0, 3.0)), np.zeros((5, 7))], axis=2).reshape(-1, 3)
BOARD_M = 0.03 * BOARD


def projected(T_cam_board):
    points = BOARD_M @ T_cam_board[:3, :3].T + T_cam_board[:3, 3]
    return (FOCAL_PX * points[:, :2] / points[:, 2:]).ravel()


def test_poses_weighted_by_their_images_reach_the_optimum_of_the_reprojection():
    """The images' covariances carry what the pixels say: a last step on the pixels themselves would change nothing."""
    rng, n = np.random.default_rng(5), 25
    drawn = [
        pose(rotation_from_rotvec(rng.uniform(-0.6, 0.6, 3)), rng.uniform([-0.1, -0.1, 0.4], [0.1, 0.1, 1.4]))
        for _ in range(n)
    ]
    As = np.array([Y_TRUE @ np.linalg.inv(X_TRUE @ T) for T in drawn])
    pixels = [projected(T) + NOISE_PX * rng.normal(size=2 * len(BOARD)) for T in drawn]
    seen, covariances = [], []
    for T, pixel in zip(drawn, pixels, strict=True):
        fit = least_squares(lambda d, T=T, pixel=pixel: projected(moved_pose(T, d)) - pixel, np.zeros(6))
        seen.append(moved_pose(T, fit.x))
        covariances.append(NOISE_PX**2 * np.linalg.inv(fit.jac.T @ fit.jac))

    def misses(d, X, Y):
        Ts = inverse_poses(As @ moved_pose(X, d[:6])) @ moved_pose(Y, d[6:])
        return np.concatenate([projected(T) - pixel for T, pixel in zip(Ts, pixels, strict=True)])

    Bs, excess = inverse_poses(np.array(seen)), {}
    best = float(least_squares(misses, np.zeros(12), args=(X_TRUE, Y_TRUE)).cost)
    for name, given in (("alike", None), ("weighted", np.array(covariances))):
        found = solve_ax_yb(As, Bs, camera_covariances=given)
        assert found.T_hand_cam is not None, found.reason
        excess[name] = (
            0.5 * float(np.sum(misses(np.zeros(12), found.T_hand_cam, found.T_base_target) ** 2)) / best - 1.0
        )
    assert excess["weighted"] < 0.005, excess
    assert excess["alike"] > 2.0 * excess["weighted"], excess


def test_angles_in_the_wrong_order_are_refused():
    """The same numbers read as x-y-z in place of z-y-x: 6 deg of residual, which no camera leaves."""
    As = hand_poses(np.arange(0.0, 12.0, 0.2))
    Bs = inverse_poses(seen_target(As, np.random.default_rng(0), 0.2, 0.001))
    angles = Rotation.from_matrix(As[:, :3, :3]).as_euler("zyx")
    wrong = As.copy()
    wrong[:, :3, :3] = Rotation.from_euler("xyz", angles[:, ::-1]).as_matrix()
    assert solve_ax_yb(As, Bs).status is CalibrationStatus.OK
    found = solve_ax_yb(wrong, Bs)
    assert found.status is CalibrationStatus.POOR_FIT
    assert "order of Euler angles" in found.reason


def test_covariances_of_another_number_of_poses_are_an_error():
    As = hand_poses(np.arange(0.0, 12.0, 0.4))
    Bs = inverse_poses(seen_target(As, np.random.default_rng(0)))
    with pytest.raises(CalibrationInputError, match="camera_covariances"):
        solve_ax_yb(As, Bs, camera_covariances=np.tile(np.eye(6), (3, 1, 1)))
