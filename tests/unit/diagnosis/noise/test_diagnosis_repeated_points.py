"""A tracker's noise from repeats of one command: what an arm does wrong it does again, its scatter never."""

import numpy as np
import pytest

from diagnosis.noise.of_repeated_points import RepeatedPoints, repeated_points

EVERY_S, LASTS_S, RUNS, POINTS = 0.05, 12.0, 4, 3
NOISE_M = np.array([1e-4, 2e-4, 1.5e-4])


def found(drift_m: float, wrong_m: float = 5e-3, seed: int = 1) -> RepeatedPoints | None:
    """Points of an arm that is wrong by so much, alike in every run, beside a tracker that drifts from run to run."""
    rng = np.random.default_rng(seed)
    when, which, rows = [], [], []
    for run in range(RUNS):
        since = np.arange(0.0, LASTS_S, EVERY_S) + rng.uniform(0.0, 0.4 * EVERY_S)
        drift = rng.normal(0.0, drift_m, 3)
        for point in range(POINTS):
            wrong = wrong_m * np.sin(0.5 * since + point)
            when.append(100.0 + 20.0 * run + since)
            which.append(np.full(len(since), point))
            rows.append(wrong[:, None] + drift + rng.normal(0.0, NOISE_M, (len(since), 3)))
    runs = tuple((100.0 + 20.0 * run, 100.0 + 20.0 * run, 112.0 + 20.0 * run) for run in range(RUNS))
    return repeated_points(np.concatenate(rows), np.concatenate(which), np.concatenate(when), (runs,))


@pytest.mark.parametrize("seed", range(5))
def test_what_repeats_differ_by_is_the_noise_however_wrong_the_arm_is(seed: int) -> None:
    again = found(0.0, seed=seed)
    assert again is not None
    assert again.point_sigma_m == pytest.approx(NOISE_M, rel=0.1)
    assert again.sigma_dof == pytest.approx((RUNS - 1) * POINTS * LASTS_S / EVERY_S, rel=0.02)
    assert not again.drift_m.any()


@pytest.mark.parametrize("seed", range(5))
def test_a_drift_from_run_to_run_is_told_from_scatter(seed: int) -> None:
    again = found(2e-4, seed=seed)
    assert again is not None
    assert 0.8e-4 < float(np.sqrt(np.mean(again.drift_m**2))) < 4e-4
    assert again.scatters


def test_what_differs_by_far_more_than_a_trackers_drift_is_no_scatter() -> None:
    """A link that grows as it warms: no floor may hide it."""
    again = found(3e-3)
    assert again is not None
    assert not again.scatters


def test_runs_without_samples_tell_nothing() -> None:
    runs = (((0.0, 0.0, 1.0), (2.0, 2.0, 3.0)),)
    assert repeated_points(np.zeros((0, 3)), np.zeros(0, int), np.zeros(0), runs) is None
