"""Simulated positions of the measured points, tracked in motion or measured at rest, on the last link only."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import PointTable
from diagnosis.replay.stretches import Stretch
from machine.poses import inverse_pose, transform_points
from machine.rotations import Array


@dataclass(frozen=True, slots=True)
class Places:
    """Points on the last link in the tcp's frame (points, 3) by name, and the tracker's place."""

    names: tuple[str, ...]
    p_tcp: Array
    T_base_tracker: Array


def places_of(nominal: Nominal, T_flange_tcp: Array) -> Places | None:
    """What the machine file knows of points; None where it does not say where tracker or points are."""
    known = [point for point in nominal.points if point.joint == nominal.n and point.xyz_m is not None]
    if nominal.T_base_tracker is None or not known:
        return None
    T_tcp_flange = inverse_pose(T_flange_tcp)
    flange = np.array([point.xyz_m for point in known], dtype=float)
    return Places(
        tuple(point.name for point in known),
        flange @ T_tcp_flange[:3, :3].T + T_tcp_flange[:3, 3],
        nominal.T_base_tracker,
    )


def measured_in_base(places: Places, table: PointTable, rows: NDArray[np.int64]) -> tuple[Array, Array]:
    """Points of some rows of a table in base (m, 3) [m] and in the tcp's frame (m, 3)."""
    T, which = places.T_base_tracker, [places.names.index(table.names[k]) for k in rows]
    return transform_points(T, table.xyz[rows]), places.p_tcp[which]


def rows_during(places: Places, table: PointTable, stretch: Stretch, skipped_s: float) -> NDArray[np.int64]:
    """Rows of a tracker's table within a stretch, its start left out."""
    inside = (table.t_s >= stretch.t_s[0] + skipped_s) & (table.t_s <= stretch.t_s[-1])
    named = np.array([name in places.names for name in table.names])
    return np.nonzero(inside & named & np.isfinite(table.xyz).all(axis=1))[0]


def rows_at_rest(places: Places, table: PointTable) -> NDArray[np.int64]:
    """Usable rows of a table of poses at rest."""
    named = np.array([name in places.names for name in table.names])
    seen = np.isfinite(table.xyz).all(axis=1)
    return np.nonzero(named & seen & (np.isfinite(table.q).all(axis=1) if table.q is not None else False))[0]


def simulated(Ts_base_tcp: Array, p_tcp: Array) -> Array:
    """Points (m, 3) [m] in base."""
    return np.einsum("mij,mj->mi", Ts_base_tcp[:, :3, :3], p_tcp) + Ts_base_tcp[:, :3, 3]
