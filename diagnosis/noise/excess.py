"""The variance that recordings of unequal noise have in common."""

import numpy as np

from machine.rotations import Array

REWEIGHTING_ITERATIONS = 20  # of weighing again; it settles within a few
VARIANCE_EPSILON = 1e-30  # keeps weights finite where nothing is measured


def common_excess(totals: Array, noises: Array) -> Array:
    """Variance (n,) beyond the noise that recordings have in common.

    Model: a mean square scatters by a share of itself, so that the most likely common excess L of
           total_k ~ noise_k + L weighs each recording by 1 / (noise_k + L)^2. An even mean would let noisy recordings,
           whose noise alone is less well known than L is large, drown what the quiet ones show.
    Args:  totals, noises: (recordings, n), mean squares in all and of noise alone.
    """
    excess = np.maximum((totals - noises).mean(axis=0), 0.0)
    least = 1e-3 * np.abs(totals).mean(axis=0) + VARIANCE_EPSILON
    for _ in range(REWEIGHTING_ITERATIONS):
        weights = (noises + np.maximum(excess, least)) ** -2
        excess = np.maximum((weights * (totals - noises)).sum(axis=0) / weights.sum(axis=0), 0.0)
    return excess
