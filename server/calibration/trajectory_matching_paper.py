"""Trajectory matching as the paper has it: coarse frame alignment, then hybrid mixture matching of two pose sets."""

import numpy as np
from numpy.typing import NDArray

from machine.rotations import geodesic_angle, nearest_rotation
from server.calibration.checks import require_rotation, require_track_shape
from server.calibration.chords import arc_lengths, observability, rotation_information
from server.calibration.contracts import (
    Array,
    CalibrationStatus,
    CameraRotationEstimate,
    CameraTrack,
    EncoderTrack,
)
from server.calibration.hybrid_mixture import MixtureMatch, MixtureSettings, register_poses
from server.calibration.trajectory_matching_refusals import Refusal, time_refusal, usable_poses

METHOD_NAME = "paper"
DEFAULT_MIXTURE_SETTINGS = MixtureSettings()
_POSES_MAX = 100
_PATH_LENGTH_MIN_M = 0.15
_OBSERVABILITY_MIN = 0.001  # the paper's own path, nearly a line, has 0.008
_PAIRED_MIN_FRAC = 0.88  # a mirrored flat path pairs less
_GAP_RELATIVE_MAX = 0.08
_FROM_ASSUMED_MAX_RAD = float(np.deg2rad(25.0))


def coarse_frame_alignment(R_base_tcp: Array, R_tcp_cam_assumed: Array, R_vo_cam: Array) -> Array:
    """R_cfa of eq. 20: odometry turned into the base by one pose, with "camera axes = TCP axes" (nominal mount)."""
    return R_base_tcp @ R_tcp_cam_assumed @ R_vo_cam.T


def estimate_camera_rotation_paper(
    camera: CameraTrack,
    encoder: EncoderTrack,
    R_tcp_cam_assumed: Array,
    settings: MixtureSettings = DEFAULT_MIXTURE_SETTINGS,
) -> CameraRotationEstimate:
    """The camera's rotation against the TCP by the paper's point set matching: no time offset, no lever arm.

    Model:   y = coarsely aligned camera poses R_cfa (x_vo, R_vo_cam), x = TCP poses (p_base_tcp, R_base_tcp
             R_tcp_cam_assumed); R_fm from the hybrid mixture; R_lc = R_fm R_cfa (20) maps camera vectors of the
             odometry's start to base.
    Note:    the axes of both sets are taken as equal, so with the orientation held the match returns the assumed mount:
             its true tilt is not found (the paper's first-move error). `settings.use_axes = False` is the
             positions-only form.
    Args:    camera, encoder: tracks; R_tcp_cam_assumed: the mount as assumed (nominal) (3, 3).
    Returns: the estimate; covariance from the residuals over the path's information, as if all poses were independent.
    Source:  Makinen et al. 2023, section 3.2.2, eq. 20; Min, Wang, Meng 2018.
    """
    require_track_shape(camera.t_s, camera.Ts_vo_cam, "camera track")
    require_track_shape(encoder.t_s, encoder.Ts_base_tcp, "encoder track")
    R_assumed = require_rotation(R_tcp_cam_assumed, "R_tcp_cam_assumed")
    wrong_time = time_refusal(camera.t_s, "camera track") or time_refusal(encoder.t_s, "encoder track")
    if wrong_time is not None:
        return wrong_time.estimate(METHOD_NAME, 0.0)
    Ts_vo, Ts_tcp = _thin_poses(camera.Ts_vo_cam), _thin_poses(encoder.Ts_base_tcp)
    length = float(arc_lengths(Ts_tcp[:, :3, 3])[-1]) if len(Ts_tcp) > 1 else 0.0
    if min(len(Ts_vo), len(Ts_tcp)) < 12:
        counts = f"{len(Ts_vo)} camera and {len(Ts_tcp)} encoder poses, at least 12 of each are needed"
        return Refusal(CalibrationStatus.TOO_FEW, f"{counts}; record both streams").estimate(METHOD_NAME, length)
    if length < _PATH_LENGTH_MIN_M:
        text = f"path of {1e3 * length:.0f} mm, at least {1e3 * _PATH_LENGTH_MIN_M:.0f} mm needed; run a longer path"
        return Refusal(CalibrationStatus.DEGENERATE, text).estimate(METHOD_NAME, length)
    refusal = _shape_refusal(Ts_vo[:, :3, 3], Ts_tcp[:, :3, 3])
    if refusal is not None:
        return refusal.estimate(METHOD_NAME, length)
    R_cfa = coarse_frame_alignment(Ts_tcp[0, :3, :3], R_assumed, Ts_vo[0, :3, :3])
    match = register_poses(
        points_x=Ts_tcp[:, :3, 3],
        Rs_x=Ts_tcp[:, :3, :3] @ R_assumed,
        points_y=Ts_vo[:, :3, 3] @ R_cfa.T,
        Rs_y=R_cfa @ Ts_vo[:, :3, :3],
        settings=settings,
    )
    found = _estimate_from_match(match, R_cfa, Ts_vo, Ts_tcp, length)
    return found.estimate(METHOD_NAME, length) if isinstance(found, Refusal) else found


def _thin_poses(Ts: Array) -> Array:
    """At most `_POSES_MAX` usable poses, evenly along the path: standing still must not weigh more than moving."""
    poses = np.asarray(Ts, dtype=float)
    poses = poses[usable_poses(poses)]
    if len(poses) <= 2:
        return poses
    return poses[evenly_along(poses[:, :3, 3], _POSES_MAX)]


def evenly_along(points: Array, count_max: int) -> NDArray[np.int64]:
    """Indices of at most `count_max` points (n, 3), evenly along the path; the path's length is taken without jumps."""
    padded = np.concatenate((points[:1], points[:1], points, points[-1:], points[-1:]))
    calm = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0), axis=-1)
    s = arc_lengths(calm)
    picks = np.searchsorted(s, np.linspace(0.0, s[-1], min(count_max, len(points))))
    return np.unique(np.clip(picks, 0, len(points) - 1)).astype(np.int64)


def _shape_refusal(points_vo: Array, points_tcp: Array) -> Refusal | None:
    """Both paths must spread in two directions: a line, or an odometry that stood still, says nothing of a rotation."""
    for points, name in ((points_tcp, "encoder"), (points_vo, "camera")):
        centred = points - points.mean(axis=0)
        seen = observability(rotation_information(centred, np.ones(len(centred))))
        if arc_lengths(points)[-1] < 0.5 * _PATH_LENGTH_MIN_M or not seen >= _OBSERVABILITY_MIN:
            text = f"the {name} path is nearly a point or a straight line (observability {seen:.4f}"
            text = f"{text}, limit {_OBSERVABILITY_MIN}); run a folded path"
            return Refusal(CalibrationStatus.DEGENERATE, text, observability=seen)
    return None


def _fit_refusal(match: MixtureMatch, points_tcp: Array, gaps: Array) -> Refusal | None:
    """Sets that do not lie on each other: most poses taken as outliers, or a mirrored or foreign set."""
    extent = float(np.linalg.norm(points_tcp - points_tcp.mean(axis=0), axis=1).max())
    paired = float(np.mean(match.pairing_probabilities.sum(axis=0)))
    relative = max(float(np.median(gaps)), match.sigma_m) / extent
    if not (paired >= _PAIRED_MIN_FRAC and relative <= _GAP_RELATIVE_MAX and np.isfinite(match.R_x_y).all()):
        text = f"the pose sets do not fit: {100 * paired:.0f} % paired, gap {relative:.2f} of the extent"
        limits = f"limits {100 * _PAIRED_MIN_FRAC:.0f} % and {_GAP_RELATIVE_MAX}"
        return Refusal(CalibrationStatus.POOR_FIT, f"{text}, {limits}; check odometry and mounting, run the path again")
    turned = geodesic_angle(match.R_x_y, np.eye(3))
    if not turned <= _FROM_ASSUMED_MAX_RAD:
        text = f"the match turns the coarse alignment by {np.rad2deg(turned):.0f} deg (mirrored?)"
        limit = f"limit {np.rad2deg(_FROM_ASSUMED_MAX_RAD):.0f}"
        return Refusal(CalibrationStatus.POOR_FIT, f"{text}, {limit}; check odometry and mounting")
    return None


def _estimate_from_match(
    match: MixtureMatch, R_cfa: Array, Ts_vo: Array, Ts_tcp: Array, length_m: float
) -> CameraRotationEstimate | Refusal:
    R_lc = match.R_x_y @ R_cfa  # eq. 20
    R_base_cam = nearest_rotation((R_lc @ Ts_vo[:, :3, :3]).mean(axis=0))
    R_base_tcp = nearest_rotation(Ts_tcp[:, :3, :3].mean(axis=0))
    centred = Ts_tcp[:, :3, 3] - Ts_tcp[:, :3, 3].mean(axis=0)
    information = rotation_information(centred, np.ones(len(centred)))
    information_total = information / match.sigma_m**2 + 2.0 * match.vmf_concentration * len(Ts_vo) * np.eye(3)
    moved = Ts_vo[:, :3, 3] @ R_lc.T + match.t_x_y
    gaps = np.linalg.norm(moved[:, None] - Ts_tcp[None, :, :3, 3], axis=2).min(axis=1)
    refusal = _fit_refusal(match, Ts_tcp[:, :3, 3], gaps)
    if refusal is not None:
        return refusal
    return CameraRotationEstimate(
        status=CalibrationStatus.OK,
        reason="",
        method=METHOD_NAME,
        R_tcp_cam=R_base_tcp.T @ R_base_cam,
        covariance=R_base_tcp.T @ np.linalg.inv(information_total) @ R_base_tcp,
        time_offset_s=0.0,
        residual_rms_mm=float(1e3 * np.sqrt(np.mean(gaps**2))),
        residual_max_mm=float(1e3 * gaps.max()),
        n_used=int(match.pairing_probabilities.sum()),
        observability=observability(information),
        path_length_m=length_m,
    )
