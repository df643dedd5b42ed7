"""What recordings of unequal noise have in common beyond it."""

import numpy as np
import pytest

from diagnosis.left_over import common_excess

DOF = 60


def mean_squares(noises: np.ndarray, excess: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Mean squares (recordings, 1) in all, and of noise alone as repeats would show it."""
    chance = rng.chisquare(DOF, (2, *noises.shape)) / DOF
    return (noises + excess) * chance[0], noises * chance[1]


def test_noisy_recordings_do_not_drown_what_quiet_ones_show() -> None:
    rng = np.random.default_rng(4)
    noises = np.array([[0.04], [0.04], [0.25], [0.25], [2.2], [2.2]])
    made = [mean_squares(noises, 0.1, rng) for _ in range(300)]
    found = np.array([common_excess(*one)[0] for one in made])
    plain = np.array([np.maximum((totals - noise).mean(axis=0), 0.0)[0] for totals, noise in made])
    assert np.median(found) == pytest.approx(0.1, rel=0.15)
    assert np.std(found) < 0.3 * np.std(plain)


def test_without_an_excess_none_is_found() -> None:
    rng = np.random.default_rng(5)
    found = [common_excess(*mean_squares(np.array([[0.04], [0.25], [2.2]]), 0.0, rng))[0] for _ in range(300)]
    assert np.median(found) < 0.01
    assert min(found) >= 0.0


def test_no_noise_at_all_is_no_division_by_zero() -> None:
    assert common_excess(np.array([[1.0, 0.0], [3.0, 0.0]]), np.zeros((2, 2))) == pytest.approx([2.0, 0.0], abs=0.5)


def test_what_chance_brought_below_nothing_is_nothing() -> None:
    assert common_excess(np.array([[-1e-3], [-2e-3]]), np.zeros((2, 1))) == pytest.approx([0.0])
    assert common_excess(np.zeros((2, 1)), np.zeros((2, 1))) == pytest.approx([0.0])
