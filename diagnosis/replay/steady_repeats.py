"""Repeats between which the machine itself changed: a gain that drifts is no noise.

Why: repeats spread over a recording, as they should be, take an oil that warms for noise, and nothing of it is seen.
"""

import numpy as np
from numpy.typing import NDArray

from diagnosis.noise.floor import deviations, fit_whitener, increments
from machine.rotations import Array

SURE = 30.0  # chi2 for each repeat's own gain: five standard errors and more
TOO_FEW = 3  # two repeats have one difference, which is noise as well as anything


def steadied(repeats: Array, motion: Array, dt_s: float, where: NDArray[np.bool_]) -> Array:
    """Residuals of repeats (R, m, n) without what each has in proportion to the motion, if that is no chance.

    Model: d_r = g_r M + noise over white increments; chi2 = sum (g_r / its error)^2, by the noise that still holds it.
    Args:  motion: (R, m, n), what was measured of the same output. where: columns (n,) that are asked.
    """
    if len(repeats) < TOO_FEW:
        return repeats
    out = repeats.copy()
    steps = [increments(one, dt_s) for one in deviations(repeats)]
    mean = increments(motion.mean(axis=0), dt_s)
    for j in np.nonzero(where)[0]:
        white = fit_whitener([one[:, [j]] for one in steps])
        moved = white.whiten(mean[:, [j]])[:, 0]
        power = float(moved @ moved)
        if power <= 0.0:
            continue
        gains = np.array([float(moved @ white.whiten(one[:, [j]])[:, 0]) for one in steps]) / power
        if float(gains @ gains) * power > SURE * (len(repeats) - 1):
            course = motion[:, :, j].mean(axis=0)
            out[:, :, j] -= np.outer(
                (gains - gains.mean()) / np.sqrt(len(repeats) / (len(repeats) - 1.0)), course - course[0]
            )
    return out
