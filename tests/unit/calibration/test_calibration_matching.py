"""Trajectory matching on chords: accuracy, time offset, honest covariance, fusion, and refusals."""

from functools import cache

import numpy as np
import pytest
from calibration_tracks import FOLDED, T_TCP_CAM, make_case, paper_offsets

from machine.rotations import geodesic_angle, rotation_from_rotvec, rotvec_from_rotation
from server.calibration.checks import CalibrationInputError
from server.calibration.contracts import CalibrationStatus, CameraTrack, EncoderTrack, MountRotation
from server.calibration.trajectory_matching import estimate_camera_rotation, fuse_rotations, prior_from_tool_marker

PATHS = {"folded": FOLDED, "paper": paper_offsets()}
several = pytest.mark.parametrize("n", [20, pytest.param(60, marks=pytest.mark.slow)])  # 60: the same limits, 8 s more


@cache
def trials(path: str, offset_s: float, outliers: float, n: int):
    """Rotation errors [deg], their normalised squares (3 degrees of freedom), and time offset errors [s]."""
    degrees, chi2, offsets = [], [], []
    for seed in range(n):
        case = make_case(PATHS[path], seed, offset_s=offset_s, outliers=outliers)
        found = estimate_camera_rotation(case.camera, case.encoder, T_TCP_CAM)
        assert found.status is CalibrationStatus.OK, found.reason
        assert found.R_tcp_cam is not None
        assert found.covariance is not None
        error = rotvec_from_rotation(case.R_tcp_cam @ found.R_tcp_cam.T)
        degrees.append(np.rad2deg(np.linalg.norm(error)))
        chi2.append(error @ np.linalg.solve(found.covariance, error))
        offsets.append(found.time_offset_s - offset_s)
    return np.array(degrees), np.array(chi2), np.array(offsets)


@several
@pytest.mark.parametrize(
    ("path", "offset_s", "outliers", "median_deg", "p95_deg"),
    [
        ("folded", 0.0, 0.0, 0.6, 1.0),
        ("folded", 0.15, 0.0, 0.6, 1.0),
        ("folded", 0.0, 0.1, 0.7, 1.1),
        ("paper", 0.15, 0.0, 0.8, 1.6),
    ],
)
def test_rotation_error_over_many_trials(path, offset_s, outliers, median_deg, p95_deg, n):
    degrees, _, _ = trials(path, offset_s, outliers, n)
    assert np.median(degrees) <= median_deg
    assert np.percentile(degrees, 95) <= p95_deg


@several
@pytest.mark.parametrize("offset_s", [0.0, 0.15])
def test_time_offset_is_recovered_within_25_ms(offset_s, n):
    _, _, offsets = trials("folded", offset_s, 0.0, n)
    assert np.abs(offsets).max() <= 0.025


def strained(case, seed: int, size: float = 0.005):
    """The case with a machine that is not rigidly what its model says: a linear map of 0.5 % per entry between both."""
    M = np.eye(3) + size * np.random.default_rng([seed, 77]).normal(size=(3, 3))
    Ts = case.camera.Ts_vo_cam.copy()
    Ts[:, :3, 3] = Ts[:, :3, 3] @ M.T
    return CameraTrack(case.camera.t_s, Ts)


@several
@pytest.mark.parametrize("path", ["folded", "paper"])
def test_covariance_is_honest(path, n):
    chi2 = []
    for seed in range(n):
        case = make_case(PATHS[path], seed)
        found = estimate_camera_rotation(strained(case, seed), case.encoder, T_TCP_CAM)
        assert found.R_tcp_cam is not None
        error = rotvec_from_rotation(case.R_tcp_cam @ found.R_tcp_cam.T)
        chi2.append(error @ np.linalg.solve(found.covariance, error))
    assert 0.4 <= np.mean(chi2) / 3.0 <= 1.5  # 1 is exact; the model-error floor makes it conservative here
    assert np.mean(np.array(chi2) < 7.81) >= 0.90  # 95 % bound of chi2 with 3 degrees of freedom


@several
@pytest.mark.parametrize("path", ["folded", "paper"])
def test_without_strain_the_covariance_is_cautious_but_not_useless(path, n):
    _, chi2, _ = trials(path, 0.0, 0.0, n)
    assert 0.25 <= chi2.mean() / 3.0 <= 1.2
    assert np.mean(chi2 < 7.81) >= 0.93


def test_covariance_grows_when_the_tracks_are_not_rigid():
    case = make_case(FOLDED, 4)
    calm = estimate_camera_rotation(case.camera, case.encoder, T_TCP_CAM)
    bent = estimate_camera_rotation(strained(case, 4, 0.04), case.encoder, T_TCP_CAM)
    assert calm.covariance is not None
    assert bent.covariance is not None
    assert np.sqrt(np.trace(bent.covariance) / np.trace(calm.covariance)) > 2.0


def test_odometry_that_errs_along_with_the_shaking_turns_no_flat_path():
    """Across a flat path there is shaking only: an error of a third of it passed for a strain, and half of that for a
    turn of the camera by degrees."""
    case = make_case(paper_offsets(), 3, jitter=0.0003, drift=0.0, scale=0.0, wobble_deg=0.0)
    R_base_tcp = case.encoder.Ts_base_tcp[0, :3, :3]
    R_vo_tcp = case.camera.Ts_vo_cam[0, :3, :3] @ case.R_tcp_cam.T
    shaking = np.array([0.0, 0.0, 0.0015])  # in TCP axes, whose z is the path's normal
    for Ts, R, t_s, own in (
        (case.encoder.Ts_base_tcp, R_base_tcp, case.encoder.t_s, np.zeros(3)),
        (case.camera.Ts_vo_cam, R_vo_tcp, case.camera.t_s, np.array([0.0005, 0.0003, 0.0])),
    ):
        Ts[:, :3, 3] += np.sin(2.0 * np.pi * 2.1 * t_s)[:, None] * (R @ (shaking + own))
    found = estimate_camera_rotation(case.camera, case.encoder, T_TCP_CAM)
    assert found.status is CalibrationStatus.OK, found.reason
    assert np.rad2deg(geodesic_angle(found.R_tcp_cam, case.R_tcp_cam)) < 0.5
    assert np.rad2deg(np.sqrt(np.linalg.eigvalsh(found.covariance)[-1])) < 0.5


def test_exact_tracks_give_the_exact_mount():
    case = make_case(FOLDED, 3, drift=0.0, scale=0.0, jitter=0.0)
    found = estimate_camera_rotation(case.camera, case.encoder, T_TCP_CAM)
    assert found.R_tcp_cam is not None
    assert np.rad2deg(geodesic_angle(found.R_tcp_cam, case.R_tcp_cam)) < 0.05
    assert found.path_length_m == pytest.approx(1.0, abs=0.05)
    assert found.residual_rms_mm < 0.5


def test_prior_pulls_by_its_covariance_and_shrinks_the_sum():
    case = make_case(paper_offsets(), 5)
    alone = estimate_camera_rotation(case.camera, case.encoder, T_TCP_CAM)
    exact = MountRotation(case.R_tcp_cam, np.deg2rad(0.05) ** 2 * np.eye(3))
    loose = MountRotation(
        rotation_from_rotvec(np.deg2rad([1.0, 1.0, 0.0])) @ case.R_tcp_cam, np.deg2rad(20) ** 2 * np.eye(3)
    )
    tight_found = estimate_camera_rotation(case.camera, case.encoder, T_TCP_CAM, exact)
    loose_found = estimate_camera_rotation(case.camera, case.encoder, T_TCP_CAM, loose)
    assert alone.R_tcp_cam is not None
    assert tight_found.R_tcp_cam is not None
    assert loose_found.R_tcp_cam is not None
    assert np.rad2deg(geodesic_angle(tight_found.R_tcp_cam, case.R_tcp_cam)) < 0.06
    assert np.rad2deg(geodesic_angle(loose_found.R_tcp_cam, alone.R_tcp_cam)) < 0.02
    assert tight_found.covariance is not None
    assert alone.covariance is not None
    assert np.trace(tight_found.covariance) < np.trace(alone.covariance)


@several
def test_fusion_gains_over_both_sources(n):
    """A tool marker known to 0.7 deg, data of the paper's weak path: the sum is better than either."""
    squares = np.zeros(3)
    for seed in range(n):
        case = make_case(paper_offsets(), seed)
        slip = np.deg2rad(0.7) * np.random.default_rng(seed).normal(size=3)
        prior = MountRotation(rotation_from_rotvec(slip) @ case.R_tcp_cam, np.deg2rad(0.7) ** 2 * np.eye(3))
        camera = strained(case, seed)
        data = estimate_camera_rotation(camera, case.encoder, T_TCP_CAM)
        both = estimate_camera_rotation(camera, case.encoder, T_TCP_CAM, prior)
        candidates = (prior.R_tcp_cam, data.R_tcp_cam, both.R_tcp_cam)
        squares += [geodesic_angle(R, case.R_tcp_cam) ** 2 for R in candidates if R is not None]
    prior_deg, data_deg, both_deg = np.rad2deg(np.sqrt(squares / n))
    assert both_deg < data_deg < prior_deg


def test_disagreeing_prior_inflates_and_is_told():
    small = np.deg2rad(0.5) ** 2 * np.eye(3)
    data = MountRotation(np.eye(3), small)
    fused = fuse_rotations(data, MountRotation(rotation_from_rotvec(np.array([0.2, 0.0, 0.0])), small))
    assert fused.covariance_inflated
    assert fused.mount_rotation.covariance[0, 0] == pytest.approx(0.5 * small[0, 0] * fused.chi2 / 3.0)


def test_fusion_of_equal_opinions_lies_half_way():
    small = np.deg2rad(1.0) ** 2 * np.eye(3)
    far = rotation_from_rotvec(np.deg2rad([0.0, 2.0, 0.0]))
    fused = fuse_rotations(MountRotation(np.eye(3), small), MountRotation(far, small))
    np.testing.assert_allclose(
        np.rad2deg(rotvec_from_rotation(fused.mount_rotation.R_tcp_cam)), [0.0, 1.0, 0.0], atol=1e-9
    )


def test_prior_from_tool_marker_is_the_mount_when_the_marker_is_nominal():
    R_tcp_tool = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    R_tcp_cam = rotation_from_rotvec(np.array([0.1, 0.2, -0.3])) @ T_TCP_CAM[:3, :3]
    prior = prior_from_tool_marker(R_tcp_tool, R_tcp_cam.T @ R_tcp_tool, np.deg2rad(2.0))
    assert geodesic_angle(prior.R_tcp_cam, R_tcp_cam) < 1e-12
    np.testing.assert_allclose(prior.covariance, np.deg2rad(2.0) ** 2 * np.eye(3))


def straight() -> np.ndarray:
    return np.array([[0.0, 0, 0], [0.5, 0, 0]])


def mirrored(case):
    Ts = case.camera.Ts_vo_cam.copy()
    Ts[:, 0, 3] *= -1.0
    return CameraTrack(case.camera.t_s, Ts)


def scrambled(case):
    Ts = case.camera.Ts_vo_cam.copy()
    Ts[:, :3, 3] = np.random.default_rng(0).normal(size=(len(Ts), 3)) * 0.1
    return CameraTrack(case.camera.t_s, Ts)


@pytest.mark.parametrize(
    ("name", "status", "words"),
    [
        ("line", CalibrationStatus.DEGENERATE, "straight line"),
        ("no motion", CalibrationStatus.DEGENERATE, "0 mm"),
        ("2 cm", CalibrationStatus.DEGENERATE, "longer calibration path"),
        ("too few", CalibrationStatus.TOO_FEW, "at least 12"),
        ("no overlap", CalibrationStatus.TOO_FEW, "overlap in time"),
        ("all outliers", CalibrationStatus.POOR_FIT, "do not fit"),
        ("mirrored", CalibrationStatus.POOR_FIT, "limit"),
        ("mirrored flat", CalibrationStatus.POOR_FIT, "limit"),
        ("wrong scale", CalibrationStatus.POOR_FIT, "scale"),
    ],
)
def test_degenerate_input_gives_a_status_and_never_a_rotation(name, status, words):
    case = make_case(FOLDED, 1)
    camera, encoder = case.camera, case.encoder
    if name == "line":
        case = make_case(straight(), 1, wobble_deg=0.0)
        camera, encoder = case.camera, case.encoder
    elif name in ("no motion", "2 cm"):
        small = FOLDED * (0.0 if name == "no motion" else 0.12)
        still = make_case(small, 1, wobble_deg=0.0)
        camera, encoder = still.camera, still.encoder
    elif name == "too few":
        camera = CameraTrack(camera.t_s[:5], camera.Ts_vo_cam[:5])
    elif name == "no overlap":
        camera = CameraTrack(camera.t_s + 1000.0, camera.Ts_vo_cam)
    elif name == "all outliers":
        camera = scrambled(case)
    elif name == "mirrored":
        camera = mirrored(case)
    elif name == "mirrored flat":
        case = make_case(FOLDED * [1, 1, 0], 1)
        camera, encoder = mirrored(case), case.encoder
    elif name == "wrong scale":
        Ts = camera.Ts_vo_cam.copy()
        Ts[:, :3, 3] *= 1.3
        camera = CameraTrack(camera.t_s, Ts)
    found = estimate_camera_rotation(camera, encoder, T_TCP_CAM)
    assert found.status is status, found.reason
    assert words in found.reason
    assert found.R_tcp_cam is None
    assert found.covariance is None


def test_gaps_of_nan_are_left_out():
    case = make_case(FOLDED, 2)
    Ts = case.camera.Ts_vo_cam.copy()
    Ts[20:30] = np.nan
    found = estimate_camera_rotation(CameraTrack(case.camera.t_s, Ts), case.encoder, T_TCP_CAM)
    assert found.status is CalibrationStatus.OK
    assert found.R_tcp_cam is not None
    assert np.rad2deg(geodesic_angle(found.R_tcp_cam, case.R_tcp_cam)) < 1.5


def test_wrong_shapes_are_a_broken_contract():
    case = make_case(FOLDED, 2)
    with pytest.raises(CalibrationInputError, match="encoder track"):
        estimate_camera_rotation(case.camera, EncoderTrack(case.encoder.t_s[:-1], case.encoder.Ts_base_tcp), T_TCP_CAM)
