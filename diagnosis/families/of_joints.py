"""Families of one joint's angle, with the same numbers in all that was measured behind it.

Why together: what makes an angle wrong is seen alike by a tracker and by a camera. What they see of different signs is
no fault of a joint, and what both see a little of is worth more than either says.
"""

import numpy as np
from numpy.typing import NDArray

from diagnosis.behind.corner_residual import CornerResidual
from diagnosis.behind.link_angles import Path, followed
from diagnosis.behind.point_residual import PointResidual
from diagnosis.families.behind import swing_columns
from diagnosis.families.ways import last_way
from diagnosis.search.cell import Cell
from machine.effects.layout import ParameterSets
from machine.rotations import Array

WAY_OF = "which way joint"  # ... last went: play, a brake that drags, a spring that has to be turned round
SWING_OF = "a swing of joint"
OF_JOINTS = (WAY_OF, SWING_OF)
WIDTH_RAD = 3e-4  # 1.5 mm of the tip of a boom of 5 m
Moving = PointResidual | CornerResidual


def way_of(joint: int) -> str:
    """The name of a joint's (0-based) family."""
    return f"{WAY_OF} {joint + 1} last went"


def swing_of(joint: int) -> str:
    """The name of a joint's (0-based) family."""
    return f"{SWING_OF} {joint + 1}"


def columns_of_joints(cell: Cell) -> tuple[Cell, dict[str, Array]]:
    """The first part that moves, and (N, k) by what they are functions of, white as the cell's residual, zero where a
    part shows nothing of it. Empty where nothing that moves was measured behind the joints.
    """
    moving = {k: seen for k, part in enumerate(cell.parts or (cell,)) if (seen := _moving(part)) is not None}
    if not moving:
        return cell, {}
    parts, out = cell.parts or (cell,), {}
    seen = any(isinstance(one, CornerResidual) for one in moving.values())  # tracked points alone: `swing_columns`
    ways = {k: _way_columns(one, parts[k].base) for k, one in moving.items()}
    for joint in range(cell.base.joint.shape[1]):
        out[way_of(joint)] = _end_to_end(parts, {k: columns[joint] for k, columns in ways.items()})
    swings = {k: swing_columns(one, parts[k].base) for k, one in moving.items()} if seen else {}
    for number, name in enumerate(next(iter(swings.values()), {})):
        out[swing_of(number)] = _end_to_end(parts, {k: columns[name] for k, columns in swings.items()})
    return parts[next(iter(moving))], out


def _moving(part: Cell) -> Moving | None:
    seen = part.whitened
    if isinstance(seen, CornerResidual):
        return seen if seen.on == "ooi" and seen.nominal.camera is not None and followed(seen.paths) else None
    return seen if isinstance(seen, PointResidual) and followed(seen.paths) else None


def _way_columns(seen: Moving, base: ParameterSets) -> Array:
    """For each joint (n, N, 1), white as the part's residual."""
    moved = seen.moved_by_each(base)
    if isinstance(seen, PointResidual):
        columns = moved * _ways(seen.paths, seen.at, seen.data.when)[:, :, None]
        return seen.noise.white(columns.reshape(len(columns), -1))[:, :, None]
    columns = moved * _ways(seen.paths, seen.at, seen.frames.t_s)[:, seen.frames.frame_of_each]
    return seen.placeless(columns.T).T[:, :, None]


def _ways(paths: tuple[Path, ...], at: NDArray[np.int64], t_s: Array) -> Array:
    """Which way each joint last went (n, m), at times (m,) in paths `at` (m,)."""
    out = np.zeros((paths[0].enc.shape[1], len(t_s)))
    for k in np.unique(at):
        rows, path = at == k, paths[k]
        for joint, angles in enumerate(path.enc.T):
            out[joint, rows] = np.interp(t_s[rows], path.t_s, last_way(angles, WIDTH_RAD))
    return out


def _end_to_end(parts: tuple[Cell, ...], blocks: dict[int, Array]) -> Array:
    width = next(iter(blocks.values())).shape[1]
    return np.concatenate([blocks.get(k, np.zeros((part.rows.count, width))) for k, part in enumerate(parts)])
