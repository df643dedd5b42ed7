"""A tracker that drifts as much as it scatters: each instant counts for less, so that no length follows the drift."""

from typing import Any

import numpy as np
import pytest

from diagnosis.behind.point_noise import _alike_in_time

INSTANTS, POINTS, NOISE_M = 150, 2, 1e-4


class Residual:
    """So many instants of two points (3 axes), white, and a drift that all points share."""

    def __init__(self, drift_m: float, lasting: float, seed: int) -> None:
        rng, kept = np.random.default_rng(seed), np.exp(-1.0 / lasting)
        drift = np.zeros((INSTANTS, 3))
        for k in range(1, INSTANTS):
            drift[k] = kept * drift[k - 1] + np.sqrt(1.0 - kept**2) * rng.normal(0.0, drift_m, 3)
        self.rows = np.repeat(drift, POINTS, axis=0) + rng.normal(0.0, NOISE_M, (INSTANTS * POINTS, 3))
        self.noise: Any = self
        self.instant_index = np.repeat(np.arange(INSTANTS), POINTS)

    def __call__(self, _base: Any) -> np.ndarray:
        return self.rows.reshape(1, -1)


def alike(drift_m: float, lasting: float, seed: int) -> float:
    made: Any = Residual(drift_m, lasting, seed)
    return _alike_in_time(made, made, NOISE_M)


@pytest.mark.parametrize("seed", range(8))
def test_independent_instants_count_whole_and_drifting_ones_less(seed: int) -> None:
    assert alike(0.0, 1.0, seed) == 1.0
    assert 3.0 < alike(NOISE_M, 40.0, seed) < 60.0


def test_what_is_far_larger_than_the_noise_is_no_drift_of_a_tracker() -> None:
    assert alike(20.0 * NOISE_M, 40.0, 1) == 1.0
