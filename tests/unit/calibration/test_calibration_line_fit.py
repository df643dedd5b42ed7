"""The improved line equation: exact, robust, honest, with a clock offset, and refusing what cannot be told."""

import numpy as np
import pytest
from line_circles import R_TCP_CAM, drive

from machine.poses import pose
from server.calibration.checks import CalibrationInputError
from server.calibration.contracts import CalibrationStatus, EncoderTrack
from server.calibration.line_equation import circle_points, line_reference
from server.calibration.line_equation_fit import LineFit, fit_line, fit_line_moving


def goal_miss(found: LineFit, p_goal: np.ndarray) -> float:
    assert found.T_base_tcp_ref is not None, found.reason
    return float(np.linalg.norm(found.T_base_tcp_ref[:3, 3] - p_goal))


@pytest.mark.parametrize("lateral", [(0.3, -0.12), (0.05, 0.02), (0.0, 0.0), (-0.2, 0.35)])
@pytest.mark.parametrize("turn_deg", [-8.0, 0.0, 5.0])
def test_exact_without_noise_inside_and_outside_of_the_circle(lateral, turn_deg):
    case = drive(1, lateral, turn_deg)
    found = fit_line(case.T_init, case.points, case.vectors, R_TCP_CAM)
    assert found.status is CalibrationStatus.OK
    assert goal_miss(found, case.p_goal) < 1e-8
    assert np.rad2deg(found.turn_rad) == pytest.approx(turn_deg, abs=1e-6)
    assert found.scale == pytest.approx(1.0, abs=1e-6)


def test_ten_times_better_than_the_minimum_distance_at_the_papers_noise():
    """3 mm of noise per axis, 0.32 m to go: mean miss of both on the same samples."""
    by_fit, by_minimum = [], []
    for seed in range(60):
        a = np.random.default_rng(seed).uniform(0, 2 * np.pi)
        case = drive(seed, (0.32 * np.cos(a), 0.32 * np.sin(a)), noise_m=0.003)
        by_fit.append(goal_miss(fit_line(case.T_init, case.points, case.vectors, R_TCP_CAM), case.p_goal))
        paper = line_reference(case.T_init, case.points, case.distances)
        assert paper.T_base_tcp_ref is not None
        by_minimum.append(np.linalg.norm(paper.T_base_tcp_ref[:3, 3] - case.p_goal))
    assert np.mean(by_fit) < 0.003
    assert np.mean(by_minimum) > 5 * np.mean(by_fit)


def test_wild_samples_do_not_pull():
    case = drive(2, noise_m=0.001)
    vectors = case.vectors.copy()
    vectors[[4, 9, 13]] += np.array([[0.1, 0.0], [-0.05, 0.2], [0.3, 0.3]])
    found = fit_line(case.T_init, case.points, vectors, R_TCP_CAM)
    assert goal_miss(found, case.p_goal) < 0.003
    assert (found.weights[[4, 9, 13]] < 0.01).all()


def test_the_covariance_holds_what_it_says():
    """Noise of 3 mm only: errors whitened by the covariance have mean square near 1 (model terms taken out)."""
    squares = []
    for seed in range(200):
        case = drive(seed, noise_m=0.003, turn_deg=3.0)
        found = fit_line(case.T_init, case.points, case.vectors, R_TCP_CAM)
        assert found.T_base_tcp_ref is not None
        assert found.covariance is not None
        error = case.T_init[:3, :2].T @ (found.T_base_tcp_ref[:3, 3] - case.p_goal)
        model = (np.deg2rad(0.25) * 0.323) ** 2 + 0.001**2
        squares.append(error @ np.linalg.solve(found.covariance - model * np.eye(2), error) / 2.0)
    assert 0.75 < np.mean(squares) < 1.35


def test_refusals_say_why_and_give_no_pose():
    case = drive(3)
    few = case.vectors.copy()
    few[4:] = np.nan
    assert fit_line(case.T_init, case.points, few, R_TCP_CAM).status is CalibrationStatus.TOO_FEW
    line = drive(3, points=case.T_init[:3, 3] + np.linspace(-0.2, 0.2, 18)[:, None] * case.T_init[:3, 0])
    straight = fit_line(line.T_init, line.points, line.vectors, R_TCP_CAM)
    assert straight.status is CalibrationStatus.DEGENERATE
    still = drive(3, points=np.tile(case.T_init[:3, 3], (18, 1)))
    assert fit_line(still.T_init, still.points, still.vectors, R_TCP_CAM).status is CalibrationStatus.DEGENERATE
    mirrored = fit_line(case.T_init, case.points, case.vectors * [1.0, -1.0], R_TCP_CAM)
    assert mirrored.status is CalibrationStatus.POOR_FIT
    turned = drive(3, turn_deg=40.0)
    far_off = fit_line(turned.T_init, turned.points, turned.vectors, R_TCP_CAM)
    assert far_off.status is CalibrationStatus.POOR_FIT
    rng = np.random.default_rng(3)
    noise = fit_line(case.T_init, case.points, rng.normal(size=(18, 2)), R_TCP_CAM)
    assert noise.status is CalibrationStatus.POOR_FIT
    for one in (straight, mirrored, far_off, noise):
        assert one.T_base_tcp_ref is None
        assert one.reason
    with pytest.raises(CalibrationInputError):
        fit_line(case.T_init, case.points, case.vectors[:, :1], R_TCP_CAM)
    with pytest.raises(CalibrationInputError):
        fit_line(case.T_init, case.points, case.vectors, np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]))


def moving_case(seed: int, offset_s: float, noise_m: float = 0.002):
    """The circle driven point to point in 1.2 s each, looks at 15 Hz whose stamps are early by offset_s."""
    rng = np.random.default_rng(seed)
    still = drive(seed)
    corners = circle_points(still.T_init)
    t_enc = np.arange(0.0, 1.2 * 17, 0.01)
    u = np.clip(t_enc / 1.2 - np.floor(t_enc / 1.2), 0.0, 1.0)
    k = np.minimum(np.floor(t_enc / 1.2).astype(int), 16)
    s = (u**3 * (10 - 15 * u + 6 * u**2))[:, None]
    track = corners[k] + s * (corners[k + 1] - corners[k])
    t_look = np.arange(0.3, t_enc[-1] - 0.3, 1 / 15)
    there = np.column_stack([np.interp(t_look, t_enc, track[:, axis]) for axis in range(3)])
    case = drive(seed, points=there)
    vectors = case.vectors + noise_m * rng.normal(size=case.vectors.shape)
    Ts = np.array([pose(case.T_init[:3, :3], p) for p in track])
    return case, EncoderTrack(t_enc, Ts), t_look - offset_s, vectors


def test_a_clock_offset_is_found_on_the_move():
    for seed in range(3):
        case, encoder, t_look, vectors = moving_case(seed, 0.15)
        found = fit_line_moving(case.T_init, encoder, t_look, vectors, R_TCP_CAM)
        assert found.offset_observable
        assert found.time_offset_s == pytest.approx(0.15, abs=0.01)
        assert goal_miss(found.fit, case.p_goal) < 0.002


@pytest.mark.parametrize("offset_s", [-0.25, -0.24, 0.22, 0.24, 0.25])
def test_all_of_the_stated_range_of_offsets_is_found(offset_s):
    case, encoder, t_look, vectors = moving_case(1, offset_s)
    found = fit_line_moving(case.T_init, encoder, t_look, vectors, R_TCP_CAM)
    assert found.offset_observable
    assert found.time_offset_s == pytest.approx(offset_s, abs=0.01)
    assert goal_miss(found.fit, case.p_goal) < 0.002


@pytest.mark.parametrize("offset_s", [-0.4, -0.3, 0.28, 0.3, 0.5])
def test_an_offset_beyond_the_search_is_refused_and_not_taken_for_none(offset_s):
    case, encoder, t_look, vectors = moving_case(1, offset_s)
    found = fit_line_moving(case.T_init, encoder, t_look, vectors, R_TCP_CAM)
    assert found.fit.status is CalibrationStatus.POOR_FIT
    assert found.fit.T_base_tcp_ref is None
    assert found.fit.covariance is None
    assert "beyond +-0.25 s; check the clocks" in found.fit.reason


def test_an_offset_that_nothing_shows_is_not_invented():
    case, encoder, t_look, vectors = moving_case(1, 0.0)
    rest = t_look < 0.2
    found = fit_line_moving(case.T_init, encoder, t_look[rest], vectors[rest], R_TCP_CAM)
    assert not found.offset_observable
    assert found.fit.status is CalibrationStatus.TOO_FEW
    with pytest.raises(CalibrationInputError):
        fit_line_moving(case.T_init, encoder, t_look, vectors[:-1], R_TCP_CAM)
