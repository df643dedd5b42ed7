"""Noise of marker corners: each one's own and what a frame shares come apart again, and come out white together."""

import numpy as np
import pytest

from diagnosis.noise.of_corners import UNIT_CORNER_NOISE, CornerNoise, groups_of, noise_of_visits, variances_of
from machine.remainder import Remainder

FRAMES, CORNERS = 400, 12


def made(own: tuple[float, float], shared: tuple[float, float], seed: int = 3) -> np.ndarray:
    """Corners (frames, corners, 2) [px] with both kinds of noise, a tenth of them unseen."""
    rng = np.random.default_rng(seed)
    pixels = rng.normal(0.0, own, (FRAMES, CORNERS, 2)) + rng.normal(0.0, shared, (FRAMES, 1, 2))
    pixels[rng.uniform(size=(FRAMES, CORNERS)) < 0.1] = np.nan
    return pixels


def test_a_shared_shift_comes_out_white() -> None:
    pixels = made((0.2, 0.1), (0.5, 0.05))
    seen, groups = np.isfinite(pixels), groups_of(pixels)
    noise = CornerNoise(np.array([0.2, 0.1]), np.array([0.5, 0.05]))
    white = noise.whiten(pixels[seen][None], groups)[0]
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.03)
    sums = np.bincount(groups, weights=white) / np.sqrt(np.bincount(groups))
    assert np.var(sums) == pytest.approx(1.0, abs=0.15)  # a frame speaks with the weight of one frame
    assert np.var(np.bincount(groups, weights=pixels[seen]) / np.sqrt(np.bincount(groups))) < 10.0


def test_without_a_shared_part_nothing_is_taken_away() -> None:
    pixels = made((0.2, 0.1), (0.5, 0.05))
    seen, groups = np.isfinite(pixels), groups_of(pixels)
    np.testing.assert_array_equal(UNIT_CORNER_NOISE.whiten(pixels[seen][None], groups)[0], pixels[seen])


def test_visits_tell_both_kinds() -> None:
    """Twenty views seen twenty times each, every view at places of its own."""
    rng = np.random.default_rng(5)
    visits = [
        rng.uniform(0.0, 700.0, (1, CORNERS, 2))
        + rng.normal(0.0, (0.2, 0.1), (20, CORNERS, 2))
        + rng.normal(0.0, (0.5, 0.05), (20, 1, 2))
        for _ in range(20)
    ]
    found = noise_of_visits(visits, 20)
    assert found is not None
    np.testing.assert_allclose(found.corner_sigma_px, [0.2, 0.1], rtol=0.03)
    np.testing.assert_allclose(found.frame_shared_sigma_px, [0.5, 0.05], rtol=0.12)
    assert noise_of_visits([view[:1] for view in visits], 20) is None  # nothing was seen again


def test_each_corners_variance_and_the_shared_one() -> None:
    pixels = made((0.5, 0.1), (0.5, 0.3))
    own, shared = variances_of(pixels[np.isfinite(pixels)], groups_of(pixels))
    np.testing.assert_allclose(np.sqrt(own), [0.5, 0.1], rtol=0.03)
    np.testing.assert_allclose(np.sqrt(shared), [0.5, 0.3], rtol=0.1)


def test_a_machine_files_remainder_raises_both() -> None:
    record = Remainder("camera", None, "ooi", 0.3, 0.5, by_axis=(0.4, 0.0))
    raised = CornerNoise(np.array([0.4, 0.4]), np.array([0.3, 0.1])).with_remainder(record)
    np.testing.assert_allclose(raised.corner_sigma_px, [0.5, 0.5])
    np.testing.assert_allclose(raised.frame_shared_sigma_px, [0.5, 0.1])
