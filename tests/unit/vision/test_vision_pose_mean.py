"""The mean of a look's poses: its covariance against many draws, and what may go wrong with the pairs."""

import numpy as np
import pytest
from vision_scenes import deviation, facing_pose

from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from server.vision.ambiguity import mirrored_pose
from server.vision.look import pose_mean, white_eigenvalue_max

TRUE = facing_pose(1.0, 15.0, 30.0, (0.1, 0.05))
ROOT = np.diag([3e-3, 3e-3, 1e-3, 2e-4, 2e-4, 1e-3])
ROOT[4, 0] = 1e-4
COVARIANCE = ROOT @ ROOT.T
N = 20


def poses(rng, rho=0.0, scale=1.0):
    noise = rng.normal(size=(N, 6))
    for k in range(1, N):
        noise[k] = rho * noise[k - 1] + np.sqrt(1.0 - rho**2) * noise[k]
    moves = scale * noise @ ROOT.T
    return np.array([pose(rotation_from_rotvec(m[:3]) @ TRUE[:3, :3], TRUE[:3, 3] + m[3:]) for m in moves])


def share_inside(spoil=lambda Ts, rng: None, **more) -> float:
    rng, inside = np.random.default_rng(3), 0
    for _ in range(150):
        Ts = poses(rng, **more)
        spoil(Ts, rng)
        mean = pose_mean(Ts, np.repeat(COVARIANCE[None], N, axis=0))
        error = deviation(mean.T_mean, TRUE)
        inside += error @ np.linalg.solve(mean.covariance, error) < 12.59
    return inside / 150


def outliers(Ts, rng):
    for k in rng.permutation(N)[:4]:
        Ts[k, :3, 3] += rng.normal(0.0, 0.02, 3)
        Ts[k, :3, :3] = rotation_from_rotvec(rng.normal(0.0, 0.05, 3)) @ Ts[k, :3, :3]


def flips(Ts, rng):
    for k in rng.permutation(N)[:3]:
        Ts[k] = mirrored_pose(Ts[k], np.zeros((1, 3)), np.array([0.06]))


@pytest.mark.parametrize(
    ("spoil", "more"),
    [
        (lambda Ts, rng: None, {}),
        (lambda Ts, rng: None, {"scale": 2.0}),
        (lambda Ts, rng: None, {"rho": 0.7}),
        (lambda Ts, rng: None, {"rho": np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.95])}),
        (lambda Ts, rng: None, {"rho": np.array([0.0, 0.8, 0.0, 0.0, 0.0, 0.8])}),
        (outliers, {}),
        (flips, {}),
    ],
    ids=[
        "as predicted",
        "twice the noise",
        "slow noise",
        "one axis drifts",
        "two axes drift",
        "20 % outliers",
        "flips",
    ],
)
def test_ellipsoids_of_the_mean_are_honest(spoil, more):
    assert 0.89 < share_inside(spoil, **more) <= 0.99


def test_outliers_and_flips_are_cut():
    rng = np.random.default_rng(1)
    for spoil in (outliers, flips):
        Ts = poses(rng)
        before = Ts.copy()
        spoil(Ts, rng)
        wrong = np.abs(Ts - before).max(axis=(1, 2)) > 0.0
        kept = pose_mean(Ts, np.repeat(COVARIANCE[None], N, axis=0)).inliers
        assert not (kept & wrong).any()
        assert kept.sum() >= N - wrong.sum() - 1


def test_slow_noise_counts_for_fewer_pairs():
    rng = np.random.default_rng(2)
    covariances = np.repeat(COVARIANCE[None], N, axis=0)
    quick = np.median([np.trace(pose_mean(poses(rng), covariances).covariance) for _ in range(30)])
    slow = np.median([np.trace(pose_mean(poses(rng, rho=0.8), covariances).covariance) for _ in range(30)])
    assert slow > 3.0 * quick


def test_limit_of_white_scatter():
    rng = np.random.default_rng(4)
    largest = [np.linalg.eigvalsh(x.T @ x / 19)[-1] for x in rng.normal(size=(800, 19, 6))]
    assert white_eigenvalue_max(19) == pytest.approx(np.quantile(largest, 0.99), rel=0.06)
