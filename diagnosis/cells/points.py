"""The cell of points measured at rest (static.csv) or in motion (tracker.csv) against the arm."""

from dataclasses import replace

import numpy as np

from diagnosis.behind.link_angles import Path, candidates_behind, coarsest, inside, paths_of
from diagnosis.behind.loose_point import loose_point
from diagnosis.behind.point_residual import PointResidual
from diagnosis.behind.points import PointData, numbers_fitted, static_data, tracked_data
from diagnosis.behind.saturated import saturated_noise
from diagnosis.behind.stairs import LEFT
from diagnosis.log.nominal import Nominal
from diagnosis.noise.of_points import PointNoise, instants_of
from diagnosis.reading.read import Read
from diagnosis.search.candidates import candidates_of
from diagnosis.search.cell import Cell, Rows
from machine.effects.layout import ParameterSets
from machine.remainder import Remainder
from machine.rotations import Array

ROWS_MAX = 300
FOLDS = 4
SIGMA_MIN_M = 2e-5
SAME_POSE_RAD = 2e-3
DIRECTION_S = 0.2  # over which the direction of motion is taken: backlash differs by it, and is no noise
POINT_ROWS_MIN = 6
DRIFT_TIMES = 2.0  # of the noise: trackers drift by as much as they scatter
TENTHS, ALIKE_LEAST = 10, 1.8  # of independent instants one recording in a thousand shows more
FEW_AT_REST, FEW_IN_MOTION = 4, 8  # points measured again for a floor at all: in motion some are so by chance
ENOUGH = 12  # for one of each axis


def point_cells(whole: Read, base: ParameterSets, paths: tuple[Path, ...] | None = None) -> list[Cell]:
    """A cell for poses at rest, and one for tracked motion. `paths`: the encoders' courses, if they are known."""
    nominal, tables = whole.nominal, whole.tables
    if nominal is None or tables is None or nominal.arm is None:
        return []
    cells = []
    static = static_data(nominal, tables.static) if tables.static is not None else None
    if static is not None and len(static.xyz) >= POINT_ROWS_MIN:
        cells.append(_cell(nominal, _thinned(static), (), base))
    tracked = tracked_data(nominal, tables.tracker, whole.stretches) if tables.tracker is not None else None
    if tracked is not None and len(tracked.xyz) >= POINT_ROWS_MIN:
        courses = paths_of(whole.stretches) if paths is None else paths
        cells.append(_cell(nominal, _thinned(tracked), courses, base, clocked=tables.markers is None))
    return cells


def _thinned(data: PointData) -> PointData:
    rows = np.unique(np.linspace(0, len(data.xyz) - 1, ROWS_MAX).astype(int))
    return PointData(data.q[rows], data.which[rows], data.xyz[rows], data.when[rows])


def _cell(
    nominal: Nominal, data: PointData, paths: tuple[Path, ...], base: ParameterSets, clocked: bool = False
) -> Cell:
    """`clocked`: whether these points' clock may be off: no camera was there whose clock the catalogue means."""
    at = inside(paths, data.when) if paths else np.zeros(len(data.when), dtype=np.int64)
    if paths and (at < 0).any():
        kept = at >= 0
        data = PointData(data.q[kept], data.which[kept], data.xyz[kept], data.when[kept])
        at = at[kept]
    joints = tuple(range(1, nominal.n + 1))
    candidates = candidates_behind(joints, paths) + (candidates_of("time", joints, True) if clocked else ())
    m = len(data.xyz)
    plain = PointNoise(np.ones(3), 0.0, np.zeros(m), instants_of(data.when))
    start_s = float(paths[0].t_s[0]) if clocked else None
    rough = PointResidual(nominal, data, paths, at, plain, t_start_s=start_s)
    known, measured_again, restless = _floor(rough, base)
    by_instant = 3 * np.repeat(rough.noise.instants, 3) + np.tile(np.arange(3), m)
    taken = numbers_fitted(nominal, data)
    own, common = saturated_noise(rough, base, candidates, by_instant, taken) if known is None else (known, 0.0)
    record = nominal.remainder("structure", on="tracker" if paths else "static")
    noise_m = float(np.sqrt(np.mean(own**2) + common**2))
    drifting = 1.0 if record is not None or not paths else _alike_in_time(rough, base, noise_m)
    if known is not None:  # the same stairs in the same pose: repeats do not show them
        own = np.hypot(own, _stairs_m(rough, base))
    sigma = np.hypot(np.maximum(own, SIGMA_MIN_M) * np.ones(3), axes_of(record, 3))
    left = float(np.mean(axes_of(record, 3) ** 2 / sigma**2))
    swing_rad = record.swing_rad if record is not None else 0.0
    reach_m = rough.reach_m(base)
    noise = replace(rough.noise, own=sigma, swing_rad=swing_rad, reach_m=reach_m, common_m=common)
    rows = rows_of(m, 3)
    q = {f"joint {j}": np.repeat(data.q[:, j - 1], 3) for j in joints}
    return Cell(
        stage="structure",
        joint=None,
        unit="m",
        candidates=candidates,
        base=base,
        whitened=replace(rough, noise=noise),
        rows=rows,
        scale=np.tile(np.hypot(sigma, common), m),
        quiet=1.0,
        floor_known=known is not None,
        floor_squares=3 * measured_again,
        restless=restless,
        spread_least=drifting,
        same_kind=False,
        regressors=tuple(q.items()),
        t_s=np.repeat(data.when, 3),
        usual=record.usual_at(left) if record is not None else (),
        left_share=left,
    )


def _stairs_m(rough: PointResidual, base: ParameterSets) -> Array:
    """RMS (3,) [m] of what coarse encoders leave of their stairs, radial, tangential and up."""
    steps, squares = coarsest(rough.paths, rough.nominal.n), np.zeros(3)
    for j in np.nonzero(steps)[0]:
        squares += (rough.moved_by(base, int(j), LEFT * float(steps[j])) ** 2).mean(axis=0)
    return np.sqrt(squares)


def _alike_in_time(rough: PointResidual, base: ParameterSets, noise_m: float) -> float:
    """For how many instants one speaks, where what is measured drifts: 1 where they differ by chance.

    Model: variance of the means of tenths of the recording, over that of means of as many independent instants. What
           is several times larger than the noise is no drift of a tracker.
    Why:   a tracker drifts by a tenth of a millimetre in a minute, and a length that is 0.08 mm off follows the drift.
           What an effect does goes with the motion, which tenths of a recording have alike.
    """
    instants = rough.noise.instants
    residual = rough(base)[0].reshape(-1, 3)
    count = np.bincount(instants)
    mean = np.stack([np.bincount(instants, weights=axis) / count for axis in residual.T], axis=1)
    size = len(mean) // TENTHS
    if size < 2:
        return 1.0
    if float(np.sqrt(np.mean(residual**2))) > DRIFT_TIMES * noise_m:
        return 1.0
    mean -= mean.mean(axis=0)
    tenths = mean[: size * TENTHS].reshape(TENTHS, size, 3).mean(axis=1)
    alike = size * float((tenths**2).sum()) / (TENTHS - 1) / max(float((mean**2).sum()) / len(mean), 1e-30)
    return alike if alike > ALIKE_LEAST else 1.0


def axes_of(record: Remainder | None, axes: int) -> Array:
    """What the baseline leaves along each axis (axes,); nothing where the file says nothing."""
    if record is None:
        return np.zeros(axes)
    return np.array(record.by_axis if len(record.by_axis) == axes else [record.sigma] * axes)


def rows_of(m: int, channels: int) -> Rows:
    """Blocks of whole samples, four folds of neighbouring ones; channels one by one within a sample."""
    sample = np.repeat(np.arange(m), channels)
    channel = np.tile(np.arange(channels), m)
    fold = sample * FOLDS // max(m, 1)
    blocks = min(m, 40)
    return Rows(fold, sample * blocks // max(m, 1), channel.copy(), channel)


def _floor(rough: PointResidual, base: ParameterSets) -> tuple[Array | None, int, str]:
    """RMS deviation (3,) of the residual where one point was measured again in the same pose, None if it hardly was;
    how often it was; which point of poses at rest moved by itself, in words.
    """
    residual = rough(base)[0].reshape(-1, 3)
    direction = _directions(rough)
    points = rough.nominal.points
    of_point, again = np.zeros((len(points), 3)), np.zeros(len(points), dtype=np.int64)
    left = set(range(len(residual)))
    while left:
        first = left.pop()
        q, which = rough.data.q[first], rough.data.which[first]
        same = [
            k
            for k in left
            if rough.data.which[k] == which
            and np.abs(rough.data.q[k] - q).max() < SAME_POSE_RAD
            and bool((direction[k] == direction[first]).all())
        ]
        left -= set(same)
        group = residual[[first, *same]]
        of_point[which] += ((group - group.mean(axis=0)) ** 2).sum(axis=0)
        again[which] += len(same)
    squares, dof = of_point.sum(axis=0), int(again.sum())
    if dof < (FEW_IN_MOTION if rough.paths else FEW_AT_REST):
        return None, 0, ""
    told = [(point.joint, point.name) for point in points]
    loose = "" if rough.paths else loose_point(of_point.sum(axis=1), again, *zip(*told, strict=True))
    return np.sqrt(squares / dof if dof >= ENOUGH else np.full(3, squares.mean() / dof)), dof, loose


def _directions(rough: PointResidual) -> Array:
    """Sign of each joint's motion (m, n); 0 for poses at rest."""
    out = np.zeros_like(rough.data.q)
    for k, path in enumerate(rough.paths):
        rows = rough.at == k
        t = rough.data.when[rows]
        for j in range(out.shape[1]):
            now, before = (np.interp(when, path.t_s, path.enc[:, j]) for when in (t, t - DIRECTION_S))
            out[rows, j] = np.sign(np.where(np.abs(now - before) > 1e-3, now - before, 0.0))
    return out
