"""Linear filters of the generator and the judge; scipy.signal takes longer to import than a case to filter."""

import numpy as np
from numba import njit

from machine.rotations import Array


@njit(cache=True)
def filtered_by(b: Array, a: Array, x: Array) -> Array:
    """As scipy.signal.lfilter of x (m,), from rest; a[0] is 1."""
    out = np.zeros(len(x))
    for i in range(len(x)):
        for k in range(min(i + 1, len(b))):
            out[i] += b[k] * x[i - k]
        for k in range(1, min(i + 1, len(a))):
            out[i] -= a[k] * out[i - k]
    return out


def whitened_by(ar: Array, x: Array) -> Array:
    """x (m,) less what an autoregression foresees of it."""
    return filtered_by(np.concatenate([[1.0], -np.asarray(ar, dtype=float)]), np.ones(1), np.ascontiguousarray(x))


def response_of(ar: Array, count: int) -> Array:
    """What follows one innovation of an autoregression (count,)."""
    return filtered_by(np.ones(1), np.concatenate([[1.0], -np.asarray(ar, dtype=float)]), np.eye(1, count)[0])
