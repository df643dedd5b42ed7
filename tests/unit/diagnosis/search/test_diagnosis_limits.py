"""Limits of numbers that trade off along a curve hold the truth as often as they say."""

from dataclasses import replace

import numpy as np
import pytest
from made_up_cell import COLUMNS, GAIN, LAG, N, made_up

from diagnosis.search.candidates import named
from diagnosis.search.cell import Cell
from diagnosis.search.fit import fit
from diagnosis.search.limits import WAIT_90, intervals
from machine.effects.layout import ParameterSets

TRUTH = np.array([0.2, 0.25])  # gain, lag


def valley(seed: int) -> Cell:
    """Gain (1 + 6 lag)^2 is known to half a percent, the lag by itself to a fifth: a gain over a frequency's square."""
    noise = np.random.default_rng(seed).normal(size=N)

    def whitened(sets: ParameterSets) -> np.ndarray:
        gain, lag = sets.joint[:, 0, GAIN.column], sets.joint[:, 0, LAG.column]
        both = TRUTH[0] * (1.0 + 6.0 * TRUTH[1]) ** 2 - gain * (1.0 + 6.0 * lag) ** 2
        return noise + 10.0 * both[:, None] * COLUMNS[0] + (TRUTH[1] - lag)[:, None] * COLUMNS[2]

    return replace(made_up((0.0, 0.0, 0.0)), whitened=whitened)


def test_limits_along_a_curve_hold_the_truth_nine_times_of_ten() -> None:
    inside = np.zeros(2)
    for seed in range(60):
        cell = valley(seed)
        found = fit(cell, named(("flow_gain_error", "valve_lag"), (1,)), np.array([0.4, 0.1]), rounds=20)
        limits = intervals(cell, found, 1.0)
        inside += [one.low <= true <= one.high for one, true in zip(limits, TRUTH, strict=True)]
    assert (inside >= 49).all(), inside


def test_a_curved_valley_is_followed_to_its_end() -> None:
    """By straight steps 20 rounds went from 0.4 to 0.38: each gained 0.03 nats of the five that were left."""
    cell = valley(1)
    both = named(("flow_gain_error", "valve_lag"), (1,))
    near, far = (fit(cell, both, np.array(start), rounds=20) for start in ([0.17, 0.29], [0.4, 0.1]))
    assert far.cost == pytest.approx(near.cost, abs=0.05)
    assert far.theta == pytest.approx(near.theta, abs=0.02)


def test_a_delay_is_known_to_the_wait_for_the_next_cycle() -> None:
    cell = made_up((0.0, 0.0, 0.2))
    (lag,) = named(("valve_lag",), (1,))
    kinds = (lag, replace(lag, cycles=(0.05, 0.0)), replace(lag, cycles=(0.05, 0.0), drift_s=0.02))
    sharp, whole, drifting = (intervals(cell, fit(cell, (one,), np.array([0.1])), 1.0)[0] for one in kinds)
    assert sharp.high - sharp.low < 0.05
    assert whole.high - whole.value == pytest.approx(WAIT_90 * 0.05)
    assert 0.05 < whole.value - whole.low < 0.1
    assert drifting.high - drifting.value == pytest.approx(WAIT_90 * 0.05 + 0.02)
    assert drifting.low == whole.low
