"""Playback, stop ramps and look-ahead on the path itself, against evaluations that share nothing with it."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.interpolate import BPoly

from protocol.messages import Knot, pad_to_eight_axes
from sim_plc.plc.knot_checks import segment_peaks
from sim_plc.plc.path import RING_SIZE_KNOTS, advance, is_short_of_knots, path_point, ramp_down, stop_time

N = 6
DT = 1e-3
LIMITS = np.array([0.7, 0.5, 0.7, 2.0, 2.0, 3.0])  # rad/s2


def ring_of(t, q, qd, qdd, first=0):
    times, knots = np.zeros(RING_SIZE_KNOTS), np.zeros((RING_SIZE_KNOTS, 3, q.shape[1]))
    for i in range(len(t)):
        slot = (first + i) % RING_SIZE_KNOTS
        times[slot], knots[slot] = t[i], (q[i], qd[i], qdd[i])
    return times, knots


def smooth_knots(seed, count=40, step=0.05):
    """Knots of sums of slow sines: smooth, each joint differently."""
    rng = np.random.default_rng(seed)
    t = np.arange(count) * step
    amplitude, omega, phase = rng.uniform(0.02, 0.1, (2, N)), rng.uniform(0.5, 2.5, (2, N)), rng.uniform(0, 6, (2, N))
    angle = omega[:, None] * t[None, :, None] + phase[:, None]
    q = (amplitude[:, None] * np.sin(angle)).sum(0)
    qd = (amplitude[:, None] * omega[:, None] * np.cos(angle)).sum(0)
    qdd = -(amplitude[:, None] * omega[:, None] ** 2 * np.sin(angle)).sum(0)
    return t, q, qd, qdd


def bernstein(t, q, qd, qdd):
    """SciPy's Hermite interpolation of the same knots, as reference."""
    return BPoly.from_derivatives(t, np.stack([q, qd, qdd], axis=1))


@pytest.mark.parametrize("seed", range(5))
def test_a_segment_is_the_hermite_quintic_to_1e_12(seed):
    t, q, qd, qdd = smooth_knots(seed)
    times, knots = ring_of(t, q, qd, qdd)
    reference = bernstein(t, q, qd, qdd)
    out = np.empty((3, N))
    for sigma in np.random.default_rng(seed).uniform(0, t[-1], 200):
        k = int(np.searchsorted(t, sigma, side="right")) - 1
        path_point(times, knots, k, sigma, out)
        assert np.abs(out[0] - reference(sigma)).max() < 1e-12  # rad
        assert np.abs(out[1] - reference(sigma, 1)).max() < 1e-12  # rad/s
        assert np.abs(out[2] - reference(sigma, 2)).max() < 1e-9  # rad/s2


def test_playback_over_all_knots_and_round_the_ring_is_the_quintic_to_1e_12():
    t, q, qd, qdd = smooth_knots(7, count=60)
    times, knots = ring_of(t, q, qd, qdd, first=30)  # indices 30..89: crosses slot 63 -> 0
    reference = bernstein(t, q, qd, qdd)
    k, sigma, rate, out = 30, 0.0, 1.0, np.empty((3, N))
    for step in range(1, round(t[-1] / DT)):
        k, sigma, rate = advance(times, knots, 89, k, sigma, rate, 1.0, DT, LIMITS, out)
        assert np.abs(out[0] - reference(step * DT)).max() < 1e-12
        assert np.abs(out[1] - reference(step * DT, 1)).max() < 1e-12
    assert rate == 1.0


@pytest.mark.parametrize("seed", range(20))
def test_braking_along_the_path_keeps_to_the_path_and_to_every_limit(seed):
    t, q, qd, qdd = smooth_knots(seed)
    times, knots = ring_of(t, q, qd, qdd)
    reference = bernstein(t, q, qd, qdd)
    rng = np.random.default_rng(100 + seed)
    sigma = rng.uniform(0.1, 0.6)
    k, rate, out = int(sigma / 0.05), 1.0, np.empty((3, N))
    last = len(t) - 1
    needed = stop_time(times, knots, last, k, sigma, rate, DT, LIMITS, 2.0)
    assert needed >= 0.0
    path_point(times, knots, k, sigma, out)
    before, elapsed = out[1].copy(), 0.0
    while rate > 0.0:
        k, sigma, rate = advance(times, knots, last, k, sigma, rate, 0.0, DT, LIMITS, out)
        assert np.abs(out[0] - reference(sigma)).max() < 1e-12
        assert (np.abs(out[1] - before) <= LIMITS * DT * 1.002).all()  # 0.2 %: where a cycle ends is guessed
        before, elapsed = out[1].copy(), elapsed + DT
    assert elapsed == pytest.approx(needed, abs=1e-9)
    assert np.abs(before).max() == 0.0


def test_on_a_straight_joint_path_braking_takes_speed_over_deceleration():
    direction = np.array([0.2, -0.1, 0.05, 0.1, 0.0, -0.3])
    t = np.arange(60) * 0.05
    q, qd, qdd = t[:, None] * direction, np.tile(direction, (60, 1)), np.zeros((60, N))
    times, knots = ring_of(t, q, qd, qdd)
    bound = (np.abs(direction) / LIMITS).max()
    assert stop_time(times, knots, 59, 0, 0.01, 1.0, DT, LIMITS, 1.0) == pytest.approx(bound, abs=DT)
    assert stop_time(times, knots, 59, 0, 0.01, 1.0, DT, LIMITS, bound / 2) == -1.0  # longer than allowed


def test_look_ahead_brakes_in_time_for_the_last_knot():
    direction = np.array([0.2, -0.1, 0.05, 0.1, 0.0, -0.3])
    t = np.arange(20) * 0.05
    q, qd, qdd = t[:, None] * direction, np.tile(direction, (20, 1)), np.zeros((20, N))
    times, knots = ring_of(t, q, qd, qdd)
    k, sigma, rate, out = 0, 0.0, 1.0, np.empty((3, N))
    while not is_short_of_knots(times, knots, 19, k, sigma, rate, 1.0, DT, LIMITS, 2.0):
        k, sigma, rate = advance(times, knots, 19, k, sigma, rate, 1.0, DT, LIMITS, out)
    while rate > 0.0:
        k, sigma, rate = advance(times, knots, 19, k, sigma, rate, 0.0, DT, LIMITS, out)
    assert t[-1] - 2 * DT <= sigma <= t[-1]  # as late as possible, and not past the end


def test_a_lower_override_slows_down_within_the_limits_and_a_higher_one_speeds_up_again():
    t, q, qd, qdd = smooth_knots(3, count=64)
    times, knots = ring_of(t, q, qd, qdd)
    k, sigma, rate, out = 0, 0.2, 1.0, np.empty((3, N))
    path_point(times, knots, k + 4, sigma, out)
    k, before, rates = 4, out[1].copy(), []
    for step in range(1200):
        target = 0.3 if step < 600 else 0.9
        k, sigma, rate = advance(times, knots, 63, k, sigma, rate, target, DT, LIMITS, out)
        assert (np.abs(out[1] - before) <= LIMITS * DT * 1.002).all()
        before = out[1].copy()
        rates.append(rate)
    assert rates[599] == pytest.approx(0.3)
    assert rates[-1] == pytest.approx(0.9)


def test_joint_ramp_ends_at_rest_without_a_step():
    out = np.zeros((3, 2))
    out[0], out[1] = [1.0, 2.0], [0.2, -0.1]
    decel = np.array([0.4, 0.2])
    steps = 0
    while ramp_down(out, decel, DT):
        assert np.abs(out[2]) == pytest.approx(decel)
        steps += 1
    assert steps == pytest.approx(500, abs=1)
    assert out[0] == pytest.approx([1.05, 1.975], abs=1e-9)
    assert (out[1] == 0.0).all()


def test_peaks_between_knots_agree_with_the_polynomial():
    rng = np.random.default_rng(2)
    for _ in range(50):
        T = 0.05
        q0, v0, a0, q1, v1, a1 = rng.normal(size=6) * [1, 0.3, 1, 0.01, 0.3, 1]
        q1 = q0 + (v0 + v1) / 2 * T + q1 * 0.1
        knots = [Knot(0, pad_to_eight_axes((q0,)), pad_to_eight_axes((v0,)), pad_to_eight_axes((a0,)))]
        knots.append(Knot(50_000_000, pad_to_eight_axes((q1,)), pad_to_eight_axes((v1,)), pad_to_eight_axes((a1,))))
        A = np.array([[T**3, T**4, T**5], [3 * T**2, 4 * T**3, 5 * T**4], [6 * T, 12 * T**2, 20 * T**3]])
        c = np.linalg.solve(A, [q1 - q0 - v0 * T - a0 / 2 * T * T, v1 - v0 - a0 * T, a1 - a0])
        poly = Polynomial([q0, v0, a0 / 2, *c])
        u = np.arange(1, 8) / 8 * T
        qd, qdd = segment_peaks(knots[0], knots[1], 0)
        assert qd == pytest.approx(np.abs(poly.deriv()(u)).max(), rel=1e-9)
        turns = [float(t.real) for t in poly.deriv(3).roots() if abs(t.imag) < 1e-12 and 0.0 < t.real < T]
        assert qdd == pytest.approx(max((abs(poly.deriv(2)(t)) for t in turns), default=0.0), rel=1e-9)
