"""The cell of marker corners [px]: arm, mount, lens, markers and the camera's clock against the encoders."""

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from diagnosis.behind.corner_residual import CornerResidual, Frames, least_squares, nuisance_of, small_motion
from diagnosis.behind.link_angles import Path, candidates_behind, link_angles, path_index, paths_of, without_encoders
from diagnosis.behind.loose_marker import loose_marker
from diagnosis.behind.saturated import saturated_noise
from diagnosis.behind.seen_corners import CLOCK_OFFSET_MARGIN_S, CORNER_ROWS_MIN, seen_rows
from diagnosis.behind.views import mean_pose, views_of
from diagnosis.behind.views_one_eye import one_eye_views
from diagnosis.cells.points import rows_of
from diagnosis.datagrams.clocks import camera_to_plc_s, is_offset_guessed
from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import MarkerTable
from diagnosis.noise.of_corners import CORNER_AXIS_COUNT, UNIT_CORNER_NOISE, CornerNoise, noise_of_visits
from diagnosis.reading.read import Read
from diagnosis.search.candidates import candidates_of
from diagnosis.search.cell import Cell, ResidualRows
from diagnosis.search.fit import residuals_at, soft_l1_costs
from machine.effects.layout import ParameterSets
from machine.effects.structure import tcp_poses
from machine.rotations import Array

# How late a camera's stamps are where its clock's offset is not given: pictures move with the joints.
CLOCK_OFFSET_EFFECT = "clock_offset"
CLOCK_CONFOUNDED_EFFECTS = (CLOCK_OFFSET_EFFECT, "camera_latency")
SPAN_S, STEP_S = 0.3, 0.005
FINER, ROUNDS = 10, 2


def late_by_motion_s(cell: Cell) -> float:
    """How late the camera's stamps are, by what is seen while the arm moves; 0 where nothing shows it."""
    clock = next((candidate for candidate in cell.candidates if candidate.name == CLOCK_OFFSET_EFFECT), None)
    if clock is None:
        return 0.0
    best, step = 0.0, STEP_S
    tried = np.arange(-SPAN_S, SPAN_S + 0.5 * STEP_S, STEP_S)
    for _ in range(1 + ROUNDS):
        total = soft_l1_costs(residuals_at(cell, (clock,), tried[:, None])).sum(axis=1)
        best = float(tried[int(np.argmin(total))])
        tried, step = best + step * np.linspace(-1.0, 1.0, 2 * FINER + 1), step / FINER
    return best


FRAMES_MAX = 160
TIME_TOLERANCE_S = 1e-6
SIGMA_MIN_PX = 0.03
SAME_POSTURE_TOLERANCE_RAD = 3e-3
# A camera may be as late or early as this: postures that are equal at other speeds are no repeats
CAMERA_DELAY_MAX_S = 0.1
REVISIT_INTERVAL_MIN_S = 3.0
REVISITED_CORNERS_MIN = 20  # corners seen again
DEFAULT_MARKER_LAYOUT_SIGMA_M = 5e-4  # markers put on by hand, where the machine file states no accuracy
POSTURE_CLUSTERS_MAX = 16  # groups of frames that speak for themselves
OBJECT_VIEWS_MIN = 4  # poses of the object to place it by
CAMERA_TIMING_EFFECTS = ("clock_offset", "clock_drift", "camera_latency", "rolling_shutter")
TOOL_MARKER_EFFECTS = ("tool_marker_rotation", "tool_marker_translation")


def camera_cells(whole: Read, base: ParameterSets, paths: tuple[Path, ...] | None = None) -> list[Cell]:
    """Cells for the object of interest, seen while the arm moves, and for the tool.

    `paths`: the encoders' courses, if they are known.
    """
    nominal, tables = whole.nominal_machine, whole.tables
    if nominal is None or tables is None or tables.markers is None or nominal.arm is None:
        return []
    if nominal.camera is None or nominal.T_tcp_cam_left is None:
        return []
    paths = paths_of(whole.stretches) if paths is None else paths
    markers, to_plc_s = tables.markers, camera_to_plc_s(tables)

    def cells_of(on: Literal["tool", "ooi"], late_s: float | None = None) -> list[Cell]:
        table = replace(markers, t_s=markers.t_s + to_plc_s - (late_s or 0.0))
        frames = frames_of(nominal, table, on, paths)
        return (
            [] if frames is None else _camera_cells(whole, nominal, frames, on, paths, base, table, late_s is not None)
        )

    seen = cells_of("ooi")
    if seen and is_offset_guessed(tables):
        seen = cells_of("ooi", late_by_motion_s(seen[0]))
    return seen + cells_of("tool")


def frames_of(
    nominal: Nominal, table: MarkerTable, on: Literal["tool", "ooi"], paths: tuple[Path, ...]
) -> Frames | None:
    """At most 160 frames, spread evenly over those that lie within stretches."""
    markers = tuple(marker for marker in nominal.markers if marker.on == on)
    number = {marker.marker_id: k for k, marker in enumerate(markers)}
    usable = seen_rows(nominal, table, on)
    if on == "ooi":
        usable &= path_index(paths, table.t_s, CLOCK_OFFSET_MARGIN_S) >= 0
    if not markers or int(usable.sum()) < CORNER_ROWS_MIN:
        return None
    rows = np.nonzero(usable)[0]
    rows = rows[np.argsort(table.t_s[rows], kind="stable")]
    groups = np.split(rows, np.nonzero(np.diff(table.t_s[rows]) > TIME_TOLERANCE_S)[0] + 1)
    chosen = np.unique(np.linspace(0, len(groups) - 1, FRAMES_MAX).astype(int))
    pixels = np.full((len(chosen), 2, len(markers), 4, 2), np.nan)
    for k, group in enumerate(chosen):
        for row in groups[group]:
            pixels[k, table.eye[row], number[int(table.marker_ids[row])]] = table.corners_px[row]
    pixels[np.isnan(pixels).any(axis=-1)] = np.nan  # half of a corner is not a place in the image
    return Frames.with_groups(np.array([table.t_s[groups[k][0]] for k in chosen]), pixels, markers)


def _camera_cells(
    whole: Read,
    nominal: Nominal,
    frames: Frames,
    on: Literal["tool", "ooi"],
    paths: tuple[Path, ...],
    base: ParameterSets,
    table: MarkerTable,
    untimed: bool = False,
) -> list[Cell]:
    at = path_index(paths, frames.t_s) if on == "ooi" else np.zeros(len(frames.t_s), dtype=np.int64)
    start_s = float(paths[0].t_s[0]) if paths else 0.0
    rough = CornerResidual(
        nominal, frames, on, paths, at, start_s, np.eye(4), np.zeros((0, 0)), UNIT_CORNER_NOISE, untimed
    )
    placed = _residual_at_nominal_place(rough, nominal, table, base)
    if placed is None:
        return []
    joints = tuple(range(1, nominal.n + 1))
    candidates = candidates_of("camera", joints, True)
    if on == "ooi":
        candidates = candidates_behind(joints, paths) + candidates
        candidates += candidates_of("time", joints, True)
        candidates = tuple(candidate for candidate in candidates if candidate.name not in TOOL_MARKER_EFFECTS)
    else:
        candidates = tuple(candidate for candidate in candidates if candidate.name not in CAMERA_TIMING_EFFECTS)
    undetermined = ("odometry_scale", *(CLOCK_CONFOUNDED_EFFECTS if untimed else ()))
    candidates = tuple(candidate for candidate in candidates if candidate.name not in undetermined)
    visits = _repeated_pose_corners(placed, base)
    known = noise_of_visits(visits, 1 if on == "tool" else REVISITED_CORNERS_MIN)
    loose = loose_marker(visits, len(frames.markers))
    stated = nominal.sensor_accuracy.corners_px
    if known is None and stated is not None:
        known = _of_two((stated, 0.0))
    noise = known if known is not None else _of_two(saturated_noise(placed, base, candidates, frames.frame_axis_group))
    noise = replace(noise, corner_sigma_px=np.maximum(noise.corner_sigma_px, SIGMA_MIN_PX))
    record = nominal.baseline_remainder("camera", on=on)
    rows, t_s = _seen_corner_rows(frames)
    if on == "ooi":
        rows = replace(
            rows, correlation_group=_posture_groups(link_angles(paths, base, 0, at, frames.t_s))[frames.frame_of_each]
        )
    noise = noise.with_remainder(record)
    off_m = (
        (nominal.sensor_accuracy.layout_m or DEFAULT_MARKER_LAYOUT_SIGMA_M) if record is None else 0.0
    )  # a baseline has them in its remainder
    placed = replace(placed, noise=noise, layout_m=off_m).with_layout(base)
    return [
        Cell(
            stage="camera",
            joint=None,
            unit="px",
            candidates=candidates,
            baseline_parameters=base,
            whitened=placed,
            rows=rows,
            scale=np.hypot(noise.corner_sigma_px, noise.frame_shared_sigma_px)[rows.channel % 2],
            quiet=1.0,
            floor_known=known is not None,
            regressors=(("time", t_s),),
            t_s=t_s,
            loose_target_text="" if loose is None else loose.message(frames.markers[loose.marker_index].marker_id),
        )
    ]


def _of_two(own_and_shared: tuple[float, float]) -> CornerNoise:
    own, shared = own_and_shared
    return CornerNoise(np.full(CORNER_AXIS_COUNT, own), np.full(CORNER_AXIS_COUNT, shared))


def _residual_at_nominal_place(
    rough: CornerResidual, nominal: Nominal, table: MarkerTable, base: ParameterSets
) -> CornerResidual | None:
    """With the object's nominal place: the tool's by the machine file, the OOI's by what was seen."""
    if rough.marker_carrier == "tool":
        T = nominal.T_tcp_tool
        return None if T is None else replace(rough, T_base_ooi=T)
    views = views_of(nominal, table, "ooi")
    if len(views.t_s) < OBJECT_VIEWS_MIN:
        views = one_eye_views(nominal, table, "ooi")
    at = path_index(rough.encoder_paths, views.t_s, CLOCK_OFFSET_MARGIN_S)
    kept = at >= 0
    if int(kept.sum()) < OBJECT_VIEWS_MIN or nominal.arm is None or nominal.T_tcp_cam_left is None:
        return None
    some = np.nonzero(kept)[0][np.unique(np.linspace(0, int(kept.sum()) - 1, FRAMES_MAX).astype(int))]
    q = link_angles(rough.encoder_paths, base, 0, at[some], views.t_s[some])
    Ts = tcp_poses(nominal.arm, without_encoders(base), q) @ nominal.T_tcp_cam_left @ views.Ts_cam_object[some]
    placed = replace(rough, T_base_ooi=mean_pose(Ts))
    for _ in range(3):  # the mean of single poses is coarse: settle on the corners themselves
        nuisance = nuisance_of(placed, base)
        plain = without_encoders(base)
        residual = placed.corner_differences_px(plain, 0, placed.poses(base, plain, 0, 0.0), None, placed.T_base_ooi)
        placed = replace(placed, T_base_ooi=placed.T_base_ooi @ small_motion(-least_squares(nuisance, residual)[:6]))
    return replace(placed, nuisance_jacobian=nuisance_of(placed, base))


def _posture_groups(q: Array) -> NDArray[np.int64]:
    """Numbers of at most POSTURE_CLUSTERS_MAX groups of frames whose joints stand alike, from angles (m, n).

    Why: what a model is wrong by in one posture it is wrong by whenever the arm comes back, so that the frames of one
    posture do not speak for themselves, however far apart in time.
    """
    _, group = kmeans2(q, min(POSTURE_CLUSTERS_MAX, len(q)), minit="++", rng=np.random.default_rng(0))
    return np.unique(group, return_inverse=True)[1].astype(np.int64)


def _seen_corner_rows(frames: Frames) -> tuple[ResidualRows, Array]:
    """Rows by frame; the residual holds only what was seen."""
    seen = np.isfinite(frames.corners_px).reshape(len(frames.t_s), -1)
    whole = rows_of(len(frames.t_s), seen.shape[1])
    kept = seen.ravel()
    cut = replace(
        whole, fold=whole.fold[kept], block=whole.block[kept], series=whole.series[kept], channel=whole.channel[kept]
    )
    return cut, np.repeat(frames.t_s, seen.shape[1])[kept]


def _repeated_pose_corners(placed: CornerResidual, base: ParameterSets) -> list[Array]:
    """Corners (k, C, 2) [px] of each pose that was looked at again, seconds apart.

    Residuals, not corners: a pose that repeats to a millimetre only would look like noise of pixels.
    """
    pixels = placed.camera_frames.corners_px
    if placed.marker_carrier == "tool":
        return [pixels.reshape(len(pixels), -1, 2)]
    flat = pixels.copy()
    flat[np.isfinite(flat)] = placed(base)[0]
    flat = flat.reshape(len(pixels), -1, 2)
    t_s = placed.camera_frames.t_s
    late = [
        link_angles(placed.encoder_paths, base, 0, placed.path_index, t_s + late_s)
        for late_s in (-CAMERA_DELAY_MAX_S, 0.0, CAMERA_DELAY_MAX_S)
    ]
    q = np.stack(late, axis=1)
    visits: list[Array] = []
    left = list(range(len(q)))
    while left:
        first = left.pop(0)
        same = [k for k in left if np.abs(q[k] - q[first]).max() < SAME_POSTURE_TOLERANCE_RAD]
        if any(placed.camera_frames.t_s[k] - placed.camera_frames.t_s[first] > REVISIT_INTERVAL_MIN_S for k in same):
            visits.append(flat[[first, *same]])
        left = [k for k in left if k not in set(same)]
    return visits
