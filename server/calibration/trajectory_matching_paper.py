"""Trajectory matching as the paper has it: coarse frame alignment, then hybrid mixture matching of two pose sets."""

import numpy as np

from machine.rotations import nearest_rotation
from server.calibration.checks import require_rotation, require_track
from server.calibration.chord_covariance import observability, rotation_information
from server.calibration.chords import arc_lengths
from server.calibration.contracts import (
    Array,
    CalibrationStatus,
    CameraRotationEstimate,
    CameraTrack,
    EncoderTrack,
)
from server.calibration.hybrid_mixture import MixtureMatch, MixtureSettings, register_poses

METHOD = "paper"
DEFAULT_SETTINGS = MixtureSettings()
_POSES_MAX = 100
_PATH_LENGTH_MIN_M = 0.15


def coarse_frame_alignment(R_base_tcp: Array, R_tcp_cam_assumed: Array, R_vo_cam: Array) -> Array:
    """R_cfa of eq. 20: odometry turned into the base by one pose, with "camera axes = TCP axes" (nominal mount)."""
    return R_base_tcp @ R_tcp_cam_assumed @ R_vo_cam.T


def estimate_camera_rotation_paper(
    camera: CameraTrack,
    encoder: EncoderTrack,
    R_tcp_cam_assumed: Array,
    settings: MixtureSettings = DEFAULT_SETTINGS,
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
    Raises:  CalibrationInputError: shapes, times running backwards, no rotation.
    Source:  Makinen et al. 2023, section 3.2.2, eq. 20; Min, Wang, Meng 2018.
    """
    require_track(camera.t_s, camera.Ts_vo_cam, "camera track")
    require_track(encoder.t_s, encoder.Ts_base_tcp, "encoder track")
    R_assumed = require_rotation(R_tcp_cam_assumed, "R_tcp_cam_assumed")
    Ts_vo, Ts_tcp = _thinned(camera.Ts_vo_cam), _thinned(encoder.Ts_base_tcp)
    length = float(arc_lengths(Ts_tcp[:, :3, 3])[-1]) if len(Ts_tcp) > 1 else 0.0
    if min(len(Ts_vo), len(Ts_tcp)) < 12:
        counts = f"{len(Ts_vo)} camera and {len(Ts_tcp)} encoder poses, at least 12 of each are needed"
        return _refused(CalibrationStatus.TOO_FEW, f"{counts}; record both streams", length)
    if length < _PATH_LENGTH_MIN_M:
        text = f"path of {1e3 * length:.0f} mm, at least {1e3 * _PATH_LENGTH_MIN_M:.0f} mm needed; run a longer path"
        return _refused(CalibrationStatus.DEGENERATE, text, length)
    R_cfa = coarse_frame_alignment(Ts_tcp[0, :3, :3], R_assumed, Ts_vo[0, :3, :3])
    match = register_poses(
        points_x=Ts_tcp[:, :3, 3],
        Rs_x=Ts_tcp[:, :3, :3] @ R_assumed,
        points_y=Ts_vo[:, :3, 3] @ R_cfa.T,
        Rs_y=R_cfa @ Ts_vo[:, :3, :3],
        settings=settings,
    )
    return _estimate(match, R_cfa, Ts_vo, Ts_tcp, length)


def _thinned(Ts: Array) -> Array:
    """At most `_POSES_MAX` finite poses, evenly along the path: standing still must not weigh more than moving."""
    poses = np.asarray(Ts, dtype=float)
    poses = poses[np.isfinite(poses).all(axis=(1, 2))]
    if len(poses) <= 2:
        return poses
    s = arc_lengths(poses[:, :3, 3])
    picks = np.searchsorted(s, np.linspace(0.0, s[-1], min(_POSES_MAX, len(poses))))
    return poses[np.unique(np.clip(picks, 0, len(poses) - 1))]


def _refused(status: CalibrationStatus, reason: str, length_m: float) -> CameraRotationEstimate:
    nan = float("nan")
    return CameraRotationEstimate(status, reason, METHOD, None, None, 0.0, nan, nan, 0, 0.0, length_m)


def _estimate(
    match: MixtureMatch, R_cfa: Array, Ts_vo: Array, Ts_tcp: Array, length_m: float
) -> CameraRotationEstimate:
    R_lc = match.R_x_y @ R_cfa  # eq. 20
    R_base_cam = nearest_rotation((R_lc @ Ts_vo[:, :3, :3]).mean(axis=0))
    R_base_tcp = nearest_rotation(Ts_tcp[:, :3, :3].mean(axis=0))
    centred = Ts_tcp[:, :3, 3] - Ts_tcp[:, :3, 3].mean(axis=0)
    information = rotation_information(centred, np.ones(len(centred)))
    information_total = information / match.sigma_m**2 + 2.0 * match.kappa * len(Ts_vo) * np.eye(3)
    moved = Ts_vo[:, :3, 3] @ R_lc.T + match.t_x_y
    gaps = np.linalg.norm(moved[:, None] - Ts_tcp[None, :, :3, 3], axis=2).min(axis=1)
    return CameraRotationEstimate(
        status=CalibrationStatus.OK,
        reason="",
        method=METHOD,
        R_tcp_cam=R_base_tcp.T @ R_base_cam,
        covariance=R_base_tcp.T @ np.linalg.inv(information_total) @ R_base_tcp,
        time_offset_s=0.0,
        residual_rms_mm=float(1e3 * np.sqrt(np.mean(gaps**2))),
        residual_max_mm=float(1e3 * gaps.max()),
        n_used=int(match.pairing.sum()),
        observability=observability(information),
        path_length_m=length_m,
    )
