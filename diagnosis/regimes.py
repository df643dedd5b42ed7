"""Which part of a motion each sample belongs to: still, forward, backward, near a reversal, early, late."""

import numpy as np
from numpy.typing import NDArray

from machine.rotations import Array

STANDSTILL_SPEED_MAX_RAD_S = 2e-3
REVERSAL_MARGIN_S = 0.5
REGIME_SAMPLES_MIN = 20  # fewer say nothing about a regime

Masks = dict[str, NDArray[np.bool_]]


def regimes_of(position: Array, dt_s: float) -> Masks:
    """Masks (m,) by regime name for one joint's position (m,) sampled every dt_s, without sparse regimes.

    Model: speed by central differences; a reversal is where the sign of motion changes, with 0.5 s to either side.
    """
    speed = np.gradient(position, dt_s)
    moving = np.abs(speed) > STANDSTILL_SPEED_MAX_RAD_S
    first_half = np.arange(len(position)) < len(position) // 2
    masks = {
        "all": np.ones(len(position), dtype=bool),
        "still": ~moving,
        "forward": moving & (speed > 0.0),
        "backward": moving & (speed < 0.0),
        "reversal": _near_reversal(speed, moving, dt_s),
        "first half": first_half,
        "second half": ~first_half,
    }
    return {name: mask for name, mask in masks.items() if name == "all" or int(mask.sum()) >= REGIME_SAMPLES_MIN}


def _near_reversal(speed: Array, moving: NDArray[np.bool_], dt_s: float) -> NDArray[np.bool_]:
    near = np.zeros(len(speed), dtype=bool)
    places = np.nonzero(moving)[0]
    signs = np.sign(speed[places])
    width = round(REVERSAL_MARGIN_S / dt_s)
    for k in np.nonzero(np.diff(signs) != 0.0)[0]:
        near[max(places[k] - width, 0) : places[k + 1] + width + 1] = True
    return near
