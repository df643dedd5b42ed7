"""Measured points against the arm: poses at rest and tracked motion, in a frame and at places that may be unknown."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.behind.frame_fit import frame_and_places
from diagnosis.errors import DiagnosisError
from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import PointTable
from diagnosis.replay.stretches import Stretch
from machine.effects.encoders import true_angles
from machine.effects.layout import ParameterSets
from machine.effects.structure import link_poses
from machine.poses import pose, transform_points
from machine.rotations import Array

POINT_ROWS_MIN = 6  # of points, for a cell of them


@dataclass(frozen=True, slots=True)
class PointData:
    """Measured points with the encoders' angles: q (m, n), `point_index` (m,), xyz (m, 3), `time_or_pose_index` (m,)
    [s on the PLC's clock, or pose index].
    """

    q: Array
    point_index: NDArray[np.int64]
    xyz: Array
    time_or_pose_index: Array


@dataclass(frozen=True, slots=True)
class PointFit:
    """Residual (m, 3) [m] in base axes, measured less modelled; the tracker's frame and the points' places used."""

    residual_m: Array
    T_base_tracker: Array
    positions_in_link_m: Array


def static_data(nominal: Nominal, table: PointTable) -> PointData | None:
    """Usable rows of static.csv; None without any."""
    if table.q is None:
        return None
    return _usable_point_data(nominal, table, table.q)


def tracked_data(nominal: Nominal, table: PointTable, stretches: tuple[Stretch, ...]) -> PointData | None:
    """Usable rows of tracker.csv with the encoders' angles of the same time; None without any."""
    return _usable_point_data(nominal, table, tracked_angles(nominal, table, stretches))


def tracked_angles(nominal: Nominal, table: PointTable, stretches: tuple[Stretch, ...]) -> Array:
    """The encoders' angles (m, n) when each point was measured; NaN where they were not logged."""
    q = np.full((len(table.t_s), nominal.n), np.nan)
    for stretch in stretches:
        if stretch.enc is None:
            continue
        inside = (table.t_s >= stretch.t_s[0]) & (table.t_s <= stretch.t_s[-1])
        q[inside] = np.stack([np.interp(table.t_s[inside], stretch.t_s, column) for column in stretch.enc.T], axis=1)
    return q


def _usable_point_data(nominal: Nominal, table: PointTable, q: Array) -> PointData | None:
    which = _point_indices(nominal, table)
    good = usable_rows(nominal, table, q)
    return PointData(q[good], which[good], table.xyz[good], table.t_s[good]) if good.any() else None


def usable_rows(nominal: Nominal, table: PointTable, q: Array) -> NDArray[np.bool_]:
    """Rows (m,) of a point that the machine file knows, with all their numbers, said once."""
    good = (_point_indices(nominal, table) >= 0) & np.isfinite(q).all(axis=1) & np.isfinite(table.xyz).all(axis=1)
    return good & _first_of_each(table.t_s, table.xyz)


def _point_indices(nominal: Nominal, table: PointTable) -> NDArray[np.int64]:
    index = {point.name: k for k, point in enumerate(nominal.tracked_points)}
    return np.array([index.get(name, -1) for name in table.point_names], dtype=np.int64)


def _first_of_each(when: Array, xyz: Array) -> NDArray[np.bool_]:
    """Rows (m,) whose numbers no row before them has at the same instant: two points are never in one place."""
    first = np.zeros(len(when), dtype=bool)
    first[np.unique(np.column_stack([when, xyz]), axis=0, return_index=True)[1]] = True
    return first


def fit_points(nominal: Nominal, sets: ParameterSets, data: PointData, set_number: int = 0) -> PointFit:
    """Residual of measured points under one parameter set.

    Model:   p_base = T_base_link(q) x_point; measured p_tracker. A frame and places that the machine file does not give
             are found by least squares (`behind/frame_fit.py`): they take up what they can of any effect.
    Raises:  DiagnosisError: no arm, or too few points for an unknown frame.
    """
    T_base_link = _link_poses_of_points(nominal, sets, data, set_number)
    known = np.array([point.xyz_m is not None for point in nominal.tracked_points])
    places = np.array([point.xyz_m or (0.0, 0.0, 0.0) for point in nominal.tracked_points])
    T = nominal.T_base_tracker
    if T is None:
        if len(data.xyz) < 4:
            raise DiagnosisError(f"{len(data.xyz)} measured points and no T_base_tracker; give 4 or more, or the frame")
        T, places = frame_and_places(
            T_base_link[:, :3, :3], T_base_link[:, :3, 3], data.xyz, data.point_index, places, known
        )
    measured = transform_points(T, data.xyz)
    if nominal.T_base_tracker is not None:
        places = _points_on_links(T_base_link, measured, data.point_index, places, known)
    return PointFit(measured - _transform_points(T_base_link, places[data.point_index]), T, places)


def modelled_points(nominal: Nominal, sets: ParameterSets, data: PointData, places: Array) -> Array:
    """Where the model puts points (m, 3) [m, base axes] at the first of the sets, by their places (k, 3) on links."""
    return _transform_points(_link_poses_of_points(nominal, sets, data, 0), places[data.point_index])


def _link_poses_of_points(nominal: Nominal, sets: ParameterSets, data: PointData, set_number: int) -> Array:
    """T_base_link (m, 4, 4) of the link that each point is on."""
    if nominal.arm is None:
        raise DiagnosisError(f"points need the arm's geometry; {nominal.why_absent('structure')}")
    links = link_poses(nominal.arm, sets, true_angles(sets, data.q, set_number), set_number)
    joints = np.array([point.joint for point in nominal.tracked_points])[data.point_index]
    return links[np.arange(len(links)), joints]


def _transform_points(T_base_link: Array, on_link: Array) -> Array:
    return np.einsum("mij,mj->mi", T_base_link[:, :3, :3], on_link) + T_base_link[:, :3, 3]


def numbers_fitted(nominal: Nominal, data: PointData) -> int:
    """How many numbers `fit_points` takes from the data: an unknown frame's six, three a point of unknown place."""
    places = sum(3 for k in np.unique(data.point_index) if nominal.tracked_points[k].xyz_m is None)
    return places + (0 if nominal.T_base_tracker is not None else 6)


def _points_on_links(
    T_base_link: Array, measured: Array, which: NDArray[np.int64], places: Array, known: NDArray[np.bool_]
) -> Array:
    """Places of the points on their links, the unknown ones by their mean over all samples."""
    on_link = np.einsum("mji,mj->mi", T_base_link[:, :3, :3], measured - T_base_link[:, :3, 3])
    out = places.copy()
    for k in np.nonzero(~known)[0]:
        if (which == k).any():
            out[k] = on_link[which == k].mean(axis=0)
    return out


def rigid_fit(points_a: Array, points_b: Array) -> Array:
    """T_b_a (4, 4) that brings points_a (m, 3) onto points_b (m, 3) in least squares (Kabsch 1976)."""
    mean_a, mean_b = points_a.mean(axis=0), points_b.mean(axis=0)
    u, _, vt = np.linalg.svd((points_a - mean_a).T @ (points_b - mean_b))
    R = vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    return pose(R, mean_b - R @ mean_a)


def rms_m(off: Array) -> float:
    """Root mean square length of (m, 3) [m]."""
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
