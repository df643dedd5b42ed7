"""The scorer's own filter: what noise and the baseline's remainder come to together, as one autoregression."""

import numpy as np
from scipy.linalg import solve_toeplitz

from machine.rotations import Array
from tests.gap_benchmark.filters import response_of, whitened_by

ORDER = 6
RESPONSE = 1000


def covariance_of(steps: Array) -> Array:
    """Autocovariance (ORDER + 1,) of increments (m,)."""
    return np.array([float(steps[: len(steps) - k] @ steps[k:]) / len(steps) for k in range(ORDER + 1)])


def process(ar: tuple[float, ...], sigma: float) -> Array:
    """Autocovariance (ORDER + 1,) of an autoregression."""
    response = response_of(np.array(ar), RESPONSE)
    return sigma**2 * np.array([float(response[: RESPONSE - k] @ response[k:]) for k in range(ORDER + 1)])


def filtered(steps: Array, covariance: Array, least: float) -> Array:
    """Increments (m,) in floors behind the filter that whitens a covariance; `least`: sigma is never below it."""
    a = solve_toeplitz(covariance[:-1] * np.concatenate([[1.0 + 1e-9], np.ones(ORDER - 1)]), covariance[1:])
    sigma = np.hypot(least, np.sqrt(max(float(covariance[0] - a @ covariance[1:]), 0.0)))
    return whitened_by(a, steps) / sigma
