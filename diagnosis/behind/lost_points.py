"""Rows of a tracker that lost its prism: the origin itself, or a place far from where the rows before and after lie."""

import numpy as np
from numpy.typing import NDArray

from diagnosis.behind.points import PointData, fit_points, tracked_angles, tracked_data, usable_rows
from diagnosis.log.findings import Finding
from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import PointTable
from diagnosis.replay.stretches import Stretch
from machine.effects.entries import pack_under
from machine.rotations import Array

MEDIAN_WINDOW_ROWS = 5  # rows of one point, of which the middle one is compared with their median
OUTLIER_SIGMAS = 20.0  # what rows usually differ from it by
OUTLIER_MIN_M = 0.05  # no arm springs so far and back between two rows
MAX_ITERATIONS = 4  # a frame that was fitted through wild rows moves all others


def without_zeros(table: PointTable, subject: str) -> tuple[PointTable, list[Finding]]:
    """Points without those at exactly 0, 0, 0: no tracker measures its own place."""
    zero = (table.xyz == 0.0).all(axis=1)
    if not zero.any():
        return table, []
    text = f"{int(zero.sum())} points are at exactly 0, 0, 0, as a tracker writes that sees nothing; they are left out"
    return table.without_rows(zero), [Finding("lost_points", "problem", subject, text, int(zero.sum()))]


def without_spikes(
    nominal: Nominal, table: PointTable, stretches: tuple[Stretch, ...]
) -> tuple[PointTable, list[Finding]]:
    """Tracked points without single rows that lie elsewhere.

    Model: what the nominal machine leaves of a row, less the median of that of five rows of this point around it; the
           frame is fitted again without what was taken out.
    """
    left, spikes = table, np.zeros(len(table.xyz), dtype=bool)
    for _ in range(MAX_ITERATIONS):
        found = _spike_mask(nominal, left, stretches)
        if not found.any():
            break
        spikes |= found
        left = left.without_rows(found)
    if not spikes.any():
        return table, []
    first = int(np.argmax(spikes))
    text = (
        f"{int(spikes.sum())} of {len(spikes)} points spring by {OUTLIER_MIN_M:g} m or more for one row and back, the "
        f"first ({table.point_names[first]}) at {table.t_s[first]:.3f} s; they are left out"
    )
    return left, [Finding("lost_points", "problem", "tracker.csv", text, int(spikes.sum()))]


def _spike_mask(nominal: Nominal, table: PointTable, stretches: tuple[Stretch, ...]) -> NDArray[np.bool_]:
    found = np.zeros(len(table.xyz), dtype=bool)
    data, q = tracked_data(nominal, table, stretches), tracked_angles(nominal, table, stretches)
    if data is None or len(data.xyz) < MEDIAN_WINDOW_ROWS:
        return found
    rows = np.nonzero(usable_rows(nominal, table, q))[0]
    residual = _point_residual(nominal, data)
    away = np.zeros(len(rows))
    for point in np.unique(data.point_index):
        own = np.nonzero(data.point_index == point)[0]
        own = own[np.argsort(data.time_or_pose_index[own], kind="stable")]
        if len(own) >= MEDIAN_WINDOW_ROWS:
            away[own] = np.linalg.norm(residual[own] - _running_median(residual[own]), axis=1)
    usual = 1.4826 * float(np.median(away))
    found[rows[away > max(OUTLIER_SIGMAS * usual, OUTLIER_MIN_M)]] = True
    return found


def _point_residual(nominal: Nominal, data: PointData) -> Array:
    return fit_points(nominal, pack_under(nominal.baseline_effects, nominal.n), data).residual_m


def _running_median(values: Array) -> Array:
    """Of each column of (m, 3), over five rows."""
    half = MEDIAN_WINDOW_ROWS // 2
    padded = np.pad(values, ((half, half), (0, 0)), mode="reflect")
    return np.median(np.stack([padded[k : k + len(values)] for k in range(MEDIAN_WINDOW_ROWS)]), axis=0)
