"""Which way a signal last went: what has play or a memory answers by that, whatever it is called."""

import numpy as np
from numba import njit

from machine.effects.kernel import play_operator
from machine.rotations import Array


def last_way(x: Array, width: float) -> Array:
    """-1 to 1 (m,): which way a signal (m,) last went further than twice a width; 0 where it begins.

    Model: how far it is ahead of what follows it with such a play, over width; between its ends it has just turned.
    """
    return _ahead(np.ascontiguousarray(x, dtype=float), width) / width


@njit(cache=True)
def _ahead(x: Array, width: float) -> Array:
    out = np.zeros_like(x)
    for i in range(1, len(x)):
        out[i] = x[i] - play_operator(x[i], x[i - 1] - out[i - 1], width)
    return out
