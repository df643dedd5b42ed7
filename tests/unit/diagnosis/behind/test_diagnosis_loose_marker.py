"""A marker that moves by itself is told, and is no noise; what all markers do together is none of it."""

import numpy as np
import pytest

from diagnosis.behind.loose_marker import loose_marker

MARKERS, OWN_PX = 4, 0.1


def visits(
    rng: np.random.Generator, loose_px: float, common_px: float, marker: int = 2, looks: int = 8
) -> list[np.ndarray]:
    """Postures that were each seen twice."""
    out = []
    for _ in range(looks):
        view = rng.normal(0.0, OWN_PX, (2, 2, MARKERS, 4, 2)) + rng.normal(0.0, common_px, (2, 1, 1, 1, 2))
        view[:, :, marker] += rng.normal(0.0, loose_px, (2, 1, 1, 2))
        out.append(view.reshape(2, -1, 2))
    return out


@pytest.mark.parametrize("seed", range(5))
def test_the_loose_marker_is_told_with_how_far_it_goes(seed: int) -> None:
    found = loose_marker(visits(np.random.default_rng(seed), 3.0, 0.5), MARKERS)
    assert found is not None
    assert found.marker_index == 2
    assert found.own_px == pytest.approx(OWN_PX, rel=0.3)
    assert 1.0 < found.moved_px < 4.0
    assert "marker 7" in found.message(7)


@pytest.mark.parametrize("seed", range(5))
def test_noise_and_a_camera_that_moves_are_no_loose_marker(seed: int) -> None:
    assert loose_marker(visits(np.random.default_rng(seed), 0.0, 0.0), MARKERS) is None
    assert loose_marker(visits(np.random.default_rng(seed), 0.0, 20.0), MARKERS) is None
    assert loose_marker(visits(np.random.default_rng(seed), 0.15, 0.0), MARKERS) is None


def test_two_markers_or_one_look_tell_nothing() -> None:
    far = visits(np.random.default_rng(1), 30.0, 0.0)
    hidden = [view.reshape(2, 2, MARKERS, 4, 2).copy() for view in far]
    for view in hidden:
        view[:, :, :2] = np.nan
    assert loose_marker([view.reshape(2, -1, 2) for view in hidden], MARKERS) is None
    assert loose_marker([view[:1] for view in far], MARKERS) is None
    assert loose_marker([], MARKERS) is None
