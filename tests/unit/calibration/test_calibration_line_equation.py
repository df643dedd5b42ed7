"""The paper's line equation: eq. 10-16 term by term, its own error of quantisation, its servo variant, its refusals."""

import numpy as np
import pytest
from line_circles import drive

from server.calibration.checks import CalibrationInputError
from server.calibration.contracts import CalibrationStatus
from server.calibration.line_equation import LineServo, LineServoSettings, circle_points, image_distance, line_reference


def test_the_circle_is_eq_10_to_12_with_the_centre_first_and_last():
    case = drive(1)
    T, points = case.T_init, circle_points(case.T_init)
    assert points.shape == (18, 3)
    np.testing.assert_array_equal(points[[0, -1]], np.array([T[:3, 3], T[:3, 3]]))
    np.testing.assert_allclose(points[1], T[:3, 3] + 0.2 * T[:3, 0], atol=1e-12)
    np.testing.assert_allclose(points[1], points[-2], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(points[1:-1] - T[:3, 3], axis=1), 0.2, atol=1e-12)
    np.testing.assert_allclose((points - T[:3, 3]) @ T[:3, 2], 0.0, atol=1e-12)
    quarter = circle_points(T, n_points=3 + 4)[2]
    np.testing.assert_allclose(quarter, T[:3, 3] + 0.2 * T[:3, 1], atol=1e-12)


def test_distance_ignores_depth():
    assert image_distance(np.array([0.1, 0.2, 0.9]), np.array([0.4, 0.6, 0.1])) == pytest.approx(0.5)


@pytest.mark.parametrize("angle_deg", [0.0, 24.0, 96.0, 336.0])
def test_exact_when_the_ooi_lies_in_the_direction_of_a_point(angle_deg):
    a = np.deg2rad(angle_deg)
    case = drive(3, lateral=(0.35 * np.cos(a), 0.35 * np.sin(a)), turn_deg=7.0)
    found = line_reference(case.T_init, case.points, case.distances)
    assert found.status is CalibrationStatus.OK
    assert found.T_base_tcp_ref is not None
    np.testing.assert_allclose(found.T_base_tcp_ref[:3, 3], case.p_goal, atol=1e-9)
    np.testing.assert_array_equal(found.T_base_tcp_ref[:3, :3], case.T_init[:3, :3])
    assert found.distance_min_m == pytest.approx(0.15, abs=1e-9)
    assert found.residual_rms_m < 1e-9


def test_between_two_points_it_misses_by_the_quantisation_and_the_residuals_tell():
    a = np.deg2rad(36.0)  # in the middle between 24 and 48 deg
    case = drive(4, lateral=(0.35 * np.cos(a), 0.35 * np.sin(a)))
    found = line_reference(case.T_init, case.points, case.distances)
    assert found.T_base_tcp_ref is not None
    miss = np.linalg.norm(found.T_base_tcp_ref[:3, 3] - case.p_goal)
    assert miss == pytest.approx(0.35 * 2 * np.sin(np.deg2rad(6.0)), abs=0.01)
    assert found.residual_rms_m > 0.02


def test_points_not_seen_do_not_count():
    case = drive(5, lateral=(0.35, 0.0))
    distances = case.distances.copy()
    distances[[5, 9]] = np.nan
    found = line_reference(case.T_init, case.points, distances)
    assert found.T_base_tcp_ref is not None
    np.testing.assert_allclose(found.T_base_tcp_ref[:3, 3], case.p_goal, atol=1e-9)
    assert np.isnan(found.residuals_m[[5, 9]]).all()


def test_an_ooi_inside_the_circle_is_refused_since_eq_16_would_pass_it():
    case = drive(6, lateral=(0.12, 0.0))
    found = line_reference(case.T_init, case.points, case.distances)
    assert found.status is CalibrationStatus.DEGENERATE
    assert found.T_base_tcp_ref is None
    assert "inside" in found.reason


def test_an_ooi_in_the_middle_has_no_nearest_point():
    case = drive(7, lateral=(0.0, 0.0))
    assert line_reference(case.T_init, case.points, case.distances).status is CalibrationStatus.DEGENERATE


def test_too_few_points_and_bad_input():
    case = drive(8)
    distances = np.full(18, np.nan)
    distances[:4] = 0.3
    found = line_reference(case.T_init, case.points, distances)
    assert found.status is CalibrationStatus.TOO_FEW
    with pytest.raises(CalibrationInputError):
        line_reference(case.T_init, case.points[:-1], case.distances)
    with pytest.raises(CalibrationInputError):
        line_reference(case.T_init, case.points, -case.distances)
    with pytest.raises(CalibrationInputError):
        circle_points(case.T_init, radius_m=0.0)


def servo_run(direction, p_start, p_goal, R, steps=5):
    """Distances at each step of the servo on a machine that goes exactly where it is told."""
    servo = LineServo(direction, LineServoSettings(steps_max=steps, tolerance_m=1e-4, growth_max=10.0))
    p, seen = p_start.copy(), []
    for k in range(steps):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, p
        in_plane = R[:, :2].T @ (p_goal - p)
        step = servo.next_reference(10.0 * k, T, np.zeros(3), np.append(in_plane, 0.5))
        seen.append(step.distance_m)
        if step.T_base_tcp_ref is None:
            break
        p = step.T_base_tcp_ref[:3, 3]
    return seen


def test_the_servo_variant_ends_at_once_when_the_direction_is_right():
    case = drive(9)
    direction = (case.p_goal - case.T_init[:3, 3]) / np.linalg.norm(case.p_goal - case.T_init[:3, 3])
    seen = servo_run(direction, case.T_init[:3, 3], case.p_goal, case.T_init[:3, :3])
    assert seen[1] < 1e-9


def test_the_servo_variant_does_not_mend_a_wrong_direction():
    """As the paper says: 6 deg off at 0.32 m leave 34 mm; further steps make it worse, never better."""
    case = drive(10)
    exact = (case.p_goal - case.T_init[:3, 3]) / np.linalg.norm(case.p_goal - case.T_init[:3, 3])
    n, s = case.T_init[:3, 0], case.T_init[:3, 1]
    a = np.deg2rad(6.0) + np.arctan2(exact @ s, exact @ n)
    seen = servo_run(np.cos(a) * n + np.sin(a) * s, case.T_init[:3, 3], case.p_goal, case.T_init[:3, :3])
    assert 0.025 < seen[1] < 0.045
    assert min(seen[2:]) > seen[1]


def test_the_servo_waits_stops_and_refuses():
    case = drive(11)
    T, eye = case.T_init, np.array([1.0, 0.0, 0.0])
    servo = LineServo(eye)
    far, near = np.array([0.3, 0.0, 0.5]), np.array([0.002, 0.001, 0.5])
    assert servo.next_reference(0.0, T, np.zeros(3), far).T_base_tcp_ref is not None
    early = servo.next_reference(0.2, T, np.zeros(3), far)
    assert early.T_base_tcp_ref is None
    assert not early.ended
    assert servo.next_reference(2.0, T, np.zeros(3), near).ended
    worse = servo.next_reference(3.0, T, np.zeros(3), 2.0 * far)
    assert worse.ended
    assert "direction" in worse.reason
    assert "look again" in servo.next_reference(4.0, T, np.zeros(3), np.full(3, np.nan)).reason
    with pytest.raises(CalibrationInputError):
        servo.next_reference(0.5, T, np.zeros(3), far)
    with pytest.raises(CalibrationInputError):
        LineServo(2.0 * eye)
