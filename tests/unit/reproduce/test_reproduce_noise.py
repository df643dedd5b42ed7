"""The noise model: its file, its fit to known noise, and the test of agreement."""

from dataclasses import replace

import numpy as np
import pytest
from reproduce_worlds import NO_NOISE, NOISE, machine, world

from benchmarks.reproduce.fast_camera import FastCamera, Source
from benchmarks.reproduce.fast_lens import bent_path, lens_affine
from benchmarks.reproduce.fast_machine import QuasiStaticMachine
from benchmarks.reproduce.fast_odometry import odometry_path
from benchmarks.reproduce.noise_fit import TooFewLooksError, agreement, fit_corner_noise, pose_errors
from benchmarks.reproduce.noise_model import NoiseFileError, NoiseModel, OdometryNoise, read_noise_model
from benchmarks.reproduce.odometry_fit import OdometryRunPair, TooFewRunsError, fit_odometry_noise
from benchmarks.reproduce.rendered_looks import RenderedLook, seen_by, standpoints
from benchmarks.reproduce.true_corners import ObjectOn, TrueView, true_poses_cam
from machine.poses import pose
from sim_plc.world import rng_for


def test_the_file_comes_back_and_others_are_refused(tmp_path):
    path = tmp_path / "noise.json"
    path.write_text(NOISE.to_json(), encoding="utf-8")
    assert read_noise_model(path) == NOISE
    for text in (
        "",
        "{}",
        "[]",
        NOISE.to_json().replace("noise/1", "noise/9"),
        NOISE.to_json().replace("look_px", "x"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(NoiseFileError):
            read_noise_model(path)
    with pytest.raises(NoiseFileError):
        read_noise_model(tmp_path / "none.json")


def looks_with(noise: NoiseModel, source: Source, on: ObjectOn, seeds: tuple[int, ...]) -> list[RenderedLook]:
    """As `rendered_looks`, but with the fast camera in place of images."""
    looks = []
    for seed in seeds:
        one = world("realistic", seed)
        start = QuasiStaticMachine(one).T_base_tcp()
        exact, noisy = FastCamera(one, NO_NOISE, rng_for(seed, "a")), FastCamera(one, noise, rng_for(seed, "b"))
        view = TrueView(one)
        for T in standpoints(one, start, 8, np.random.default_rng(seed)):
            found = [getattr(pair, on) for pair in noisy.pairs(T, source, 5)]
            expected = getattr(exact.pair(T, source, 0), on)
            Ts = [each.T_cam_object for each in found if each.marker_ids == expected.marker_ids]
            true = true_poses_cam(one, T)[0 if on == "tool" else 1]
            if len(Ts) > 1:
                seen = seen_by(source, view, T, expected.marker_ids)
                looks.append(RenderedLook(seed, on, source, T, true, expected.T_cam_object, np.array(Ts), seen, 0))
    return looks


def test_the_fit_finds_the_corner_noise_it_was_made_with():
    looks = looks_with(NOISE, "stereo", "ooi", (1, 2, 3))
    found = fit_corner_noise(looks, machine())
    assert found.frame_px == pytest.approx(0.02, rel=0.15)
    assert found.look_px == pytest.approx(0.02, rel=0.35)
    assert abs(found.outward_px) < 0.01
    with pytest.raises(TooFewLooksError):
        fit_corner_noise(looks[:5], machine())


def test_the_fit_finds_what_moves_all_corners_outwards():
    found = fit_corner_noise(looks_with(NOISE, "mono", "ooi", (1, 2)), machine())
    assert found.outward_px == pytest.approx(-0.4, abs=0.12)
    assert 0.12 < found.frame_px < 0.28
    assert 0.2 < found.look_px < 0.8


def test_agreement_tells_like_from_unlike():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(400, 6)), rng.normal(size=(300, 6))
    same = agreement(a, b)
    assert min(row.p for row in same) > 0.01
    assert all(0.8 < row.sd_ratio < 1.25 for row in same)
    unlike = agreement(a, 2.0 * b)
    assert max(row.p for row in unlike) < 0.01
    assert all(1.5 < row.sd_ratio < 2.7 for row in unlike)


def test_pose_errors_are_zero_for_the_truth():
    T = pose(np.eye(3), np.array([0.1, 0.2, 0.9]))
    np.testing.assert_array_equal(pose_errors(T, T), np.zeros(6))


def runs_with(noise: OdometryNoise, n: int) -> list[OdometryRunPair]:
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 1.0, 240)
    runs = []
    for _ in range(n):
        corners = rng.uniform(-0.15, 0.15, size=(7, 3))
        path = np.column_stack([np.interp(t, np.linspace(0, 1, 7), corners[:, k]) for k in range(3)])
        Ts = np.array([pose(np.eye(3), p - path[0]) for p in path])
        runs.append(OdometryRunPair(odometry_path(Ts, noise, rng), Ts, 15.0))
    return runs


def test_the_odometrys_noise_is_found_again():
    true = OdometryNoise(3e-3, 6e-4, 0.0, 0.1, 2e-4, 8e-4, 3e-4, 15.0)
    found = fit_odometry_noise(runs_with(true, 24))
    assert found.scale_frac == pytest.approx(3e-3, rel=0.4)
    assert found.jitter_m == pytest.approx(2e-4, rel=0.2)
    assert found.turn_jitter_rad == pytest.approx(3e-4, rel=0.2)
    assert found.turn_drift_rad_sqrt_m == pytest.approx(8e-4, rel=0.4)
    assert np.hypot(found.drift_m_sqrt_m, found.bend_m) == pytest.approx(6e-4, rel=0.5)
    with pytest.raises(TooFewRunsError):
        fit_odometry_noise(runs_with(true, 2))


def with_lens(bias_px: float):
    """The world of seed 2 with the nominal lens and a disparity bias."""
    one = world("realistic", 2)
    nominal = one.nominal.camera
    right = replace(nominal, cx_px=nominal.cx_px + bias_px)
    return replace(one, camera=replace(one.camera, left=nominal, right=right))


def test_an_exact_lens_bends_nothing_and_a_disparity_bias_scales_the_way():
    """0.1 px of about 55 px are 0.2 %: seen d - 0.1 for d, everything is further away and every step is longer."""
    T = QuasiStaticMachine(world("realistic", 2)).T_base_tcp()
    np.testing.assert_allclose(lens_affine(with_lens(0.0), T), 0.0, atol=1e-8)
    affine = lens_affine(with_lens(0.1), T)
    assert 1e-3 < np.diag(affine).min() <= np.diag(affine).max() < 5e-3
    np.testing.assert_allclose(lens_affine(with_lens(-0.1), T), -affine, atol=3e-5)


def test_a_bent_path_starts_at_the_identity_and_is_moved_in_proportion():
    Ts = np.array([pose(np.eye(3), np.array([0.1 * k, 1.0, 2.0])) for k in range(4)])
    bent = bent_path(Ts, np.diag([0.01, 0.0, 0.0]))
    np.testing.assert_allclose(bent[0], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(bent[:, :3, 3], [[0.101 * k, 0.0, 0.0] for k in range(4)], atol=1e-12)
