"""Where the taught layout's origin lies, and what that makes of the covariances."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from machine.markers import CORNER_SIGNS
from machine.poses import inverse_pose, pose, transform_points
from machine.rotations import nearest_rotation, rotvec_from_rotation
from server.vision.contracts import Array
from server.vision.teach_fit import LayoutState, moved

FrameName = Literal["present", "reference", "middle"]
STEP = 1e-6  # of a numeric derivative, rad and m
FLAT_FRAC = 0.2  # of the widest extent: centres that spread less across lie on a line


@dataclass(frozen=True, slots=True)
class LayoutFrame:
    """Where the object's origin shall lie.

    "present": where the present layout fits the new one best. "reference": the reference marker keeps its present pose
    (identity where it has none). "middle": the mean of the markers' centres, z square to their plane, x along the
    reference marker's x axis. `present`: T_on_marker and side [m] by id.
    """

    name: FrameName
    present: Mapping[int, tuple[Array, float]]


def place_layout(state: LayoutState, ids: Sequence[int], frame: LayoutFrame, reference: int) -> Array:
    """T_on_marker (m, 4, 4) in the wanted frame."""
    if frame.name == "middle":
        T_on_ref = _from_middle(state, reference)
    elif frame.name == "present" and any(marker_id in frame.present for marker_id in ids):
        T_on_ref = _best_fit(state, ids, frame.present)
    else:
        T_on_ref = frame.present.get(ids[reference], (np.eye(4), 0.0))[0]
    return T_on_ref @ state.Ts_ref_marker


def placed_covariances(
    state: LayoutState, covariance: Array, ids: Sequence[int], frame: LayoutFrame, reference: int
) -> Array:
    """Covariances (m, 6, 6) of T_on_marker in the wanted frame, by central differences through the frame's choice.

    Args: covariance (7 m + 1, 7 m + 1) of markers (T_ref_marker by left perturbation, side) and baseline.
    """
    rows = np.flatnonzero(np.diag(covariance) > 0.0)
    J = np.zeros((len(ids), 6, len(rows)))
    for column, row in enumerate(rows):
        step = np.zeros(len(covariance))
        step[row] = STEP
        plus = place_layout(moved(state, step), ids, frame, reference)
        minus = place_layout(moved(state, -step), ids, frame, reference)
        for k in range(len(ids)):
            turn = rotvec_from_rotation(plus[k, :3, :3] @ minus[k, :3, :3].T)
            J[k, :, column] = np.concatenate([turn, plus[k, :3, 3] - minus[k, :3, 3]]) / (2.0 * STEP)
    found = J @ covariance[np.ix_(rows, rows)] @ J.transpose(0, 2, 1)
    return 0.5 * (found + found.transpose(0, 2, 1))


def _best_fit(state: LayoutState, ids: Sequence[int], present: Mapping[int, tuple[Array, float]]) -> Array:
    """T_on_ref that lays the new corners onto the present ones (Kabsch 1976)."""
    new, old = [], []
    for k, marker_id in enumerate(ids):
        if marker_id in present:
            T_on_marker, side_m = present[marker_id]
            new.append(transform_points(state.Ts_ref_marker[k], 0.5 * state.sides_m[k] * CORNER_SIGNS))
            old.append(transform_points(T_on_marker, 0.5 * side_m * CORNER_SIGNS))
    source, target = np.concatenate(new), np.concatenate(old)
    middle, aim = source.mean(axis=0), target.mean(axis=0)
    rotation = nearest_rotation((target - aim).T @ (source - middle))
    return pose(rotation, aim - rotation @ middle)


def _from_middle(state: LayoutState, reference: int) -> Array:
    centres = state.Ts_ref_marker[:, :3, 3]
    middle = centres.mean(axis=0)
    z = state.Ts_ref_marker[:, :3, 2].mean(axis=0)
    _, extents, axes = np.linalg.svd(centres - middle, full_matrices=False)
    if len(centres) >= 3 and extents[1] > FLAT_FRAC * extents[0]:
        z = axes[2] * np.sign(axes[2] @ z)
    z = z / np.linalg.norm(z)
    x = state.Ts_ref_marker[reference, :3, 0]
    x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    return inverse_pose(pose(np.column_stack([x, np.cross(z, x), z]), middle))
