"""The nominal drive of an arm whose log states none."""

import math

import numpy as np
import pytest

from recording.foreign.machine_file import drive_model, with_fitted_position_loops
from recording.foreign.mapping import Actuator

STEP_S = 0.008
T_S = np.arange(0.0, 20.0, STEP_S)


def encoder_of(reference: np.ndarray, position_hz: float, velocity_hz: float) -> np.ndarray:
    """A joint in two loops, in steps of 0.1 ms; its reference goes straight from row to row."""
    steps = round(STEP_S / 1e-4)
    fine = np.interp(np.arange(len(reference) * steps) * 1e-4, T_S, reference).tolist()
    position, velocity = 2.0 * math.pi * position_hz, 2.0 * math.pi * velocity_hz
    q, qd, qdd, out = float(reference[0]), 0.0, 0.0, np.zeros(len(reference))
    for k, wanted in enumerate(fine):
        if k % steps == 0:
            out[k // steps] = q
        qdd += 1e-4 * (velocity**2 * (position * (wanted - q) - qd) - 2.0 * velocity * qdd)
        qd += 1e-4 * qdd
        q += 1e-4 * qd
    return out


@pytest.mark.parametrize("velocity_loop_ratio", [4.0, 8.0])
def test_the_bandwidth_of_each_position_loop_is_fitted(velocity_loop_ratio: float) -> None:
    reference = 0.4 * np.sin(0.9 * T_S) + 0.1 * np.sin(5.0 * T_S)
    noise = 1e-5 * np.random.default_rng(1).normal(size=(len(T_S), 2))
    loops = [encoder_of(reference, hz, velocity_loop_ratio * hz) for hz in (2.0, 6.0)]
    resting = np.zeros(len(T_S))
    q = np.column_stack([*(loops + noise.T), resting])
    assumed = drive_model(Actuator(), "position", [1.0, 2.0, 3.0], [0.0, 0.0, 0.0])
    fitted = with_fitted_position_loops(assumed, T_S, q, np.column_stack([reference, reference, resting]))
    bandwidths = np.array(fitted.kp_frac_per_rad) * fitted.velocity_max / (2.0 * math.pi)
    assert bandwidths == pytest.approx([2.0, 6.0, 5.0], rel=0.05)
    assert fitted.notes[-1].endswith("which hides an error of the gain; give bandwidth_hz")
