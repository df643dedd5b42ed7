"""Poses for a hand-eye calibration from tables: t or name, x, y, z, qx, qy, qz, qw, or 16 numbers row by row."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machine.rotations import Array, rotation_from_quat_wxyz
from recording.files import read_text
from server.errors import ServerError

QUATERNION_OFF_MAX = 1e-2


class HandEyeError(ServerError):
    """Poses or options that a hand-eye calibration cannot use."""


@dataclass(frozen=True, slots=True)
class PoseTable:
    """Rows of a table: labels as written, times (n,) [s] or None where labels are not times, poses (n, 4, 4) [m]."""

    labels: tuple[str, ...]
    t_s: Array | None
    Ts: Array


def read_poses(path: Path) -> PoseTable:
    """The poses of a CSV file; a first row of names is passed over.

    Raises: HandEyeError: not readable, or a row that is not a pose; names file and line.
    """
    try:
        lines = read_text(path).splitlines()
    except OSError as error:
        raise HandEyeError(f"{path} cannot be read: {error.strerror}") from error
    labels, Ts = [], []
    for number, row in enumerate(csv.reader(line.replace(";", ",").replace("\t", ",") for line in lines), start=1):
        cells = [cell.strip() for cell in row if cell.strip()]
        if not cells or cells[0].startswith("#"):
            continue
        values = _numbers(cells[1:])
        if values is None and not labels:
            continue
        if values is None or len(values) not in (7, 16):
            raise HandEyeError(
                f"{path}, line {number}: {len(cells)} cells; give a time or name, x, y, z [m], qx, qy, qz, qw, or 16 "
                "numbers of the pose row by row"
            )
        labels.append(cells[0])
        Ts.append(_pose(values, f"{path}, line {number}"))
    if not labels:
        raise HandEyeError(f"{path} holds no poses; give rows of a time or name, x, y, z [m], qx, qy, qz, qw")
    times = _numbers(labels)
    return PoseTable(tuple(labels), None if times is None else np.array(times), np.array(Ts))


def _numbers(cells: list[str]) -> list[float] | None:
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        return None


def _pose(values: list[float], where: str) -> Array:
    if len(values) == 16:
        T = np.array(values).reshape(4, 4)
        if np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > QUATERNION_OFF_MAX or np.abs(T[3, :3]).max() > 0.0:
            raise HandEyeError(f"{where}: no pose; write it row by row, a rotation and metres, the last row 0, 0, 0, 1")
        return T
    x, y, z, qx, qy, qz, qw = values
    length = float(np.sqrt(qx**2 + qy**2 + qz**2 + qw**2))
    if abs(length - 1.0) > QUATERNION_OFF_MAX:
        raise HandEyeError(f"{where}: the quaternion's length is {length:.4f}, not 1; the order is qx, qy, qz, qw")
    T = np.eye(4)
    T[:3, :3] = rotation_from_quat_wxyz(np.array([qw, qx, qy, qz]) / length)
    T[:3, 3] = x, y, z
    return T


def paired(hand: PoseTable, camera: PoseTable) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Rows of equal labels in both tables, in the camera's order; None where they are streams with clocks of their own.

    A hand's label may be a picture's file name.
    """
    place = {label if label in camera.labels else Path(label).stem: k for k, label in enumerate(hand.labels)}
    both = [(place[label], k) for k, label in enumerate(camera.labels) if label in place]
    if not place or len(both) < max(3, len(camera.labels) // 2) or len(place) < len(hand.labels):
        return None
    rows = np.array(both)
    return rows[:, 0], rows[:, 1]
