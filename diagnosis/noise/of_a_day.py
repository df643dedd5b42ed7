"""Noise of a whole day: what one number is off by moves all residuals of a recording together."""

from dataclasses import dataclass

import numpy as np

from machine.rotations import Array


@dataclass(frozen=True, slots=True)
class DayNoise:
    """Directions (N, k), orthonormal, in which residuals lie further than white noise, and `removed_frac` (k,)."""

    noise_directions: Array
    removed_frac: Array

    def whiten(self, residuals: Array) -> Array:
        """Residuals (sets, N), white but for this noise, made white: (I + B B')^(-1/2) r.

        Each by itself: rounding of a sum over several depends on how many they are, and a set's result must not.
        """
        return np.array(
            [r - self.noise_directions @ (self.removed_frac * (self.noise_directions.T @ r)) for r in residuals]
        )


def day_noise(columns: Array) -> DayNoise:
    """Of columns B (N, k): what one standard deviation of each number does to the residuals."""
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    return DayNoise(U, 1.0 - 1.0 / np.sqrt(1.0 + s**2))
