"""The paper's matching: its mixture against paired Kabsch, and "camera axes = TCP axes" returning the assumed mount."""

import numpy as np
import pytest
from calibration_tracks import FOLDED, T_TCP_CAM, make_case, paper_offsets

from machine.rotations import geodesic_angle, rotation_from_rotvec
from server.calibration.contracts import CalibrationStatus, CameraTrack, EncoderTrack
from server.calibration.hybrid_mixture import MixtureSettings, concentration_of, register_poses
from server.calibration.rotation_fit import kabsch
from server.calibration.trajectory_matching_paper import estimate_camera_rotation_paper

R_ASSUMED = T_TCP_CAM[:3, :3]


def test_concentration_inverts_the_mean_cosine():
    for kappa in (0.5, 3.0, 40.0, 5000.0):
        mean = 1.0 / np.tanh(kappa) - 1.0 / kappa
        assert concentration_of(float(mean), 1e6) == pytest.approx(kappa, rel=1e-3)


def test_mixture_agrees_with_paired_kabsch_on_a_noisy_track():
    rng = np.random.default_rng(4)
    y = np.column_stack(
        (np.linspace(0, 0.4, 60), 0.1 * np.sin(np.linspace(0, 5, 60)), 0.05 * np.linspace(0, 1, 60) ** 2)
    )
    Rs_y = np.array([rotation_from_rotvec(0.3 * rng.normal(size=3)) for _ in y])
    R, t = rotation_from_rotvec(np.array([0.1, -0.15, 0.2])), np.array([0.05, 0.02, -0.03])
    x = y @ R.T + t + 0.001 * rng.normal(size=y.shape)
    Rs_x = np.array([R @ each @ rotation_from_rotvec(np.deg2rad(0.3) * rng.normal(size=3)) for each in Rs_y])
    match = register_poses(x, Rs_x, y, Rs_y, MixtureSettings())
    assert np.rad2deg(geodesic_angle(match.R_x_y, R)) < 0.2
    paired = kabsch(x - x.mean(axis=0), y - y.mean(axis=0), np.ones(len(x)))
    assert np.rad2deg(geodesic_angle(match.R_x_y, paired)) < 0.6
    assert 1e3 * np.linalg.norm(match.t_x_y - t) < 2.0  # mm


@pytest.mark.parametrize("path", [FOLDED, paper_offsets()], ids=["folded", "paper"])
def test_orientation_term_returns_the_assumed_mount_whatever_the_true_one(path):
    for seed in range(4):
        case = make_case(path, seed, mount_deg=5.0, wobble_deg=0.0)
        found = estimate_camera_rotation_paper(case.camera, case.encoder, R_ASSUMED)
        assert found.status is CalibrationStatus.OK
        assert found.R_tcp_cam is not None
        assert np.rad2deg(geodesic_angle(found.R_tcp_cam, R_ASSUMED)) < 0.1
        assert np.rad2deg(geodesic_angle(found.R_tcp_cam, case.R_tcp_cam)) == pytest.approx(5.0, abs=0.1)


def test_positions_only_finds_the_mount_to_about_a_degree():
    errors = []
    for seed in range(8):
        case = make_case(FOLDED, seed, mount_deg=5.0, wobble_deg=0.0)
        found = estimate_camera_rotation_paper(case.camera, case.encoder, R_ASSUMED, MixtureSettings(use_axes=False))
        assert found.R_tcp_cam is not None
        errors.append(np.rad2deg(geodesic_angle(found.R_tcp_cam, case.R_tcp_cam)))
    assert np.median(errors) < 1.3


def test_short_or_empty_tracks_are_refused():
    case = make_case(FOLDED, 1)
    few = estimate_camera_rotation_paper(
        CameraTrack(case.camera.t_s[:4], case.camera.Ts_vo_cam[:4]), case.encoder, R_ASSUMED
    )
    assert few.status is CalibrationStatus.TOO_FEW
    Ts = np.tile(np.eye(4), (50, 1, 1))
    Ts[:, 0, 3] = np.linspace(0, 0.02, 50)
    still = EncoderTrack(np.linspace(0.0, 4.9, 50), Ts)
    short = estimate_camera_rotation_paper(case.camera, still, R_ASSUMED)
    assert short.status is CalibrationStatus.DEGENERATE
    assert short.R_tcp_cam is None
