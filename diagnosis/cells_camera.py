"""The cell of marker corners [px]: arm, mount, lens, markers and the camera's clock against the encoders."""

from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from diagnosis.candidates import candidates_of
from diagnosis.cells import Cell, Rows
from diagnosis.cells_points import rows_of
from diagnosis.clocks import UNTOLD, camera_to_plc_s, guessed, late_by_motion_s
from diagnosis.corner_noise import AXES, PLAIN, CornerNoise, groups_of, noise_of_visits
from diagnosis.link_angles import Path, candidates_behind, inside, link_angles, paths_of, without_encoders
from diagnosis.loose_marker import loose_marker
from diagnosis.nominal import Nominal
from diagnosis.reading import Read
from diagnosis.saturated import saturated_noise
from diagnosis.tables import MarkerTable
from diagnosis.views import mean_pose, views_of
from diagnosis.views_one_eye import one_eye_views
from machine.effects.layout import READOUT, ParameterSets
from machine.effects.seen import camera_mount, seen_corners, true_times
from machine.effects.structure import tcp_poses
from machine.remainder import Remainder
from machine.rotations import Array, rotation_from_rotvec
from machine.targets import Marker

FRAMES_MAX = 160
TIME_TOLERANCE_S = 1e-6
MARGIN_S = 0.6  # a stretch's ends: the clock's offset may lie this far off
SIGMA_MIN_PX = 0.03
STILL_RAD = 3e-3
VISITS_S = 3.0
VISITED_MIN = 20  # corners seen again
NUDGE = 1e-4
FAR_PX = 1e3
OF_PLACE = 1e-3  # of a column: what is left of one below it is what a step of the object's place is wrong by
VIEWS_MIN = 4  # poses of the object to place it by
TIMED = ("clock_offset", "clock_drift", "camera_latency", "rolling_shutter")


@dataclass(frozen=True, slots=True)
class Frames:
    """Corners by frame: t_s (m,) on the PLC's clock as best known, pixels (m, 2 eyes, markers, 4, 2), NaN unseen.

    `groups` (N,): frame and axis of each number that was seen, by `groups_of`.
    """

    t_s: Array
    pixels: Array
    markers: tuple[Marker, ...]
    groups: NDArray[np.int64]

    @classmethod
    def of(cls, t_s: Array, pixels: Array, markers: tuple[Marker, ...]) -> Self:
        """With its groups."""
        return cls(t_s, pixels, markers, groups_of(pixels))


@dataclass(frozen=True, slots=True)
class CornerResidual:
    """Whitened corners (sets, N): measured less foreseen, the OOI's place in the base fitted each time.

    `untimed`: so is by how much the camera's stamps are late, since nobody gave its clock's offset.
    """

    nominal: Nominal
    frames: Frames
    on: Literal["tool", "ooi"]
    paths: tuple[Path, ...]
    at: NDArray[np.int64]
    t_start_s: float
    T_base_ooi: Array
    nuisance: Array
    noise: CornerNoise
    untimed: bool = False

    def __call__(self, sets: ParameterSets) -> Array:
        """One row per set."""
        plain = without_encoders(sets)
        white = self.noise.white(self.nuisance.T, self.frames.groups).T
        rows = [self._one(sets, plain, k, white) for k in range(sets.sets)]
        return self.noise.white(np.array(rows), self.frames.groups)

    def _one(self, sets: ParameterSets, plain: ParameterSets, k: int, white: Array) -> Array:
        """Not yet whitened (N,); `white`: the whitened nuisance (N, 6 or 7), which the parameters do not change."""
        later = bool(sets.machine[k, READOUT])
        T, T_later = self.poses(sets, plain, k, 0.0), self.poses(sets, plain, k, 0.01) if later else None
        residual = self.difference(plain, k, T, T_later, self.T_base_ooi)
        if self.on == "tool" or self.nuisance.shape[1] == 0:
            return residual
        moved = self.T_base_ooi @ _small(-self._place(white, residual)[:6])
        residual = self.difference(plain, k, T, T_later, moved)
        return np.asarray(residual - self.nuisance @ self._place(white, residual), dtype=float)

    def _place(self, white: Array, residual: Array) -> Array:
        """Change of the OOI's place, and of the clock (6 or 7,), that explains most of a residual (N,) [px]."""
        return _solved(white, self.noise.white(residual[None], self.frames.groups)[0])

    def placeless(self, columns: Array) -> Array:
        """Columns (N, k) [px, by any number], white as the residual, without what a change of the OOI's place does."""
        white = self.noise.white(columns.T, self.frames.groups).T
        if self.on == "tool" or self.nuisance.shape[1] == 0:
            return white
        own = self.noise.white(self.nuisance.T, self.frames.groups).T
        left = white - own @ np.linalg.lstsq(own, white, rcond=None)[0]
        return left * (np.linalg.norm(left, axis=0) > OF_PLACE * np.linalg.norm(white, axis=0))

    def poses(
        self, sets: ParameterSets, plain: ParameterSets, k: int, later_s: float, more_rad: Array | float = 0.0
    ) -> Array:
        """Ts_cam_base (m, 4, 4), or Ts_cam_tcp where the tool is looked at. `more_rad`: on top of the angles (n,)."""
        mount = self.nominal.T_tcp_cam_left
        if mount is None or self.nominal.arm is None:
            return np.tile(np.eye(4), (len(self.frames.t_s), 1, 1))
        T_cam_tcp = np.asarray(np.linalg.inv(camera_mount(sets, mount, k)), dtype=float)
        if self.on == "tool":
            return np.tile(T_cam_tcp, (len(self.frames.t_s), 1, 1))
        t = true_times(sets, self.frames.t_s, self.t_start_s, k) + later_s
        q = link_angles(self.paths, sets, k, self.at, t) + more_rad
        return np.asarray(T_cam_tcp @ np.linalg.inv(tcp_poses(self.nominal.arm, plain, q, k)), dtype=float)

    def difference(self, plain: ParameterSets, k: int, Ts: Array, later: Array | None, T_object: Array) -> Array:
        """Measured less foreseen of the corners that were seen (N,) [px]."""
        camera = self.nominal.camera
        if camera is None:
            return np.zeros(0)
        after = None if later is None else later @ T_object
        corners = seen_corners(plain, camera, self.frames.markers, Ts @ T_object, after, 0.01, k)
        foreseen = np.stack([corners.left, corners.right], axis=1)
        seen = np.isfinite(self.frames.pixels)
        return np.clip(np.nan_to_num((self.frames.pixels - foreseen)[seen], nan=FAR_PX), -FAR_PX, FAR_PX)


def _solved(A: Array, r: Array) -> Array:
    return np.asarray(np.linalg.solve(A.T @ A + 1e-9 * np.eye(A.shape[1]), A.T @ r), dtype=float)


def _small(x: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_from_rotvec(x[3:]), x[:3]
    return T


def camera_cells(whole: Read, base: ParameterSets, paths: tuple[Path, ...] | None = None) -> list[Cell]:
    """Cells for the object of interest, seen while the arm moves, and for the tool.

    `paths`: the encoders' courses, if they are known.
    """
    nominal, tables = whole.nominal, whole.tables
    if nominal is None or tables is None or tables.markers is None or nominal.arm is None:
        return []
    if nominal.camera is None or nominal.T_tcp_cam_left is None:
        return []
    paths = paths_of(whole.stretches) if paths is None else paths
    markers, to_plc_s = tables.markers, camera_to_plc_s(tables)

    def cells_of(on: Literal["tool", "ooi"], late_s: float | None = None) -> list[Cell]:
        table = replace(markers, t_s=markers.t_s + to_plc_s - (late_s or 0.0))
        frames = frames_of(nominal, table, on, paths)
        return [] if frames is None else _cell(whole, nominal, frames, on, paths, base, table, late_s is not None)

    seen = cells_of("ooi")
    if seen and guessed(tables):
        seen = cells_of("ooi", late_by_motion_s(seen[0]))
    return seen + cells_of("tool")


def frames_of(
    nominal: Nominal, table: MarkerTable, on: Literal["tool", "ooi"], paths: tuple[Path, ...]
) -> Frames | None:
    """At most 160 frames, spread evenly over those that lie within stretches."""
    markers = tuple(one for one in nominal.markers if one.on == on)
    number = {one.marker_id: k for k, one in enumerate(markers)}
    usable = np.array([int(i) in number for i in table.ids]) & (table.eye >= 0) & np.isfinite(table.t_s)
    if on == "ooi":
        usable &= inside(paths, table.t_s, MARGIN_S) >= 0
    if not markers or int(usable.sum()) < 8:
        return None
    rows = np.nonzero(usable)[0]
    rows = rows[np.argsort(table.t_s[rows], kind="stable")]
    groups = np.split(rows, np.nonzero(np.diff(table.t_s[rows]) > TIME_TOLERANCE_S)[0] + 1)
    chosen = np.unique(np.linspace(0, len(groups) - 1, FRAMES_MAX).astype(int))
    pixels = np.full((len(chosen), 2, len(markers), 4, 2), np.nan)
    for k, group in enumerate(chosen):
        for row in groups[group]:
            pixels[k, table.eye[row], number[int(table.ids[row])]] = table.corners[row]
    pixels[np.isnan(pixels).any(axis=-1)] = np.nan  # half of a corner is no place in the image
    return Frames.of(np.array([table.t_s[groups[k][0]] for k in chosen]), pixels, markers)


def _cell(
    whole: Read,
    nominal: Nominal,
    frames: Frames,
    on: Literal["tool", "ooi"],
    paths: tuple[Path, ...],
    base: ParameterSets,
    table: MarkerTable,
    untimed: bool = False,
) -> list[Cell]:
    at = inside(paths, frames.t_s) if on == "ooi" else np.zeros(len(frames.t_s), dtype=np.int64)
    start_s = float(paths[0].t_s[0]) if paths else 0.0
    rough = CornerResidual(nominal, frames, on, paths, at, start_s, np.eye(4), np.zeros((0, 0)), PLAIN, untimed)
    placed = _placed(rough, nominal, table, base)
    if placed is None:
        return []
    joints = tuple(range(1, nominal.n + 1))
    candidates = candidates_of("camera", joints, True)
    if on == "ooi":
        candidates = candidates_behind(joints, paths) + candidates
        candidates += candidates_of("time", joints, True)
    else:
        candidates = tuple(one for one in candidates if one.name not in TIMED)
    untold = ("odometry_scale", *(UNTOLD if untimed else ()))
    candidates = tuple(one for one in candidates if one.name not in untold)
    visits = _visits(placed, base)
    known = noise_of_visits(visits, 1 if on == "tool" else VISITED_MIN)
    loose = loose_marker(visits, len(frames.markers))
    noise = known if known is not None else _of_two(saturated_noise(placed, base, candidates, frames.groups))
    noise = replace(noise, own=np.maximum(noise.own, SIGMA_MIN_PX))
    record = nominal.remainder("camera", on=on)
    rows, t_s = _rows(frames)
    noise = noise.with_remainder(record)
    left = _share_left(record, noise) if record is not None else 0.0
    return [
        Cell(
            stage="camera",
            joint=None,
            unit="px",
            candidates=candidates,
            base=base,
            whitened=replace(placed, noise=noise),
            rows=rows,
            scale=np.hypot(noise.own, noise.shared)[rows.channel % 2],
            quiet=1.0,
            floor_known=known is not None,
            same_kind=False,
            regressors=(("time", t_s),),
            t_s=t_s,
            usual=record.usual_at(left) if record is not None else (),
            left_share=left,
            restless="" if loose is None else loose.told(frames.markers[loose.number].marker_id),
        )
    ]


def _of_two(own_and_shared: tuple[float, float]) -> CornerNoise:
    own, shared = own_and_shared
    return CornerNoise(np.full(AXES, own), np.full(AXES, shared))


def _share_left(record: Remainder, noise: CornerNoise) -> float:
    """Of the corners' floor, in squares: what the baseline leaves."""
    left = record.sigma**2 + float(np.mean(np.square(record.by_axis or (0.0,))))
    return min(1.0, left / float(np.mean(noise.own**2 + noise.shared**2)))


def _placed(rough: CornerResidual, nominal: Nominal, table: MarkerTable, base: ParameterSets) -> CornerResidual | None:
    """With the object's nominal place: the tool's by the machine file, the OOI's by what was seen."""
    if rough.on == "tool":
        T = nominal.T_tcp_tool
        return None if T is None else replace(rough, T_base_ooi=T)
    views = views_of(nominal, table, "ooi")
    if len(views.t_s) < VIEWS_MIN:
        views = one_eye_views(nominal, table, "ooi")
    at = inside(rough.paths, views.t_s, MARGIN_S)
    kept = at >= 0
    if int(kept.sum()) < VIEWS_MIN or nominal.arm is None or nominal.T_tcp_cam_left is None:
        return None
    some = np.nonzero(kept)[0][np.unique(np.linspace(0, int(kept.sum()) - 1, FRAMES_MAX).astype(int))]
    q = link_angles(rough.paths, base, 0, at[some], views.t_s[some])
    Ts = tcp_poses(nominal.arm, without_encoders(base), q) @ nominal.T_tcp_cam_left @ views.Ts_cam_object[some]
    placed = replace(rough, T_base_ooi=mean_pose(Ts))
    for _ in range(3):  # the mean of single poses is coarse: settle on the corners themselves
        nuisance = nuisance_of(placed, base)
        plain = without_encoders(base)
        residual = placed.difference(plain, 0, placed.poses(base, plain, 0, 0.0), None, placed.T_base_ooi)
        placed = replace(placed, T_base_ooi=placed.T_base_ooi @ _small(-_solved(nuisance, residual)[:6]))
    return replace(placed, nuisance=nuisance_of(placed, base))


def nuisance_of(placed: CornerResidual, base: ParameterSets) -> Array:
    """Change of the residual with the OOI's place (N, 6), per m and rad in its own axes; where nobody knows its clock
    (N, 7) with that, per s.
    """
    plain = without_encoders(base)
    Ts = placed.poses(base, plain, 0, 0.0)
    at = placed.difference(plain, 0, Ts, None, placed.T_base_ooi)
    steps = [placed.difference(plain, 0, Ts, None, placed.T_base_ooi @ _small(NUDGE * row)) for row in np.eye(6)]
    if placed.untimed:
        steps.append(placed.difference(plain, 0, placed.poses(base, plain, 0, NUDGE), None, placed.T_base_ooi))
    return np.array([(one - at) / NUDGE for one in steps]).T


def _rows(frames: Frames) -> tuple[Rows, Array]:
    """Rows by frame; the residual holds only what was seen."""
    seen = np.isfinite(frames.pixels).reshape(len(frames.t_s), -1)
    whole = rows_of(len(frames.t_s), seen.shape[1])
    kept = seen.ravel()
    cut = replace(
        whole, fold=whole.fold[kept], block=whole.block[kept], series=whole.series[kept], channel=whole.channel[kept]
    )
    return cut, np.repeat(frames.t_s, seen.shape[1])[kept]


def _visits(placed: CornerResidual, base: ParameterSets) -> list[Array]:
    """Corners (k, C, 2) [px] of each pose that was looked at again, seconds apart.

    Residuals, not corners: a pose that repeats to a millimetre only would look like noise of pixels.
    """
    pixels = placed.frames.pixels
    if placed.on == "tool":
        return [pixels.reshape(len(pixels), -1, 2)]
    flat = pixels.copy()
    flat[np.isfinite(flat)] = placed(base)[0]
    flat = flat.reshape(len(pixels), -1, 2)
    q = link_angles(placed.paths, base, 0, placed.at, placed.frames.t_s)
    visits: list[Array] = []
    left = list(range(len(q)))
    while left:
        first = left.pop(0)
        same = [k for k in left if np.abs(q[k] - q[first]).max() < STILL_RAD]
        if any(placed.frames.t_s[k] - placed.frames.t_s[first] > VISITS_S for k in same):
            visits.append(flat[[first, *same]])
        left = [k for k in left if k not in set(same)]
    return visits
