"""The weighting of all chords against dense matrices, and the fit against truth and against plain least squares."""

import numpy as np
import pytest
from registration_cases import T_TCP_CAM_NOMINAL, RegistrationCase, draw_case

from machine.rotations import geodesic_angle
from server.calibration.chord_rotation import chord_weighting
from server.calibration.chords import chord_pairs, chord_vectors, find_time_offset, positions_at
from server.calibration.rotation_fit import fit_rotation
from server.calibration.trajectory_matching import DEFAULT_MATCHING_SETTINGS, estimate_camera_rotation

DRIFT, JITTER = 3e-5, 1e-6


def dense_information(steps, drift, jitter, weights):
    """P from the covariance itself: C^-1 with the unknown start projected out."""
    n = len(steps) + 1
    walked = np.concatenate(([0.0], np.cumsum(steps)))
    C = drift * np.minimum.outer(walked, walked) + np.diag(jitter / weights)
    inverse = np.linalg.inv(C)
    ones = np.ones((n, 1))
    return inverse - inverse @ ones @ ones.T @ inverse / float((ones.T @ inverse @ ones)[0, 0])


@pytest.fixture
def drawn():
    rng = np.random.default_rng(2)
    steps, weights = rng.uniform(0.002, 0.02, 39), rng.uniform(0.1, 1.0, 40)
    return steps, weights, rng.normal(size=(40, 3))


def test_weighting_is_the_information_of_drift_and_jitter(drawn):
    steps, weights, values = drawn
    P = dense_information(steps, DRIFT, JITTER, weights)
    found = chord_weighting(steps, DRIFT, JITTER, weights)
    np.testing.assert_allclose(found.project_values(values), P @ values, rtol=1e-6, atol=1e-6 * np.abs(P).max())
    np.testing.assert_allclose(found.project_values(np.ones((40, 1))), 0.0, atol=1e-6 / JITTER)


def test_weighting_sums_over_chords_of_every_length(drawn):
    steps, weights, values = drawn
    P = dense_information(steps, DRIFT, JITTER, weights)
    chords = values[:, None] - values[None]
    by_chords = -0.5 * np.einsum("ij,ija,ijb->ab", P, chords, chords)
    np.testing.assert_allclose(
        values.T @ chord_weighting(steps, DRIFT, JITTER, weights).project_values(values), by_chords
    )


def test_log_determinant_changes_as_the_dense_one(drawn):
    steps, weights, _ = drawn

    def dense(drift):
        return float(np.sum(np.log(np.linalg.eigvalsh(dense_information(steps, drift, JITTER, weights))[1:])))

    found = [chord_weighting(steps, drift, JITTER, weights).log_det for drift in (DRIFT, 30 * DRIFT)]
    assert found[1] - found[0] == pytest.approx(dense(30 * DRIFT) - dense(DRIFT), rel=1e-6)


def test_left_out_is_the_prediction_by_all_others(drawn):
    steps, weights, values = drawn
    differences, variances = chord_weighting(steps, DRIFT, JITTER, weights).left_out(values)
    without = weights.copy()
    without[7] = 1e-9
    predicted = chord_weighting(steps, DRIFT, JITTER, without)
    np.testing.assert_allclose(differences[7], (values - predicted.drift_component(values))[7], rtol=1e-5)
    assert variances[7] == pytest.approx(predicted.smoothed_variance[7], rel=1e-5)


@pytest.mark.parametrize(
    ("kind", "path"), [("noise", "folded 3-D"), ("outliers", "folded 2-D"), ("offset", "folded 2-D")]
)
def test_all_chords_beat_chords_of_one_length_and_least_squares(kind, path):
    errors = {name: [] for name in ("all", "chords 8 cm", "least squares")}
    for seed in range(20):
        case = draw_case(path, kind, seed)
        found = estimate_camera_rotation(case.camera, case.encoder, T_TCP_CAM_NOMINAL)
        assert found.R_tcp_cam is not None, found.reason
        errors["all"].append(geodesic_angle(found.R_tcp_cam, case.R_tcp_cam))
        errors["chords 8 cm"].append(geodesic_angle(_chords_8_cm(case), case.R_base_vo))
        t, points = case.camera.t_s, case.encoder.Ts_base_tcp[:, :3, 3]
        paired = np.column_stack([np.interp(t, case.encoder.t_s, points[:, axis]) for axis in range(3)])
        errors["least squares"].append(geodesic_angle(_kabsch(paired, case.camera.Ts_vo_cam[:, :3, 3]), case.R_base_vo))
    medians = {name: np.median(values) for name, values in errors.items()}
    assert medians["all"] < medians["chords 8 cm"]
    assert medians["all"] < medians["least squares"]


def _chords_8_cm(case: RegistrationCase):
    """Robust fit on chords of one length, after the clock's search."""
    camera, encoder, s = case.camera, case.encoder, DEFAULT_MATCHING_SETTINGS
    Ts = encoder.Ts_base_tcp
    vo, base = camera.Ts_vo_cam[:, :3, 3], Ts[:, :3, 3] + Ts[:, :3, :3] @ T_TCP_CAM_NOMINAL[:3, 3]
    pairs = chord_pairs(positions_at(camera.t_s, encoder.t_s, base)[0], s.chord_m)
    clock = (s.time_offset_bound_s, s.time_offset_step_s, s.time_offset_contrast_min)
    offset_s = find_time_offset(camera.t_s, vo, encoder.t_s, base, pairs, *clock)
    points = positions_at(camera.t_s + offset_s, encoder.t_s, base)[0]
    return fit_rotation(chord_vectors(points, pairs), chord_vectors(vo, pairs)).R_a_b


def _kabsch(a, b):
    from server.calibration.rotation_fit import kabsch

    return kabsch(a - a.mean(axis=0), b - b.mean(axis=0), np.ones(len(a)))


def test_offset_is_found_jointly_within_10_ms():
    for seed in range(6):
        case = draw_case("folded 2-D", "offset", seed)
        found = estimate_camera_rotation(case.camera, case.encoder, T_TCP_CAM_NOMINAL)
        assert found.time_offset_s == pytest.approx(0.15, abs=0.010)
