"""What a hand-eye calibration leaves, pose by pose: residuals, outliers, and poses too alike to add anything."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from server.calibration.contracts import Array
from server.calibration.hand_eye_linear import inverse_poses, rotation_vectors

OUTLIER_SIGMAS = 4.0
ALIKE_RAD = float(np.deg2rad(3.0))
ALIKE_M = 0.02


@dataclass(frozen=True, slots=True)
class PoseResiduals:
    """Of every pose (n,): how far the target is turned [deg] and lies [mm, in the camera] from where it should be."""

    rotation_deg: Array
    translation_mm: Array
    outliers: NDArray[np.bool_]


def pose_residuals(As: Array, Bs: Array, X: Array, Y: Array) -> PoseResiduals:
    """What A X = Y B leaves. Outliers lie beyond four robust sigmas of the rest, in turn or in place.

    Args: As: base from hand, Bs: target from camera (n, 4, 4); X: hand from camera, Y: base from target (4, 4).
    """
    predicted = inverse_poses(As @ X) @ Y
    seen = inverse_poses(Bs)
    turns = np.rad2deg(np.linalg.norm(rotation_vectors(inverse_poses(predicted)[:, :3, :3] @ seen[:, :3, :3]), axis=1))
    misses = 1e3 * np.linalg.norm(predicted[:, :3, 3] - seen[:, :3, 3], axis=1)
    return PoseResiduals(turns, misses, _outlying(turns) | _outlying(misses))


def _outlying(sizes: Array) -> NDArray[np.bool_]:
    """Sizes (norms of three components) beyond so many sigmas of a component, robustly."""
    sigma = float(np.median(sizes)) / 1.5382  # median of a norm of three normal components
    return np.asarray(sizes > (OUTLIER_SIGMAS + 1.0) * max(sigma, 1e-9))


def alike_poses(As: Array) -> list[tuple[int, int]]:
    """Pairs of poses (first the earlier one) turned by less than 3 deg and moved by less than 20 mm: one of them is
    enough. Every pose is named with the first one that it is alike.
    """
    pairs = []
    for k in range(1, len(As)):
        turns = np.linalg.norm(rotation_vectors(np.swapaxes(As[:k, :3, :3], 1, 2) @ As[k, :3, :3]), axis=1)
        moved = np.linalg.norm(As[:k, :3, 3] - As[k, :3, 3], axis=1)
        near = np.nonzero((turns < ALIKE_RAD) & (moved < ALIKE_M))[0]
        if len(near):
            pairs.append((int(near[0]), k))
    return pairs
