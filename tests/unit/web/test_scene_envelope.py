"""The lines about the machine's reach."""

import numpy as np

from machine.chain import chain_of
from machine.kinematics import tcp_pose
from server.settings import read_machine
from web.scene import reach_segments, slew_limits

CHAIN = chain_of(read_machine("hiab033"))


def test_random_poses_of_the_outstretched_machine_lie_inside_the_circle():
    rim = float(np.linalg.norm(slew_limits(CHAIN)[0, 1, :2]))
    rng = np.random.default_rng(5)
    middle = 0.5 * (CHAIN.q_min + CHAIN.q_max)
    for _ in range(50):
        q = middle.copy()
        q[:3] = rng.uniform(CHAIN.q_min[:3], CHAIN.q_max[:3])
        assert np.linalg.norm(tcp_pose(CHAIN, q)[:2, 3]) <= rim + 0.05


def test_segments_are_finite_and_joined():
    segments = reach_segments(CHAIN)
    assert segments.shape[1:] == (2, 3)
    assert np.isfinite(segments).all()
    assert np.allclose(segments[:30, 1], segments[1:31, 0])


def test_the_slew_ends_are_at_the_joints_limits():
    ends = slew_limits(CHAIN)[:, 1]
    angles = np.arctan2(ends[:, 1], ends[:, 0])
    wanted = np.array([CHAIN.q_min[0], CHAIN.q_max[0]])
    assert np.allclose(np.exp(1j * angles), np.exp(1j * wanted))
