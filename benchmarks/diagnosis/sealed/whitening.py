"""The scorer's own filter: what noise and the baseline's remainder come to together, as one autoregression."""

import numpy as np
from scipy.linalg import solve_toeplitz

from benchmarks.diagnosis.sealed.filters import response_of, whitened_by
from machine.rotations import Array

ORDER = 20  # a second: the remainders of a machine file remember as long
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


def beside(rows: Array, columns: list[Array]) -> Array:
    """Rows (m,) in floors where numbers vary, too: (I + B B')^(-1/2) rows, B what a standard deviation of each does."""
    if not columns:
        return rows
    U, s, _ = np.linalg.svd(np.stack(columns, axis=1), full_matrices=False)
    return np.asarray(rows - U @ ((1.0 - 1.0 / np.sqrt(1.0 + s**2)) * (U.T @ rows)))
