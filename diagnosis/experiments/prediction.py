"""What an experiment would show: its residuals under a hypothesis, predicted with the recording's own floor."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.behind.corner_residual import CornerResidual, Frames, nuisance_of
from diagnosis.behind.link_angles import Path, without_encoders
from diagnosis.behind.point_residual import PointResidual
from diagnosis.behind.points import PointData
from diagnosis.datagrams.sent import SentReference
from diagnosis.experiments.library import LOOK_CYCLE_DURATION_S, SAMPLE_PERIOD_S, Motion, Postures
from diagnosis.known.wander import with_wander
from diagnosis.reading.read import Read
from diagnosis.replay.merge import merge_of, merge_stages
from diagnosis.replay.replayer import Replayer, replayer_of
from diagnosis.replay.stage_replay import Replay, part_of
from diagnosis.replay.stretches import Stretch
from diagnosis.search.candidates import parameter_sets_with
from diagnosis.search.cell import Cell
from diagnosis.search.fit import Fit
from machine.effects.dynamics import DynamicStage, drive_by_sent, simulate
from machine.effects.encoders import true_angles
from machine.effects.layout import ParameterSets
from machine.effects.seen import points_on_links, seen_corners
from machine.effects.structure import link_poses
from machine.poses import transform_points
from machine.rotations import Array

Rows = Callable[[ParameterSets], Array]  # (sets, N) whitened
EXPERIMENT_START_DELAY_S = 100.0  # after the recording
IMAGE_EDGE_MARGIN_PX = 2.0


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Effects at their fitted sizes in one cell, with what the first recording says of the sizes.

    `sqrt_information`: (k, k), rows that a deviation from theta costs there, whitened.
    """

    fit: Fit
    sqrt_information: Array


def hypothesis_at_fit(found: Fit, spread: float) -> Hypothesis:
    """A fit as a hypothesis: |R (theta - theta_fit)|^2 is what it costs on the recording to move away."""
    if found.k == 0:
        return Hypothesis(found, np.zeros((0, 0)))
    R = np.linalg.qr(found.J / np.sqrt(spread), mode="r")
    return Hypothesis(found, np.asarray(R, dtype=float))


def sets_of(cell: Cell, hypothesis: Hypothesis) -> ParameterSets:
    """The parameters of a hypothesis, on the baseline."""
    return parameter_sets_with(cell.baseline_parameters, hypothesis.fit.hypothesis, hypothesis.fit.theta)


def rows_of_motion(whole: Read, cell: Cell, motion: Motion, truth: ParameterSets) -> Rows | None:
    """The cell's residuals on a motion if `truth` were the machine's parameters; None where it cannot be simulated."""
    replay = cell.whitened
    replayer = replayer_of(whole.nominal_machine, whole.stretches) if whole.nominal_machine is not None else None
    if not isinstance(replay, Replay) or replayer is None or not replayer.nominal_machine.has_controller:
        return None
    stretch = _predicted_motion_log(whole, replayer, motion, truth)
    merge = merge_of(whole.stretches)
    if merge is not None and cell.stage == "actuator":
        prepared = merge_stages(replayer, stretch, merge, cell.baseline_parameters)
    else:
        prepared = replayer.prepare(stretch, cell.baseline_parameters)
    if prepared is None or replay.stage not in prepared.stage_inputs:
        return None
    plain = replace(
        replay, stretch_replays=(part_of(replay.stage, prepared, list(replay.joints), replayer),), day_to_day_noise=None
    )
    (there,) = with_wander([replace(cell, whitened=plain)], replayer.nominal_machine)  # it goes along with the motion
    return there.whitened


def _predicted_motion_log(whole: Read, replayer: Replayer, motion: Motion, truth: ParameterSets) -> Stretch:
    """The log of a motion: the signals that the recording has, at its rate."""
    like = whole.stretches[0]
    plant = replayer.at_rate(like.dt_s)
    t_sent = np.asarray(SAMPLE_PERIOD_S * np.arange(len(motion.q)), dtype=float)
    rows = int(len(motion.q) * SAMPLE_PERIOD_S / plant.log_cycle_s)
    t_log = np.asarray(plant.log_cycle_s * np.arange(rows), dtype=float)
    q_log = np.stack([np.interp(t_log, t_sent, column) for column in motion.q.T], axis=1)
    cycles = (rows - 1) * plant.cycles_per_row + 1
    drive = drive_by_sent(plant, t_sent, motion.q, 0.0, cycles, replayer.loads_along(q_log))
    out = simulate(plant, truth, drive, DynamicStage.ACTUATOR)
    ref, u = (None if getattr(like, name) is None else getattr(out, name)[0] for name in ("ref", "u"))
    sent = None if like.sent_reference is None else SentReference(t_sent, motion.q)
    return Stretch(motion.name, motion.segment_kind, "", 0.0, plant.log_cycle_s, t_log, ref, out.enc[0], u, sent)


def residuals_with_postures(whole: Read, cell: Cell, postures: Postures, truth: ParameterSets) -> Rows | None:
    """Residuals of the cell's looks or points together with those from more postures; None where it has neither."""
    parts = cell.joined_cells or (cell,)
    extended = [_rows_with_postures(part, postures, truth) for part in parts]
    if all(residual is None for residual in extended):
        return None
    rows = [part.whitened if more is None else more for part, more in zip(parts, extended, strict=True)]
    return lambda sets: np.concatenate([row(sets) for row in rows], axis=1)


def _rows_with_postures(part: Cell, postures: Postures, truth: ParameterSets) -> Rows | None:
    if isinstance(part.whitened, CornerResidual) and part.whitened.marker_carrier == "ooi":
        return _more_frames(part.whitened, part.baseline_parameters, postures, truth)
    if isinstance(part.whitened, PointResidual):
        return _more_points(part.whitened, postures, truth)
    return None


def _more_frames(seen: CornerResidual, base: ParameterSets, postures: Postures, truth: ParameterSets) -> Rows | None:
    """Corners of the recording and, as `truth` predicts them, from more postures; the object has one place in both."""
    camera = seen.nominal_machine.camera
    if camera is None:
        return None
    q = postures.q
    t_s, course = _look_times_and_path(q, max((float(path.t_s[-1]) for path in seen.encoder_paths), default=0.0))
    at = np.full(len(q), len(seen.encoder_paths), dtype=np.int64)
    blank = np.full((len(q), *seen.camera_frames.corners_px.shape[1:]), np.nan)
    alone = replace(
        seen,
        camera_frames=Frames.with_groups(t_s, blank, seen.camera_frames.markers),
        encoder_paths=(*seen.encoder_paths, course),
        path_index=at,
    )
    plain = without_encoders(truth)
    Ts = _still_poses(alone, truth, plain)
    corners = seen_corners(plain, camera, seen.camera_frames.markers, Ts @ seen.T_base_ooi)
    pixels = _in_picture(np.stack([corners.left_px, corners.right_px], axis=1), camera.width_px, camera.height_px)
    pixels[:, ~np.isfinite(seen.camera_frames.corners_px).any(axis=(0, 2, 3, 4))] = (
        np.nan
    )  # an eye that never saw anything
    if not np.isfinite(pixels).any():
        return None
    frames = Frames.with_groups(
        np.concatenate([seen.camera_frames.t_s, t_s]),
        np.concatenate([seen.camera_frames.corners_px, pixels]),
        seen.camera_frames.markers,
    )
    more = replace(alone, camera_frames=frames, path_index=np.concatenate([seen.path_index, at]))
    return replace(more, nuisance_jacobian=nuisance_of(more, base)).with_layout(base)


def _look_times_and_path(q: Array, end_s: float) -> tuple[Array, Path]:
    """When each posture (k, n) is looked from (k,) [s], and the encoders' course: at rest around each look."""
    start = np.asarray(end_s + EXPERIMENT_START_DELAY_S + LOOK_CYCLE_DURATION_S * np.arange(len(q)), dtype=float)
    t_s = np.asarray((start[:, None] + np.array([0.0, 0.5 * LOOK_CYCLE_DURATION_S])).ravel(), dtype=float)
    return start + 0.25 * LOOK_CYCLE_DURATION_S, Path(t_s, np.repeat(q, 2, axis=0), None)


def _still_poses(alone: CornerResidual, truth: ParameterSets, plain: ParameterSets) -> Array:
    """Ts_cam_base at rest: the camera's clock does not matter there."""
    still = ParameterSets(truth.joint_parameters.copy(), truth.machine_parameters.copy())
    return alone.poses(still, plain, 0, 0.0)


def _in_picture(pixels: Array, width: int, height: int) -> Array:
    """Corners (m, eyes, markers, 4, 2); NaN for markers that are not whole in the picture."""
    inside = (pixels > IMAGE_EDGE_MARGIN_PX) & (pixels < np.array([width, height]) - IMAGE_EDGE_MARGIN_PX)
    whole = np.asarray(np.logical_and(np.isfinite(pixels), inside).all(axis=(3, 4)))
    return np.where(whole[..., None, None], pixels, np.nan)


def _more_points(measured: PointResidual, postures: Postures, truth: ParameterSets) -> Rows | None:
    """Points of the recording and, as `truth` predicts them, from more postures."""
    nominal, data = measured.nominal_machine, measured.measured_points
    known = [
        k for k, point in enumerate(nominal.tracked_points) if point.xyz_m is not None and (data.point_index == k).any()
    ]
    if nominal.arm is None or nominal.T_base_tracker is None or not known:
        return None
    q = np.repeat(postures.q, len(known), axis=0)
    which = np.tile(np.array(known, dtype=np.int64), len(postures.q))
    links = link_poses(nominal.arm, without_encoders(truth), true_angles(truth, postures.q))
    joints = np.array([nominal.tracked_points[k].joint for k in known])
    places = np.array([nominal.tracked_points[k].xyz_m for k in known], dtype=float)
    base = points_on_links(links, joints, places).reshape(-1, 3)
    T = np.asarray(np.linalg.inv(nominal.T_base_tracker), dtype=float)
    xyz = transform_points(T, base)
    looked, course = _look_times_and_path(
        postures.q, max((float(path.t_s[-1]) for path in measured.encoder_paths), default=0.0)
    )
    when = np.repeat(looked, len(known))
    more = PointData(
        np.concatenate([data.q, q]),
        np.concatenate([data.point_index, which]),
        np.concatenate([data.xyz, xyz]),
        np.concatenate([data.time_or_pose_index, when]),
    )
    paths = (*measured.encoder_paths, course) if measured.encoder_paths else ()
    at = np.concatenate([measured.path_index, np.full(len(q), len(measured.encoder_paths), dtype=np.int64)])
    noise = measured.noise.with_more(np.hypot(base[:, 0], base[:, 1]), len(known))
    wrong = (
        None
        if measured.known_model_error_m is None
        else np.concatenate([measured.known_model_error_m, np.zeros(3 * len(q))])
    )
    return replace(
        measured, measured_points=more, encoder_paths=paths, path_index=at, noise=noise, known_model_error_m=wrong
    )
