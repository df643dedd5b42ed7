"""A tracker's frame and points' places are found at once, wherever the tracker stood."""

import numpy as np
import pytest

from diagnosis.behind.frame_fit import frame_and_places
from machine.poses import pose
from machine.rotations import rotation_about, rotation_from_rotvec

PLACES = np.array([[0.05, 0.12, 0.08], [-0.2, 0.1, 0.15]])
NOISE_M = 2e-4


@pytest.mark.parametrize("seed", range(12))
def test_a_crane_of_three_joints_in_any_frame_leaves_the_noise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, which = rng.uniform([-1.5, -0.2, -1.6], [1.5, 0.9, -0.4], (150, 3)), np.arange(150) % 2
    R = np.array([rotation_about("z", a) @ rotation_about("y", -b - c) for a, b, c in q])
    boom = np.array([rotation_about("z", a) @ rotation_about("y", -b) @ [2.6, 0.0, 0.0] for a, b, _ in q])
    d = boom + R @ np.array([2.0, 0.0, 0.0]) + [0.0, 0.0, 1.2]
    T = pose(rotation_from_rotvec(rng.normal(size=3) * 2.0), rng.normal(size=3) * 4.0)  # T_base_tracker
    p_base = np.einsum("mij,mj->mi", R, PLACES[which]) + d
    xyz = (p_base - T[:3, 3]) @ T[:3, :3] + rng.normal(0.0, NOISE_M, p_base.shape)
    found, places = frame_and_places(R, d, xyz, which, np.zeros((2, 3)), np.zeros(2, dtype=bool))
    left = xyz @ found[:3, :3].T + found[:3, 3] - d - np.einsum("mij,mj->mi", R, places[which])
    assert float(np.sqrt(np.mean(left**2))) < 1.05 * NOISE_M
    assert np.abs(places - PLACES).max() < 5e-4
    known = np.array([True, False])
    found, places = frame_and_places(R, d, xyz, which, np.array([PLACES[0], [0.0, 0.0, 0.0]]), known)
    assert found == pytest.approx(T, abs=1e-3)
    assert np.abs(places - PLACES).max() < 5e-4
