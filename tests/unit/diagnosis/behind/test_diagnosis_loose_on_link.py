"""A point that does not keep its distances to the others on its link: no repeat is needed to tell it."""

import numpy as np
import pytest

from diagnosis.behind.loose_point import off_its_link

POSES, NAMES, JOINTS = 40, ("a", "b", "c", "elbow"), (6, 6, 6, 3)
PLACES = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.05], [0.1, 0.15, 0.0], [0.0, 0.0, 0.0]])


def told(slipped_m: float, loose: int = 1, points: tuple[int, ...] = (0, 1, 2, 3), noise_m: float = 3e-4) -> str:
    rng = np.random.default_rng(2)
    turned = np.linalg.qr(rng.normal(size=(POSES, 3, 3)))[0]
    xyz = np.einsum("kij,pj->kpi", turned, PLACES) + rng.uniform(-2.0, 2.0, (POSES, 1, 3))
    xyz[POSES // 2 :, loose] += turned[POSES // 2 :] @ np.array([slipped_m, 0.0, 0.0])
    xyz += rng.normal(0.0, noise_m, xyz.shape)
    which = np.tile(points, POSES)
    return off_its_link(xyz[:, points].reshape(-1, 3), which, np.repeat(np.arange(POSES), len(points)), JOINTS, NAMES)


def test_a_marker_that_slipped_once_is_told() -> None:
    assert "point 'b', whose distances to the others on its link vary" in told(0.015)


@pytest.mark.parametrize("slipped_m", [0.0, 1e-3])
def test_what_is_within_five_times_the_others_scatter_is_not(slipped_m: float) -> None:
    assert told(slipped_m) == ""


def test_of_two_points_nobody_knows_which() -> None:
    assert told(0.015, points=(0, 1, 3)) == ""


def test_a_link_with_one_point_says_nothing() -> None:
    assert told(0.015, loose=3) == ""
