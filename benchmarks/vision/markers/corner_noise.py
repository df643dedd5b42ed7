"""Covariance of rendered corners as measured in a cell: two corners of a marker share an edge, so they err together."""

import numpy as np

from machine.rotations import Array

_CORNERS = 4


def edge_frames(exact: Array) -> Array:
    """Unit directions from each corner to the next and the one before, as columns: (..., 4, 2, 2) of (..., 4, 2) px."""
    onward = np.roll(exact, -1, axis=-2) - exact
    back = np.roll(exact, 1, axis=-2) - exact
    frames = np.stack([onward, back], axis=-1)
    return frames / np.linalg.norm(frames, axis=-2, keepdims=True)


def corner_covariances(errors: Array, exact: Array) -> Array:
    """Covariance of each look's corners (n, 16, 16) [px^2], both eyes, from errors and true corners (n, 2, 4, 2) [px].

    Errors are taken along the two edges that meet in a corner, where all looks, both eyes and the four turns of the
    marker are alike and can be pooled; the eyes' noise is independent.
    """
    frames = edge_frames(exact)
    along = np.linalg.solve(frames, errors[..., None])[..., 0]  # (n, 2, 4, 2)
    turned = np.concatenate([np.roll(along, k, axis=2) for k in range(_CORNERS)]).reshape(-1, 2 * _CORNERS)
    pooled = np.cov(turned, rowvar=False)
    n = len(errors)
    covariances = np.zeros((n, 16, 16))
    for eye in (0, 1):
        blocks = np.zeros((n, 8, 8))
        for k in range(_CORNERS):
            blocks[:, 2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = frames[:, eye, k]
        covariances[:, 8 * eye : 8 * eye + 8, 8 * eye : 8 * eye + 8] = blocks @ pooled @ blocks.transpose(0, 2, 1)
    return covariances
