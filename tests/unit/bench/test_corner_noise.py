"""The marker bench's yardstick for rendered images: the covariance of corners that share edges is found again."""

import numpy as np

from benchmarks.vision.markers.corner_noise import corner_covariances, edge_frames

SQUARE_PX = np.array([[0.0, 0.0], [50.0, 0.0], [50.0, 50.0], [0.0, 50.0]])


def _looks(n: int, rng: np.random.Generator) -> np.ndarray:
    """n squares turned anyhow in both eyes: (n, 2, 4, 2) px."""
    angle = rng.uniform(0.0, 2.0 * np.pi, n)
    turns = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]).transpose(2, 0, 1)
    return np.repeat((SQUARE_PX @ turns.transpose(0, 2, 1))[:, None], 2, axis=1)


def test_edges_of_a_square_are_at_right_angles() -> None:
    frames = edge_frames(SQUARE_PX)
    assert np.allclose(frames.transpose(0, 2, 1) @ frames, np.eye(2), atol=1e-12)


def test_errors_of_shared_edges_are_correlated_as_made() -> None:
    """Each edge moves sideways by its own noise: a corner errs by both of its edges, neighbours share one."""
    rng = np.random.default_rng(4)
    exact = _looks(4000, rng)
    sideways = rng.normal(0.0, 0.1, (4000, 2, 4))  # of edge k, from corner k to k + 1, along the one before
    frames = edge_frames(exact)
    errors = np.empty_like(exact)
    for k in range(4):
        along_back, along_onward = sideways[:, :, k], -sideways[:, :, k - 1]
        errors[:, :, k] = (
            frames[:, :, k, :, 1] * along_back[..., None] + frames[:, :, k, :, 0] * along_onward[..., None]
        )

    found = corner_covariances(errors, exact)[0]

    one = errors.reshape(4000, 16)
    upright = np.allclose(found, found.T, atol=1e-12)
    assert upright
    assert np.allclose(found[:8, 8:], 0.0)  # the eyes are independent
    assert abs(np.trace(found) - np.mean(np.sum(one**2, axis=1))) < 0.02 * np.trace(found)
    share = frames[0, 0, 0, :, 1] @ found[0:2, 2:4] @ -frames[0, 0, 1, :, 0]
    assert abs(abs(share) - 0.01) < 0.001  # variance of the edge that corners 0 and 1 share
