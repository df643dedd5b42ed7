"""Errors of poses against the truth, split as the table shows them: tilt, lateral, depth."""

from dataclasses import dataclass

import numpy as np

from machine.rotations import Array, rotvec_from_rotation


@dataclass(frozen=True, slots=True)
class SplitErrors:
    """Of n looks: tilt (n, 2) [rad], roll (n,) [rad], lateral (n, 2) [m], depth (n,) [m]."""

    tilt: Array
    roll: Array
    lateral: Array
    depth: Array


def deviations(Ts: Array, truths: Array) -> Array:
    """(n, 6): rotation vector by left perturbation [rad], translation [m]."""
    turns = np.array(
        [rotvec_from_rotation(T[:3, :3] @ true[:3, :3].T) for T, true in zip(Ts, truths, strict=True)]
    ).reshape(-1, 3)
    return np.concatenate([turns, Ts[:, :3, 3] - truths[:, :3, 3]], axis=1)


def split_axes(truths: Array) -> Array:
    """(n, 6, 6): rows are tilt x 2 (in the marker's plane), roll, lateral x 2 (across the line of sight), depth."""
    axes = np.zeros((len(truths), 6, 6))
    axes[:, :3, :3] = np.swapaxes(truths[:, :3, :3], 1, 2)
    for row, T in zip(axes, truths, strict=True):
        sight = T[:3, 3] / np.linalg.norm(T[:3, 3])
        first = np.cross(sight, [0.0, 1.0, 0.0])
        first /= np.linalg.norm(first)
        row[3:, 3:] = np.stack([first, np.cross(sight, first), sight])
    return axes


def split(errors: Array, truths: Array) -> Array:
    """Deviations (n, 6) along `split_axes`."""
    return np.einsum("nij,nj->ni", split_axes(truths), errors)


def split_covariances(covariances: Array, truths: Array) -> Array:
    """Covariances (n, 6, 6) in `split_axes`."""
    axes = split_axes(truths)
    return axes @ covariances @ np.swapaxes(axes, 1, 2)
