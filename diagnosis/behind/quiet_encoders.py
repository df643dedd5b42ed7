"""Encoders without their own noise: the course that points and corners are held against.

Why: whatever smooths an encoder's noise (an oscillation of 13 Hz behind the joint does) brings the arm's model nearer
to a quiet tracker, and would be blamed for it.
"""

from math import comb

import numpy as np

from machine.rotations import Array

SMOOTHING_HALF_WINDOW_S = 0.025  # either side of a row
POLYNOMIAL_ORDER = 2
SMOOTHING_WINDOW_ROWS_MIN = 5  # of the window: a parabola through fewer takes no noise away
DIFFERENCE_ORDER = 4  # of them motion leaves nothing, white noise its own
MAD_TO_SIGMA = 1.4826
NOISE_LIMIT_SIGMAS = 3.0  # standard errors


def smooth_encoders(enc: Array, dt_s: float) -> Array:
    """Encoders (m, n) [rad] by a parabola through the 50 ms about each row, wherever noise alone parts the two.

    Model:   the window's mean squared residual, over the encoder's variance, is (w - 3) / w on the average and scatters
             by sqrt(2 (w - 3)) / w; a joint that changes its speed within the window leaves more, and keeps its rows.
    Source:  local least squares, Savitzky and Golay 1964.
    """
    half = int(SMOOTHING_HALF_WINDOW_S / dt_s + 1e-9)
    window = 2 * half + 1
    if window < SMOOTHING_WINDOW_ROWS_MIN or len(enc) < 2 * window:
        return enc
    weights = np.linalg.pinv(np.vander(np.arange(-half, half + 1), POLYNOMIAL_ORDER + 1, increasing=True))[0]
    free = window - POLYNOMIAL_ORDER - 1
    most = (free + NOISE_LIMIT_SIGMAS * np.sqrt(2.0 * free)) / window
    out = enc.copy()
    for j, raw in enumerate(enc.T):
        smooth = raw.copy()
        smooth[half:-half] = np.convolve(raw, weights[::-1], mode="valid")
        left = np.convolve((raw - smooth) ** 2, np.full(window, 1.0 / window), mode="same")
        noise_only = left <= most * _encoder_noise_sigma(raw) ** 2
        out[noise_only, j] = smooth[noise_only]
    return out


def _encoder_noise_sigma(raw: Array) -> float:
    """An encoder's own noise [rad], from differences that no motion shows."""
    left = np.abs(np.diff(raw, n=DIFFERENCE_ORDER))
    return float(MAD_TO_SIGMA * np.median(left) / np.sqrt(comb(2 * DIFFERENCE_ORDER, DIFFERENCE_ORDER)))
