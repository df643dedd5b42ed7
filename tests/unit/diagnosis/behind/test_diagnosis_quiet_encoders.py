"""An encoder's own noise is taken off the course that points are held against; what the joint did is not."""

import numpy as np
import pytest

from diagnosis.behind.quiet_encoders import smooth_encoders

SIGMA_RAD = 5e-5


def course(dt_s: float) -> np.ndarray:
    t = dt_s * np.arange(round(20.0 / dt_s))
    return np.stack([0.2 * np.sin(1.3 * t), 0.05 * np.sin(6.0 * t)], axis=1)


@pytest.mark.parametrize(("dt_s", "share"), [(0.001, 0.3), (0.005, 0.6), (0.01, 0.85)])
def test_noise_goes(dt_s: float, share: float) -> None:
    truth = course(dt_s)
    noisy = truth + np.random.default_rng(3).normal(0.0, SIGMA_RAD, truth.shape)
    left = smooth_encoders(noisy, dt_s) - truth
    assert np.std(left) < share * SIGMA_RAD


def test_a_jump_of_the_speed_stays() -> None:
    dt_s = 0.001
    t = dt_s * np.arange(10000)
    truth = np.where(t < 5.0, 0.0, 0.2 * (t - 5.0))[:, None]
    noisy = truth + np.random.default_rng(4).normal(0.0, SIGMA_RAD, truth.shape)
    beside = np.abs(t - 5.0) < 0.03
    left = (smooth_encoders(noisy, dt_s) - truth)[beside]
    assert np.sqrt(np.mean(left**2)) < 1.2 * SIGMA_RAD  # smoothed all over it would be 6 times that


@pytest.mark.parametrize("dt_s", [0.005, 0.02])
def test_encoders_without_noise_are_left_alone(dt_s: float) -> None:
    truth = course(dt_s)
    assert np.abs(smooth_encoders(truth, dt_s) - truth).max() < 2e-6
    assert smooth_encoders(truth[:8], dt_s) == pytest.approx(truth[:8], abs=0.0)
