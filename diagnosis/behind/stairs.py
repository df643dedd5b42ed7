"""A coarse encoder's stairs as the ramp that they stand for: what points behind the joint are held against.

Why: 0.8 mrad are 2 mm of a boom's tip, ten times a tracker's noise. A damped oscillation smooths them, and was blamed
for that.
"""

import numpy as np

from machine.rotations import Array

COARSE_ENCODER_STEP_MIN_RAD = 2e-4  # a finer one is next to nothing at any tip
# Of a step: RMS error of a ramp that repeats, which meet the same stairs, do not show; a stair has 0.29
RAMP_ERROR_RMS_STEP_FRAC = 0.06
ENCODER_STEP_INTERVAL_MAX_S = 0.5  # between two changes: in a longer one it is unknown when the joint went on


def smooth_encoder_steps(enc: Array, steps_rad: Array, dt_s: float) -> Array:
    """Encoders (m, n) [rad]; those with steps (n,) by straight lines through the middles of their changes.

    Model: where the reading goes from one stair to the next the angle is between the two, within a row; a change back
           to the stair before says no more than that, and a joint that stands for long is somewhere on its stair.
    """
    out = enc.copy()
    for j in np.nonzero(steps_rad)[0]:
        out[:, j] = _replace_steps_by_ramps(enc[:, j], dt_s)
    return out


def steps_visible_at_tip(steps_rad: Array) -> Array:
    """Those of the encoders' steps (n,) [rad] that are seen at the tip; 0 of finer ones."""
    return np.where(steps_rad >= COARSE_ENCODER_STEP_MIN_RAD, steps_rad, 0.0)


def _replace_steps_by_ramps(raw: Array, dt_s: float) -> Array:
    change = np.diff(raw)
    at = np.nonzero(change != 0.0)[0]
    if len(at) < 2:
        return raw
    row, edge, way = at + 0.5, raw[at] + 0.5 * change[at], np.sign(change[at])
    out = raw.copy()
    for k in range(len(at) - 1):
        between = slice(at[k] + 1, at[k + 1] + 1)
        if (row[k + 1] - row[k]) * dt_s > ENCODER_STEP_INTERVAL_MAX_S or way[k] != way[k + 1]:
            continue
        share = (np.arange(between.start, between.stop) - row[k]) / (row[k + 1] - row[k])
        out[between] = edge[k] + share * (edge[k + 1] - edge[k])
    return out
