"""The side of a play is known after a way of its whole width, and only as long as somebody saw what moved since."""

import numpy as np
import pytest

from server.calibration.play import PlayFollower, play_sides

WIDTHS = np.array([0.004, 0.0])


def followed(qs, t_s=None):
    follower = PlayFollower(WIDTHS)
    for t, q in zip(0.01 * np.arange(len(qs)) if t_s is None else t_s, qs, strict=True):
        follower.take_encoders(float(t), np.array([q, q]))
    return follower.side_in_play


@pytest.mark.parametrize(("way_m", "side"), [(0.0, 0.0), (0.001, 0.25), (0.002, 0.5), (0.004, 1.0), (-0.004, -1.0)])
def test_from_nothing_a_side_becomes_known_with_a_way_of_the_whole_width(way_m, side):
    qs = np.linspace(0.3, 0.3 + way_m, 9)
    assert np.allclose(followed(qs), [side, 0.0])
    assert np.allclose(play_sides(np.column_stack([qs, qs]), WIDTHS, np.zeros(2))[-1], [side, 0.0])


@pytest.mark.parametrize("true_start", [-1.0, -0.3, 0.4, 1.0])
def test_the_true_side_is_never_outside_of_what_is_told(true_start):
    rng = np.random.default_rng(3)
    qs = np.cumsum(rng.normal(0.0, 4e-4, 400))
    true, follower = true_start, PlayFollower(WIDTHS)
    for i, q in enumerate(qs):
        true = float(np.clip(true + (q - qs[i - 1] if i else 0.0) / 0.002, -1.0, 1.0))
        follower.take_encoders(0.01 * i, np.array([q, q]))
        side = follower.side_in_play[0]
        assert abs(true - side) <= 1.0 - abs(side) + 1e-9


def test_what_happens_in_a_gap_or_before_a_restart_is_not_guessed():
    qs = np.linspace(0.0, 0.01, 11)
    assert followed(qs)[0] == 1.0
    assert followed([*qs, 0.01], [*(0.01 * np.arange(11)), 0.5])[0] == 0.0
    assert followed([*qs, 0.01], [*(5.0 + 0.01 * np.arange(11)), 0.01])[0] == 0.0


def test_a_motion_that_turned_back_unasked_is_seen():
    """Half a way down, then stopped: neither side."""
    assert followed([*np.linspace(0.0, 0.01, 11), 0.008])[0] == pytest.approx(0.0)
