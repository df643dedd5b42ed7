"""The noise floor: known autoregressions are found, white residuals are white, and the gap never leaks into it."""

import numpy as np
import pytest
from diagnosis_cases import NOISE_RAD, folder, recording

from diagnosis.errors import DiagnosisError
from diagnosis.noise.floor import (
    block_increments,
    block_means,
    fit_whitener,
    floor_of_repeats,
    floor_without_repeats,
)
from diagnosis.reading.read import read_for_diagnosis
from diagnosis.replay.repeats import laid_over, repeat_groups


def autoregression(rng: np.random.Generator, a: tuple[float, ...], sigma: float, m: int, n: int = 2) -> np.ndarray:
    x = np.zeros((m + 100, n))
    for k in range(len(a), m + 100):
        x[k] = sum(c * x[k - 1 - i] for i, c in enumerate(a)) + rng.normal(0.0, sigma, n)
    return x[100:]


def test_a_known_autoregression_is_found_and_whitened() -> None:
    rng = np.random.default_rng(1)
    runs = [autoregression(rng, (0.6, -0.3), 2e-4, 2000) for _ in range(4)]
    whitener = fit_whitener(runs)
    assert whitener.lag_count >= 2
    assert whitener.ar_coefficients[:2] == pytest.approx(np.array([[0.6, 0.6], [-0.3, -0.3]]), abs=0.05)
    assert whitener.innovation_sigma == pytest.approx([2e-4, 2e-4], rel=0.03)
    fresh = whitener.whiten(autoregression(rng, (0.6, -0.3), 2e-4, 2000))
    assert fresh.std(axis=0) == pytest.approx([1.0, 1.0], abs=0.06)
    assert abs(np.corrcoef(fresh[1:, 0], fresh[:-1, 0])[0, 1]) < 0.06


def test_white_increments_need_no_lags() -> None:
    rng = np.random.default_rng(2)
    assert fit_whitener([rng.normal(size=(1500, 3)) for _ in range(4)]).lag_count == 0


def test_floor_is_the_noise_and_not_what_all_repeats_share() -> None:
    rng = np.random.default_rng(3)
    shared = 5.0 * np.sin(np.arange(6000) * 0.01)[:, None]
    noise = rng.normal(0.0, 0.02, (4, 6000, 2))
    floor = floor_of_repeats(shared + noise, 0.01)
    assert floor.is_measured
    assert floor.deviation_rms == pytest.approx([0.02 / np.sqrt(5.0)] * 2, rel=0.05)
    assert floor.increment_rms == pytest.approx([0.02 * np.sqrt(2.0 / 5.0)] * 2, rel=0.05)
    assert floor_of_repeats(3.0 * shared + noise, 0.01).deviation_rms == pytest.approx(floor.deviation_rms)


def test_without_repeats_a_bound_stands_in_and_says_so() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(6000) * 0.01
    floor = floor_without_repeats(np.sin(t)[:, None] + rng.normal(0.0, 0.02, (6000, 1)), 0.01)
    assert not floor.is_measured
    assert 1.0 < floor.increment_rms[0] / (0.02 * np.sqrt(2.0 / 5.0)) < 1.5  # never too low


def test_blocks_are_means_over_fifty_milliseconds() -> None:
    x = np.arange(23.0)[:, None]
    assert block_means(x, 0.01)[:, 0] == pytest.approx([2.0, 7.0, 12.0, 17.0])
    assert block_increments(x, 0.01)[:, 0] == pytest.approx([5.0, 5.0, 5.0])
    assert np.array_equal(block_means(x, 0.2), x)


def test_the_floor_of_a_recording_is_its_encoder_noise(tmp_path) -> None:
    groups = repeat_groups(read_for_diagnosis(folder(tmp_path, recording(seed=5))).stretches)
    assert {name: len(members) for name, members in groups.items()} == {"A": 4}
    enc = laid_over(groups["A"], "enc")
    assert enc is not None
    assert enc.shape == (4, 1200, 6)
    assert floor_of_repeats(enc, 0.01).deviation_rms == pytest.approx(NOISE_RAD / np.sqrt(5.0), rel=0.15)


def test_bad_repeats_are_refused() -> None:
    with pytest.raises(DiagnosisError, match="R of 2 or more"):
        floor_of_repeats(np.zeros((1, 100, 2)), 0.01)
    with pytest.raises(DiagnosisError, match="s long"):
        floor_of_repeats(np.zeros((2, 50, 2)), 0.01)
    with pytest.raises(DiagnosisError, match="m above"):
        fit_whitener([np.random.default_rng(7).normal(size=(100, 2))]).whiten(np.zeros((0, 2)))
