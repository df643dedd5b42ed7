"""The cell of points measured at rest (static.csv) or in motion (tracker.csv) against the arm."""

from dataclasses import replace

import numpy as np

from diagnosis.behind.link_angles import Path, candidates_behind, path_index, paths_of
from diagnosis.behind.loose_point import off_its_link
from diagnosis.behind.point_noise import noise_by_repeats, point_scatter
from diagnosis.behind.point_residual import unweighted_residual
from diagnosis.behind.points import POINT_ROWS_MIN, PointData, static_data, tracked_data
from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import Tables
from diagnosis.noise.of_repeated_points import RepeatedPoints
from diagnosis.reading.read import Read
from diagnosis.search.candidates import candidates_of
from diagnosis.search.cell import Cell, ResidualRows
from machine.effects.layout import ParameterSets
from machine.remainder import Remainder
from machine.rotations import Array

POINTS_MAX = 300
CROSS_VALIDATION_FOLDS = 4
SIGMA_MIN_M = 2e-5


def point_cells(whole: Read, base: ParameterSets, paths: tuple[Path, ...] | None = None) -> list[Cell]:
    """A cell for poses at rest, and one for tracked motion. `paths`: the encoders' courses, if they are known."""
    nominal, tables = whole.nominal_machine, whole.tables
    if nominal is None or tables is None or nominal.arm is None:
        return []
    cells = []
    static = static_data(nominal, tables.static) if tables.static is not None else None
    if static is not None and len(static.xyz) >= POINT_ROWS_MIN:
        cells.append(_with_loose_point(_point_cell(nominal, _thin_points(static), (), base), nominal, static))
    tracked = tracked_data(nominal, tables.tracker, whole.stretches) if tables.tracker is not None else None
    if tracked is not None and len(tracked.xyz) >= POINT_ROWS_MIN:
        courses = paths_of(whole.stretches) if paths is None else paths
        repeats = noise_by_repeats(nominal, tracked, courses, base, whole.stretches)
        cell = _point_cell(nominal, _thin_points(tracked), courses, base, repeats, clocked=tables.markers is None)
        cells.append(_with_loose_point(cell, nominal, tracked))
    return cells


def _with_loose_point(cell: Cell, nominal: Nominal, data: PointData) -> Cell:
    """The cell, with the point that is loose on its link, if one is."""
    joints, names = [point.joint for point in nominal.tracked_points], [point.name for point in nominal.tracked_points]
    return replace(
        cell,
        loose_target_text=cell.loose_target_text
        or off_its_link(data.xyz, data.point_index, data.time_or_pose_index, joints, names),
    )


def left_out(nominal: Nominal, tables: Tables) -> list[str]:
    """Of which tables not all points are used, in words."""
    return [
        f"{POINTS_MAX} of {len(table.xyz)} points of {name} are used, evenly spread"
        for name, table in (("static.csv", tables.static), ("tracker.csv", tables.tracker))
        if table is not None and nominal.arm is not None and len(table.xyz) > POINTS_MAX
    ]


def _thin_points(data: PointData) -> PointData:
    rows = np.unique(np.linspace(0, len(data.xyz) - 1, POINTS_MAX).astype(int))
    return PointData(data.q[rows], data.point_index[rows], data.xyz[rows], data.time_or_pose_index[rows])


def _point_cell(
    nominal: Nominal,
    data: PointData,
    paths: tuple[Path, ...],
    base: ParameterSets,
    repeats: RepeatedPoints | None = None,
    clocked: bool = False,
) -> Cell:
    """`repeats`: what repeats of one command show of the noise; `clocked`: whether these points' clock may be off: no
    camera was there whose clock the catalogue means.
    """
    at = path_index(paths, data.time_or_pose_index) if paths else np.zeros(len(data.time_or_pose_index), dtype=np.int64)
    start_s = float(paths[0].t_s[0]) if clocked else None
    rough = replace(unweighted_residual(nominal, data, paths, at), t_start_s=start_s)
    data, m = rough.measured_points, len(rough.measured_points.xyz)
    joints = tuple(range(1, nominal.n + 1))
    candidates = candidates_behind(joints, paths) + (candidates_of("time", joints, True) if clocked else ())
    record = nominal.baseline_remainder("structure", on="tracker" if paths else "static")
    found = point_scatter(rough, base, candidates, repeats, record is not None)
    sigma = np.hypot(np.maximum(found.point_sigma_m, SIGMA_MIN_M), axes_of(record, 3))
    oscillation_rad = record.oscillation_rad if record is not None else 0.0
    reach_m = rough.reach_m(base)
    noise = replace(
        rough.noise, point_sigma_m=sigma, oscillation_rad=oscillation_rad, reach_m=reach_m, common_m=found.common_m
    )
    rows = rows_of(m, 3)
    q = {f"joint {j}": np.repeat(data.q[:, j - 1], 3) for j in joints}
    return Cell(
        stage="structure",
        joint=None,
        unit="m",
        candidates=candidates,
        baseline_parameters=base,
        whitened=replace(rough, noise=noise),
        rows=rows,
        scale=np.tile(np.hypot(sigma, found.common_m), m),
        quiet=1.0,
        floor_known=found.is_measured,
        loose_target_text=found.loose_target_text,
        regressors=tuple(q.items()),
        t_s=np.repeat(data.time_or_pose_index, 3),
    )


def axes_of(record: Remainder | None, axes: int) -> Array:
    """What the baseline leaves along each axis (axes,); nothing where the file says nothing."""
    if record is None:
        return np.zeros(axes)
    return np.array(record.by_axis if len(record.by_axis) == axes else [record.sigma] * axes)


def rows_of(m: int, channels: int) -> ResidualRows:
    """Blocks of whole samples, four folds of neighbouring ones; channels one by one within a sample."""
    sample = np.repeat(np.arange(m), channels)
    channel = np.tile(np.arange(channels), m)
    fold = sample * CROSS_VALIDATION_FOLDS // max(m, 1)
    blocks = min(m, 40)
    return ResidualRows(fold, sample * blocks // max(m, 1), channel.copy(), channel)
