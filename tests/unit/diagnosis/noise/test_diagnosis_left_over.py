"""What recordings of unequal noise have in common beyond it."""

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from diagnosis.baseline.left_over import common_process, lagged_products
from diagnosis.noise.excess import common_excess

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


SWING = np.array([1.7, -0.85])  # a slow swing, as the oil's


def made_moments(noise_sigmas: list[float], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Of a swing with white noise of several sizes upon it, and of each noise alone, measured apart."""
    rng = np.random.default_rng(seed)
    totals, noises = [], []
    for sigma in noise_sigmas:
        swing = lfilter([1.0], np.concatenate([[1.0], -SWING]), rng.normal(size=3000))
        totals.append(lagged_products([swing + sigma * rng.normal(size=3000)]))
        noises.append(lagged_products([sigma * rng.normal(size=1500)]))
    return np.array(totals), np.array(noises)


def test_a_swing_is_found_below_noise_of_many_sizes() -> None:
    ar, sigma, rms = common_process(*made_moments([0.3, 0.3, 3.0, 30.0], 6))
    roots = np.roots(np.concatenate([[1.0], -ar]))
    slow = roots[np.argmax(np.abs(roots))]
    true = np.roots(np.concatenate([[1.0], -SWING]))[0]
    assert abs(slow) == pytest.approx(abs(true), abs=0.05)
    assert abs(np.angle(slow)) == pytest.approx(abs(np.angle(true)), abs=0.05)
    assert sigma < 2.0
    assert rms == pytest.approx(
        lfilter([1.0], np.concatenate([[1.0], -SWING]), np.eye(1, 500)[0]).std() * 500**0.5, rel=0.3
    )


def test_noise_alone_leaves_no_process() -> None:
    totals, _ = made_moments([0.3], 7)
    ar, sigma, rms = common_process(totals, totals * 1.01)
    assert (ar == 0.0).all()
    assert sigma == rms == 0.0


def test_moments_that_no_process_has_are_made_those_of_one() -> None:
    ar, sigma, _ = common_process(toeplitz([1.0, 0.99, -0.9, 0.3])[None], np.zeros((1, 4, 4)))
    assert np.isfinite(ar).all()
    assert sigma > 0.0
    assert max(abs(np.roots(np.concatenate([[1.0], -ar])))) < 1.0


def test_runs_too_short_for_the_filter_leave_nothing() -> None:
    totals = lagged_products([np.ones(3)])
    assert (totals == 0.0).all()
    assert common_process(totals[None], totals[None])[1] == 0.0
