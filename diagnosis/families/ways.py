"""Which way a signal last went: what has play or a memory answers by that, whatever it is called."""

import numpy as np
from numba import njit

from machine.rotations import Array


def last_way(x: Array, width: float) -> Array:
    """-1 to 1 (m,): which way a signal (m,) last went further than twice a width; 0 where it begins.

    Model: the stop operator s' = clip(s + dx, -width, width), over width; what is between its ends came by turning.
    """
    return _stopped(np.ascontiguousarray(x, dtype=float), width) / width


@njit(cache=True)
def _stopped(x: Array, width: float) -> Array:
    out = np.zeros_like(x)
    for i in range(1, len(x)):
        out[i] = min(width, max(-width, out[i - 1] + x[i] - x[i - 1]))
    return out
