"""The cell of points measured at rest (static.csv) or in motion (tracker.csv) against the arm."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.candidates import candidates_of
from diagnosis.cells import Cell, Rows
from diagnosis.link_angles import Path, candidates_behind, coarsest, inside, link_angles, paths_of, without_encoders
from diagnosis.nominal import Nominal
from diagnosis.point_noise import PointNoise, instants_of
from diagnosis.points import PointData, PointFit, fit_points, modelled, numbers_fitted, static_data, tracked_data
from diagnosis.reading import Read
from diagnosis.saturated import saturated_noise
from diagnosis.stairs import LEFT
from machine.effects.encoders import true_angles
from machine.effects.layout import ParameterSets
from machine.effects.seen import true_times
from machine.poses import transform_points
from machine.remainder import Remainder
from machine.rotations import Array

ROWS_MAX = 300
FOLDS = 4
SIGMA_MIN_M = 2e-5
SAME_POSE_RAD = 2e-3
DIRECTION_S = 0.2  # over which the direction of motion is taken: backlash differs by it, and is no noise
POINT_ROWS_MIN = 6
FEW_AT_REST, FEW_IN_MOTION = 4, 8  # points measured again for a floor at all: in motion some are so by chance
ENOUGH = 12  # for one of each axis


@dataclass(frozen=True, slots=True)
class PointResidual:
    """Residuals (sets, 3 m) of measured points in units of the floor; unknown frame and places are fitted each time.

    Axes: radial, tangential and up about the base's upright, since a slewing arm swings across far more than it bends.
    `known`: (3 m,) [m], what the machine's model is known to be wrong by. `t_start_s`: of the recording, where the
    tracker's clock may be off (see `true_times`); None where that is the camera's.
    """

    nominal: Nominal
    data: PointData
    paths: tuple[Path, ...]
    at: NDArray[np.int64]
    noise: PointNoise
    known: Array | None = None
    t_start_s: float | None = None

    def __call__(self, sets: ParameterSets) -> Array:
        """One row per set."""
        return self.noise.white(self.metres(sets))

    def metres(self, sets: ParameterSets) -> Array:
        """The same (sets, 3 m) before it is weighed [m]."""
        plain = without_encoders(sets)
        rows = []
        for k in range(sets.sets):
            data = replace(self.data, q=self._angles(sets, k))
            rows.append(_about_upright(fit_points(self.nominal, plain, data, k), data.xyz).ravel())
        return np.array(rows) - (0.0 if self.known is None else self.known)

    def reach_m(self, sets: ParameterSets) -> Array:
        """How far each point is from the base's upright (m,)."""
        data = replace(self.data, q=self._angles(sets, 0))
        T = fit_points(self.nominal, without_encoders(sets), data, 0).T_base_tracker
        p = transform_points(T, data.xyz)
        return np.hypot(p[:, 0], p[:, 1])

    def moved_by(self, sets: ParameterSets, joint: int, angle_rad: float) -> Array:
        """How far an angle more at a joint (0-based) takes each point (m, 3) [m]: radial, tangential, up."""
        plain, data = without_encoders(sets), replace(self.data, q=self._angles(sets, 0))
        found = fit_points(self.nominal, plain, data)
        turned = data.q.copy()
        turned[:, joint] += angle_rad
        there = modelled(self.nominal, plain, replace(data, q=turned), found.places)
        here = modelled(self.nominal, plain, data, found.places)
        return _about_upright(replace(found, residual=there - here), self.data.xyz)

    def _angles(self, sets: ParameterSets, which: int) -> Array:
        if not self.paths:
            return true_angles(sets, self.data.q, which)
        when = self.data.when if self.t_start_s is None else true_times(sets, self.data.when, self.t_start_s, which)
        return link_angles(self.paths, sets, which, self.at, when)


def _about_upright(found: PointFit, xyz: Array) -> Array:
    """The residual (m, 3) of points measured at xyz (m, 3) as radial, tangential, up."""
    T, r = found.T_base_tracker, found.residual
    p = transform_points(T, xyz)
    azimuth = np.arctan2(p[:, 1], p[:, 0])
    c, s = np.cos(azimuth), np.sin(azimuth)
    return np.stack([c * r[:, 0] + s * r[:, 1], c * r[:, 1] - s * r[:, 0], r[:, 2]], axis=1)


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
    known = _floor(rough, base)
    by_instant = 3 * np.repeat(rough.noise.instants, 3) + np.tile(np.arange(3), m)
    taken = numbers_fitted(nominal, data)
    own, common = saturated_noise(rough, base, candidates, by_instant, taken) if known is None else (known, 0.0)
    record = nominal.remainder("structure", on="tracker" if paths else "static")
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


def _floor(rough: PointResidual, base: ParameterSets) -> Array | None:
    """RMS deviation (3,) of the residual where one point was measured again in the same pose; None if it never was."""
    residual = rough(base)[0].reshape(-1, 3)
    direction = _directions(rough)
    squares, dof = np.zeros(3), 0
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
        squares += ((group - group.mean(axis=0)) ** 2).sum(axis=0)
        dof += len(same)
    if dof < (FEW_IN_MOTION if rough.paths else FEW_AT_REST):
        return None
    return np.sqrt(squares / dof if dof >= ENOUGH else np.full(3, squares.mean() / dof))


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
