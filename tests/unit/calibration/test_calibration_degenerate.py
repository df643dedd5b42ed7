"""Input that cannot tell a rotation: every estimator answers with a status and a reason, never with a rotation."""

import numpy as np
import pytest
from calibration_tracks import FOLDED, T_TCP_CAM, make_case
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from server.calibration.contracts import CalibrationStatus, CameraTrack, EncoderTrack
from server.calibration.hand_eye import estimate_hand_eye, solve_ax_yb
from server.calibration.hand_eye_fit import inverse_poses
from server.calibration.hybrid_mixture import MixtureSettings
from server.calibration.trajectory_matching import estimate_camera_rotation
from server.calibration.trajectory_matching_paper import estimate_camera_rotation_paper

LINE = np.array([[0.0, 0, 0], [0.5, 0, 0]])


def ours(camera, encoder):
    return estimate_camera_rotation(camera, encoder, T_TCP_CAM)


def paper(camera, encoder):
    return estimate_camera_rotation_paper(camera, encoder, T_TCP_CAM[:3, :3])


def paper_positions(camera, encoder):
    return estimate_camera_rotation_paper(camera, encoder, T_TCP_CAM[:3, :3], MixtureSettings(use_axes=False))


MATCHERS = {"chords": ours, "paper": paper, "paper, positions only": paper_positions}


def with_points(track: CameraTrack, change) -> CameraTrack:
    Ts = track.Ts_vo_cam.copy()
    Ts[:, :3, 3] = change(Ts[:, :3, 3])
    return CameraTrack(track.t_s, Ts)


def on_path(offsets):
    case = make_case(offsets, 1, wobble_deg=0.0)
    return case.camera, case.encoder


def folded_with(change):
    camera, encoder = on_path(FOLDED)
    return change(camera), encoder


def scrambled(points):
    return 0.3 * np.random.default_rng(0).normal(size=points.shape)


def timed(change):
    def of(camera):
        return CameraTrack(change(camera.t_s.copy()), camera.Ts_vo_cam)

    return of


def nan_poses(camera):
    return CameraTrack(camera.t_s, np.full_like(camera.Ts_vo_cam, np.nan))


def two_equal(t):
    t[30] = t[29]
    return t


def with_nan(t):
    t[5] = np.nan
    return t


CASES = {
    "line": (lambda: on_path(LINE), "line"),
    "no motion": (lambda: on_path(FOLDED * 0.0), ""),
    "2 cm": (lambda: on_path(FOLDED * 0.02), "path"),
    "all outliers": (lambda: folded_with(lambda c: with_points(c, scrambled)), "fit"),
    "mirrored": (lambda: folded_with(lambda c: with_points(c, lambda p: p * [-1.0, 1, 1])), ""),
    "odometry stood still": (lambda: folded_with(lambda c: with_points(c, lambda p: p * 0.0)), ""),
    "NaN": (lambda: folded_with(nan_poses), "at least"),
    "two samples": (lambda: folded_with(lambda c: CameraTrack(c.t_s[:2], c.Ts_vo_cam[:2])), "at least"),
    "no samples": (lambda: folded_with(lambda c: CameraTrack(c.t_s[:0], c.Ts_vo_cam[:0])), "at least"),
    "equal times": (lambda: folded_with(timed(two_equal)), "stands still"),
    "all times equal": (lambda: folded_with(timed(lambda t: 0.0 * t)), "stands still"),
    "backwards": (lambda: folded_with(timed(lambda t: t[::-1])), "backwards"),
    "NaN time": (lambda: folded_with(timed(with_nan)), "not finite"),
    "no rotations": (lambda: folded_with(lambda c: CameraTrack(c.t_s, 0.0 * c.Ts_vo_cam)), "at least"),
}


@pytest.mark.parametrize("method", MATCHERS)
@pytest.mark.parametrize("name", CASES)
def test_matching_never_gives_a_rotation(name, method):
    tracks, words = CASES[name]
    found = MATCHERS[method](*tracks())
    assert found.status is not CalibrationStatus.OK
    assert len(found.reason) > 20
    assert words in found.reason
    assert found.R_tcp_cam is None
    assert found.covariance is None


@pytest.mark.parametrize("method", MATCHERS)
def test_mirrored_flat_path_is_not_turned_over(method):
    camera, encoder = on_path(FOLDED * [1.0, 1.0, 0.0])
    R_vo_tcp = camera.Ts_vo_cam[0, :3, :3] @ (T_TCP_CAM[:3, :3]).T
    mirror = R_vo_tcp @ np.diag([-1.0, 1.0, 1.0]) @ R_vo_tcp.T
    found = MATCHERS[method](with_points(camera, lambda p: p @ mirror.T), encoder)
    assert found.status is not CalibrationStatus.OK
    assert found.R_tcp_cam is None


def test_encoder_time_running_backwards_is_told():
    camera, encoder = on_path(FOLDED)
    for method in MATCHERS.values():
        found = method(camera, EncoderTrack(encoder.t_s[::-1], encoder.Ts_base_tcp))
        assert found.status is CalibrationStatus.DEGENERATE
        assert "encoder track: time runs backwards" in found.reason


def hand_eye_poses(vectors, seed: int = 0):
    """A and B with A X = Y B exactly, the hand turned by the rotation vectors (n, 3)."""
    rng = np.random.default_rng(seed)
    X, Y = (pose(rotation_from_rotvec(rng.normal(size=3)), rng.normal(size=3)) for _ in range(2))
    As = np.tile(np.eye(4), (len(vectors), 1, 1))
    As[:, :3, :3] = Rotation.from_rotvec(vectors).as_matrix()
    As[:, :3, 3] = 0.2 * rng.normal(size=(len(vectors), 3))
    return As, inverse_poses(np.tile(Y, (len(As), 1, 1))) @ As @ X


def turning(n: int = 40, axes=(1.0, 1.0, 1.0)):
    return 0.5 * np.random.default_rng(1).normal(size=(n, 3)) * axes


def smooth_turning(n: int, axes=(1.0, 1.0, 1.0)):
    t = np.linspace(0.0, 12.0, n)
    return 0.4 * np.column_stack((np.sin(t), np.cos(1.7 * t), np.sin(0.6 * t))) * axes


def mirrored_poses(Ts):
    out = Ts.copy()
    out[:, 0, 3] *= -1.0
    return out


HAND_EYE_CASES = {
    "one axis": lambda n: (lambda A, B: (A, B))(*hand_eye_poses(smooth_turning(n, (0.0, 0.0, 1.0)))),
    "no turning": lambda n: hand_eye_poses(np.zeros((n, 3))),
    "no motion": lambda n: tuple(np.tile(np.eye(4), (n, 1, 1)) for _ in range(2)),
    "all outliers": lambda n: (hand_eye_poses(smooth_turning(n), 1)[0], hand_eye_poses(turning(n), 2)[1]),
    "mirrored": lambda n: (lambda A, B: (A, mirrored_poses(B)))(*hand_eye_poses(smooth_turning(n))),
    "NaN": lambda n: tuple(np.full((n, 4, 4), np.nan) for _ in range(2)),
    "two samples": lambda n: tuple(Ts[:2] for Ts in hand_eye_poses(turning())),
    "none": lambda n: (np.zeros((0, 4, 4)), np.zeros((0, 4, 4))),
}


@pytest.mark.parametrize("name", HAND_EYE_CASES)
@pytest.mark.parametrize("method", ["poses", "streams"])
def test_hand_eye_never_gives_a_pose(name, method):
    As, Bs = HAND_EYE_CASES[name](200 if method == "streams" else 30)
    if method == "poses":
        found = solve_ax_yb(As, Bs)
    else:
        t = 0.05 * np.arange(len(As))
        found = estimate_hand_eye(t, As, t, inverse_poses(Bs))
    assert found.status is not CalibrationStatus.OK
    assert len(found.reason) > 20
    assert found.T_hand_cam is None
    assert found.T_base_target is None
    assert found.covariance is None


@pytest.mark.parametrize("change", [lambda t: t[::-1], lambda t: 0.0 * t, lambda t: np.where(t > 3.0, np.nan, t)])
def test_hand_eye_streams_with_wrong_times_are_refused(change):
    As, Bs = hand_eye_poses(smooth_turning(200))
    t = 0.05 * np.arange(200)
    for times in ((change(t), t), (t, change(t))):
        found = estimate_hand_eye(times[0], As, times[1], inverse_poses(Bs))
        assert found.status is CalibrationStatus.DEGENERATE
        assert found.T_hand_cam is None


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    n=st.integers(0, 40),
    size=st.floats(0.0, 0.3),
    flat=st.sampled_from([(1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (1.0, 1.0, 1.0)]),
    holes=st.floats(0.0, 1.0),
    seed=st.integers(0, 1000),
)
def test_tracks_that_have_nothing_to_do_with_each_other(n, size, flat, holes, seed):
    """Random points, random times, holes: never OK, never an exception."""
    rng = np.random.default_rng(seed)

    def track():
        Ts = np.tile(np.eye(4), (n, 1, 1))
        Ts[:, :3, 3] = size * rng.normal(size=(n, 3)) * flat
        Ts[rng.random(n) < holes] = np.nan
        return np.cumsum(rng.uniform(0.01, 0.1, n)), Ts

    (t_cam, Ts_cam), (t_enc, Ts_enc) = track(), track()
    for method in (ours, paper_positions):
        found = method(CameraTrack(t_cam, Ts_cam), EncoderTrack(t_enc, Ts_enc))
        assert (found.R_tcp_cam is None) == (found.status is not CalibrationStatus.OK)
        if method is ours:
            assert found.R_tcp_cam is None
        assert found.status is CalibrationStatus.OK or found.reason


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(n=st.integers(0, 30), turn=st.floats(0.0, 1.0), seed=st.integers(0, 1000))
def test_hand_eye_of_unrelated_poses(n, turn, seed):
    rng = np.random.default_rng(seed)

    def poses():
        Ts = np.tile(np.eye(4), (n, 1, 1))
        Ts[:, :3, :3] = Rotation.from_rotvec(turn * rng.normal(size=(n, 3))).as_matrix() if n else Ts[:, :3, :3]
        Ts[:, :3, 3] = 0.3 * rng.normal(size=(n, 3))
        return Ts

    found = solve_ax_yb(poses(), poses())
    if n <= 4 and found.T_hand_cam is not None:
        return  # twelve unknowns fit so few poses by chance
    assert found.T_hand_cam is None, found.residual_median_deg
    assert found.reason
