"""A run's scatter is what the run shows; a fit that goes to and fro is calmed."""

from dataclasses import replace

import numpy as np
import pytest
from joint_scenes import GOAL, Q_START, machine, odometry_run, path_joints, scene

from machine.chain import chain_of
from server.calibration import chord_rotation, joint_estimate
from server.calibration.joint_goal import joints_for_goal
from server.calibration.joint_observations import NoiseModel, Scatter, run_covariance, thin_samples


@pytest.mark.parametrize("neighbours", [-0.5, 0.0, 0.8])
def test_a_runs_covariance_is_positive_and_symmetric(neighbours):
    rng = np.random.default_rng(1)
    run = odometry_run(scene(rng).true, path_joints(), rng)
    samples = thin_samples(run, NoiseModel())
    C = run_covariance(samples, NoiseModel(), Scatter(5e-4, neighbours))
    assert np.allclose(C, C.T)
    assert np.linalg.eigvalsh(C).min() > 0.0


def test_a_path_that_scatters_more_makes_the_prediction_wider():
    qs, told = path_joints(), []
    for sigma_m in (2e-4, 9e-4):
        rng = np.random.default_rng(3)
        here = scene(rng)
        run = odometry_run(here.true, qs, rng, sigma_m=sigma_m)
        found = joint_estimate.estimate_jointly(machine(), [run], [here.look(Q_START)])
        assert found.state is not None, found.reason
        goal = joints_for_goal(chain_of(machine()), found, Q_START, GOAL)
        told.append(float(np.sqrt(np.trace(goal.covariance[3:, 3:]))))
    assert told[1] > 1.2 * told[0], told


def test_contradictions_are_not_taken_for_scatter():
    rng = np.random.default_rng(4)
    here = scene(rng)
    run = odometry_run(here.true, path_joints(), rng)
    Ts = run.camera_track.Ts_vo_cam.copy()
    Ts[:, :3, 3] += rng.normal(0.0, 0.02, (len(Ts), 3))
    broken = replace(run, camera_track=replace(run.camera_track, Ts_vo_cam=Ts))
    found = joint_estimate.estimate_jointly(machine(), [broken], [here.look(Q_START)])
    assert found.state is None


def test_a_step_that_takes_back_the_last_one_is_halved_and_others_are_not():
    sigmas = np.ones(5)
    first = np.array([0.0, 0.0, 0.0, 0.0, 1.0])
    change, last = chord_rotation._damp_oscillating_step(first, np.zeros(5), sigmas)
    assert np.array_equal(change, first)
    change, _ = chord_rotation._damp_oscillating_step(-0.92 * first, last, sigmas)
    assert np.allclose(change, -0.46 * first)
    change, _ = chord_rotation._damp_oscillating_step(0.92 * first, last, sigmas)
    assert np.allclose(change, 0.92 * first)


@pytest.mark.parametrize("kind", ["walk", "step"])
def test_odometry_that_drifts_far_is_not_taken_for_scatter(kind):
    """What whitening by neighbours hides: 4 mm a metre of way, or a step of 6 mm that stays."""
    squares = []
    for seed in range(6):
        rng = np.random.default_rng(100 + seed)
        here = scene(rng)
        run = odometry_run(here.true, path_joints(), rng)
        Ts = run.camera_track.Ts_vo_cam.copy()
        moved_m = np.linalg.norm(np.diff(Ts[:, :3, 3], axis=0), axis=1)
        walk = np.cumsum(rng.normal(size=(len(moved_m), 3)) * 0.004 * np.sqrt(moved_m)[:, None], axis=0)
        step = np.where(np.arange(len(moved_m))[:, None] > len(moved_m) // 2, rng.normal(size=3), 0.0)
        Ts[1:, :3, 3] += walk if kind == "walk" else 0.006 * step / np.linalg.norm(step).clip(1e-9)
        bent = replace(run, camera_track=replace(run.camera_track, Ts_vo_cam=Ts))
        found = joint_estimate.estimate_jointly(machine(), [bent], [here.look(Q_START)])
        if found.state is None:
            continue
        goal = joints_for_goal(chain_of(machine()), found, Q_START, GOAL)
        error_m = here.tool(goal.q)[:3, 3] - GOAL[:3, 3]
        squares.append(float(error_m @ np.linalg.solve(goal.covariance[3:, 3:], error_m)) / 3.0)
    assert np.mean(squares) < 2.0, squares


def test_a_run_whose_camera_stood_is_left_out():
    rng = np.random.default_rng(5)
    here = scene(rng)
    run = odometry_run(here.true, path_joints(), rng)
    still = replace(
        run, camera_track=replace(run.camera_track, Ts_vo_cam=np.tile(np.eye(4), (len(run.camera_track.t_s), 1, 1)))
    )
    alone = joint_estimate.estimate_jointly(machine(), [run], [here.look(Q_START)])
    beside = joint_estimate.estimate_jointly(machine(), [run, still], [here.look(Q_START)])
    assert beside.n_samples == alone.n_samples
