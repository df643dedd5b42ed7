"""Points of one instant swing with the slew: told apart from each one's own noise, and weighed as one."""

import numpy as np
import pytest

from benchmarks.diagnosis.sealed.sensitivity import _less_swing
from diagnosis.noise.of_points import TANGENTIAL_AXIS, PointNoise, instants_of, variances_of

OWN = np.array([2e-4, 1e-4, 3e-4])
SWING_RAD = 3e-4
INSTANTS = 4000
REACH = np.tile([1.5, 4.0, 3.0], INSTANTS)
WHICH = np.repeat(np.arange(INSTANTS), 3)


def drawn(swing_rad: float) -> np.ndarray:
    rng = np.random.default_rng(7)
    rows = rng.normal(0.0, OWN, (len(REACH), 3))
    rows[:, TANGENTIAL_AXIS] += REACH * rng.normal(0.0, swing_rad, INSTANTS)[WHICH]
    return rows


def test_noise_with_a_swing_comes_out_white() -> None:
    white = PointNoise(OWN, SWING_RAD, REACH, WHICH).whiten(drawn(SWING_RAD).reshape(1, -1)).reshape(-1, 3)
    np.testing.assert_allclose(white.var(axis=0), 1.0, atol=0.05)
    across = white[:, TANGENTIAL_AXIS].reshape(INSTANTS, 3)
    np.testing.assert_allclose(np.cov(across.T), np.eye(3), atol=0.06)


def test_without_a_swing_each_point_counts_by_its_own_noise() -> None:
    rows = drawn(0.0)
    white = PointNoise(OWN, 0.0, REACH, WHICH).whiten(rows.reshape(1, -1))
    np.testing.assert_allclose(white.reshape(-1, 3), rows / OWN)


def test_own_noise_and_swing_are_told_apart() -> None:
    noise = PointNoise(OWN, 0.0, REACH, WHICH)
    own, swing = variances_of(drawn(SWING_RAD), noise)
    np.testing.assert_allclose(np.sqrt(own), OWN, rtol=0.1)
    assert np.sqrt(swing) == pytest.approx(SWING_RAD, rel=0.1)
    alone = PointNoise(OWN, 0.0, REACH, np.arange(len(REACH)))
    own, swing = variances_of(drawn(SWING_RAD), alone)
    assert swing == 0.0
    assert np.sqrt(own[TANGENTIAL_AXIS]) > 3.0 * OWN[TANGENTIAL_AXIS]  # taken as each point's own


def test_instants_are_numbered_by_time_and_more_points_get_their_own() -> None:
    when = np.array([2.0, 2.0, 0.5, 2.0, 0.5])
    assert list(instants_of(when)) == [1, 1, 0, 1, 0]
    more = PointNoise(OWN, SWING_RAD, np.ones(5), instants_of(when)).with_more(np.full(4, 2.0), 2)
    assert list(more.instant_index[5:]) == [2, 2, 3, 3]
    assert list(more.reach_m) == [1.0] * 5 + [2.0] * 4


def test_the_scorer_weighs_a_change_as_the_tool_does() -> None:
    rng = np.random.default_rng(3)
    at = rng.uniform(1.0, 4.0, (5, 3, 3))
    change = rng.normal(0.0, 1e-3, (5, 3, 3))
    theirs = _less_swing(change / OWN, at, SWING_RAD / OWN[TANGENTIAL_AXIS])
    reach = np.hypot(at[..., 0], at[..., 1]).ravel()
    ours = PointNoise(OWN, SWING_RAD, reach, np.repeat(np.arange(5), 3)).whiten(change.reshape(1, -1))
    np.testing.assert_allclose(theirs.ravel(), ours[0], rtol=1e-9)
