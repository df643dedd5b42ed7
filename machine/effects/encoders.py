"""Encoder readings at rest and the angles they stand for."""

import numpy as np

from machine.effects.kernel import BACKLASH, BIAS, ECC_AMPLITUDE, ECC_ORDER, ECC_PHASE, SCALE
from machine.effects.layout import ParameterSets
from machine.rotations import Array

FIXED_POINT_STEPS = 16  # contraction below 0.14 inside the bounds: rounding after 16


def true_angles(sets: ParameterSets, readings: Array, which: int = 0) -> Array:
    """Motor-side angles (m, n) [rad] that readings stand for."""
    P = sets.joint_parameters[which]
    q = np.array(readings, dtype=float)
    if not np.any(P[:, ECC_AMPLITUDE]):
        return (q - P[:, BIAS]) / (1.0 + P[:, SCALE])
    for _ in range(FIXED_POINT_STEPS):
        wave = P[:, ECC_AMPLITUDE] * np.sin(P[:, ECC_ORDER] * q + P[:, ECC_PHASE])
        q = (readings - P[:, BIAS] - wave) / (1.0 + P[:, SCALE])
    return q


def angles_at_rest(sets: ParameterSets, readings: Array, sides: Array | None = None, which: int = 0) -> Array:
    """Link-side angles (m, n) [rad] at rest.

    Args: sides: where in its play each link rests, -1..1 of half the width (m, n) or (n,): -1 after motion forward,
          when the link trails; 0 (without `sides`) where it is not known.
    """
    q = true_angles(sets, readings, which)
    return q if sides is None else q + 0.5 * sets.joint_parameters[which, :, BACKLASH] * np.asarray(sides, dtype=float)
