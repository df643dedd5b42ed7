"""What contradicts itself is never told as known: an object that was moved, two mounts, a mount far from its file."""

import re
from dataclasses import replace

import numpy as np
import pytest
from joint_scenes import GOAL, Q_START, drawn_machine, machine, odometry_run, path_joints, scene

from machine.chain import chain_of
from machine.poses import pose
from machine.rotations import geodesic_angle, rotation_from_rotvec
from server.calibration.contracts import CalibrationStatus, CameraTrack
from server.calibration.joint_estimate import estimate_jointly
from server.calibration.joint_goal import joints_for_goal
from server.calibration.joint_lens import FOCAL, N_LENS, LensPrior, look_sensitivity, odometry_sensitivity
from server.calibration.joint_verdict import FitResiduals, covariance_widened_by_misfit, fit_verdict
from server.calibration.lens_evidence import lens_doubts


def seen(seed: int):
    rng = np.random.default_rng(seed)
    play_rad = rng.uniform([5e-4, 0, 0, 9e-4, 9e-4, 9e-4], [2e-3, 0, 0, 5e-3, 5e-3, 5e-3])
    here = scene(rng, play_rad=play_rad)
    return here, odometry_run(here.true, path_joints(), rng, play_rad=play_rad)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("shift_mm", [5.0, 10.0, 20.0])
def test_an_object_that_was_moved_between_two_looks_is_no_estimate(seed, shift_mm):
    here, run = seen(seed)
    first = here.look(Q_START)
    way = here.rng.normal(size=3)
    here.T_base_ooi = here.T_base_ooi.copy()
    here.T_base_ooi[:3, 3] += 1e-3 * shift_mm * way / np.linalg.norm(way)
    both = estimate_jointly(machine(), [run], [first, here.look(Q_START)])
    assert both.status is CalibrationStatus.POOR_FIT
    assert both.state is None
    assert "contradict each other" in both.reason
    alone = estimate_jointly(machine(), [run], [here.look(Q_START)])
    assert alone.status is CalibrationStatus.OK, alone.reason


@pytest.mark.parametrize("seed", range(6))
def test_looks_at_one_place_agree(seed):
    here, run = seen(seed)
    looks = [here.look(Q_START) for _ in range(4)]
    assert estimate_jointly(machine(), [run], looks).status is CalibrationStatus.OK


def test_what_is_left_over_widens_the_covariance():
    covariance = np.diag([1.0, 4.0])
    assert np.allclose(covariance_widened_by_misfit(covariance, 0.6), covariance)
    assert np.allclose(covariance_widened_by_misfit(covariance, 1.7), 1.7 * covariance)
    fitted = FitResiduals([10.0], [1.6], [0.2], [0.1], [np.ones(60)], 1.0, 0.01, 3.0)
    assert fitted.worst_mean_square == pytest.approx(10.0 / 6.0)
    assert replace(fitted, run_spread=[3.1]).worst_mean_square == 3.1


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        ({"look_chi2": [4.0, 40.0, 3.0]}, "look 2 of 3"),
        ({"look_chi2": [30.0, 30.0]}, "all looks together"),
        ({"run_position": [0.9, 2.5]}, "path 2 of 2.*positions"),
        ({"run_turn": [3.0, 0.1]}, "path 1 of 2.*turns"),
        ({"run_turn": [float("nan")]}, "turns nan"),
        ({"weights": [np.full(60, 0.1)]}, "outliers"),
        ({"mount_chi2": 70.0, "mount_rad": np.deg2rad(25.0)}, "25 deg from the machine file"),
        ({"camera_parameter_chi2": 41.0}, "off by chi2 41 .limit 34.; calibrate the camera again"),
    ],
)
def test_one_bad_observation_is_not_hidden_by_many_good_ones(changed, word):
    good = {
        "look_chi2": [3.0] * 3,
        "run_position": [0.9, 1.0],
        "run_turn": [0.1, 0.1],
        "run_spread": [0.1, 0.1],
        "weights": [np.ones(60)] * 2,
        "mount_chi2": 2.0,
        "mount_rad": 0.03,
        "camera_parameter_chi2": 6.0,
    }
    assert fit_verdict(FitResiduals(**good))[0] is CalibrationStatus.OK
    status, reason = fit_verdict(FitResiduals(**{**good, **changed}))
    assert status is CalibrationStatus.POOR_FIT
    assert re.search(word, reason), reason


def with_mount_off(deg: float, seed: int):
    rng = np.random.default_rng(seed)
    true = drawn_machine(rng)
    axis = rng.normal(size=3)
    turn = rotation_from_rotvec(np.deg2rad(deg) * axis / np.linalg.norm(axis))
    true.T_tcp_cam[:3, :3] = machine().T_tcp_cam_left[:3, :3] @ turn
    here = scene(rng, true=true)
    return here, estimate_jointly(machine(), [odometry_run(true, path_joints(), rng)], [here.look(Q_START)])


@pytest.mark.parametrize("seed", range(5))
def test_a_mount_five_degrees_off_its_file_works(seed):
    here, found = with_mount_off(5.0, seed)
    assert found.state is not None, found.reason
    assert geodesic_angle(found.state.T_tcp_cam[:3, :3], here.true.T_tcp_cam[:3, :3]) < np.deg2rad(1.0)
    goal = joints_for_goal(chain_of(machine()), found, Q_START, GOAL)
    assert np.linalg.norm(here.tool(goal.q)[:3, 3] - GOAL[:3, 3]) < 0.005


def test_a_mount_far_from_its_file_is_judged_against_the_prior():
    _, found = with_mount_off(25.0, 1)
    assert found.status is CalibrationStatus.POOR_FIT
    assert "deg from the machine file" in found.reason


@pytest.mark.parametrize("scale", [1.0, 1.03])
def test_a_scale_that_no_rig_has_is_not_explained_away_by_the_lens(scale):
    noticed = 0
    for seed in range(5):
        here = scene(np.random.default_rng(seed))
        run = odometry_run(here.true, path_joints(), np.random.default_rng(seed))
        Ts = run.camera_track.Ts_vo_cam.copy()
        Ts[:, :3, 3] *= scale
        run = replace(run, camera_track=CameraTrack(run.camera_track.t_s, Ts))
        found = estimate_jointly(machine(), [run], [here.look(Q_START)])
        noticed += found.status is CalibrationStatus.POOR_FIT or bool(doubts_of(found))
    assert noticed >= 4 if scale > 1.0 else noticed == 0


@pytest.mark.parametrize("off", [0.0, 0.03, -0.03])
def test_a_focal_length_off_alike_in_both_eyes_is_found_by_a_path_in_depth(off):
    """The eyes agree with each other whatever it is: only depth is stretched, in looks and odometry alike."""
    found = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        here = scene(rng)
        T_cam_ooi = here.look(Q_START).T_cam_ooi
        lens = np.array([off, *[0.0] * 6])
        bend = np.eye(3) + np.tensordot(lens, odometry_sensitivity(machine().camera, T_cam_ooi), axes=1)
        run = odometry_run(here.true, path_joints(), rng, affine_frac=0.0005)
        Ts = run.camera_track.Ts_vo_cam.copy()
        Ts[:, :3, 3] = Ts[:, :3, 3] @ bend.T
        run = replace(run, camera_track=CameraTrack(run.camera_track.t_s, Ts))
        found.append(estimate_jointly(machine(), [run], [seen_through(here.look(Q_START), lens)]))
    for estimate in found:
        sigma = np.sqrt(estimate.covariance[FOCAL - N_LENS, FOCAL - N_LENS])
        assert abs(estimate.state.lens_corrections[FOCAL] - off) < 4.0 * sigma < 0.02
        assert ("calibrate the camera" in "; ".join(doubts_of(estimate))) == (off != 0.0)


def doubts_of(found):
    return lens_doubts(found.state.lens_corrections, found.covariance[-N_LENS:, -N_LENS:], LensPrior())


def seen_through(look, lens):
    """The look as a camera shows it whose true lens differs from its file's."""
    step = look_sensitivity(machine(), look.T_cam_tool, look.T_cam_ooi) @ lens
    moved = [
        pose(rotation_from_rotvec(by[:3]) @ T[:3, :3], T[:3, 3] + by[3:])
        for T, by in ((look.T_cam_tool, step[:6]), (look.T_cam_ooi, step[6:]))
    ]
    return replace(look, T_cam_tool=moved[0], T_cam_ooi=moved[1])


@pytest.mark.parametrize("deg", [0.0, 180.0])
def test_odometry_that_is_turned_by_half_a_turn_is_no_small_residual(deg):
    here = scene(np.random.default_rng(3))
    run = odometry_run(here.true, path_joints(), np.random.default_rng(3))
    Ts = run.camera_track.Ts_vo_cam.copy()
    Ts[1:, :3, :3] = Ts[1:, :3, :3] @ rotation_from_rotvec(np.deg2rad(deg) * np.array([1.0, 0.0, 0.0]))
    found = estimate_jointly(
        machine(), [replace(run, camera_track=CameraTrack(run.camera_track.t_s, Ts))], [here.look(Q_START)]
    )
    assert (found.status is CalibrationStatus.OK) is (deg == 0.0)


@pytest.mark.parametrize("kind", ["nan", "near", "behind"])
def test_a_look_that_shows_no_wall_is_refused_and_raises_nothing(kind):
    here = scene(np.random.default_rng(2))
    look = here.look(Q_START)
    T = look.T_cam_ooi.copy()
    if kind == "nan":
        T[0, 3] = np.nan
    else:
        T[:3, 3] *= (0.15 if kind == "near" else -look.T_cam_ooi[2, 3]) / look.T_cam_ooi[2, 3]
    run = odometry_run(here.true, path_joints(), np.random.default_rng(2))
    found = estimate_jointly(machine(), [run], [replace(look, T_cam_ooi=T)])
    assert found.status is CalibrationStatus.DEGENERATE
    assert "look again" in found.reason
