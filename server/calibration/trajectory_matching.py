"""Trajectory matching, the default: the camera's rotation from time-stamped chords, fused with its known mounting."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from machine.rotations import geodesic_angle, nearest_rotation
from server.calibration.checks import require_covariance, require_pose, require_rotation, require_track
from server.calibration.chord_covariance import fit_noise, observability, rotation_covariance, rotation_information
from server.calibration.chords import ChordPairs, arc_lengths, chord_pairs, chord_vectors
from server.calibration.contracts import (
    Array,
    CalibrationStatus,
    CameraRotationEstimate,
    CameraTrack,
    EncoderTrack,
    MountRotation,
)
from server.calibration.fusion import fuse_rotations
from server.calibration.rotation_fit import RotationFit, fit_rotation
from server.calibration.time_offset import TimeOffset, find_time_offset, positions_at

METHOD = "chords"


@dataclass(frozen=True, slots=True)
class MatchingSettings:
    """What the chord method uses and what it refuses."""

    chord_m: float = 0.08
    time_offset_bound_s: float = 0.25
    time_offset_step_s: float = 0.025
    time_offset_contrast_min: float = 0.05
    path_length_min_m: float = 0.15
    extent_min_m: float = 0.05  # largest distance from the path's middle; a smaller path says nothing
    chords_min: int = 12
    observability_min: float = 0.02
    residual_relative_max: float = 0.15  # robust one-axis residual over the mean chord length
    inliers_min_frac: float = 0.5
    scale_error_max_frac: float = 0.10
    from_nominal_max_rad: float = float(np.deg2rad(25.0))
    sigma_max_rad: float = float(np.deg2rad(4.0))
    sigma_model_rad: float = float(np.deg2rad(0.25))  # kinematics and bending along the path, which no residual shows


DEFAULT_SETTINGS = MatchingSettings()


@dataclass(frozen=True, slots=True)
class _Tracks:
    """Both tracks ready for chords: the camera by odometry, and by kinematics through the nominal mount."""

    t_cam_s: Array
    Ts_vo_cam: Array
    t_enc_s: Array
    Rs_base_tcp: Array
    points_base: Array

    @property
    def points_vo(self) -> Array:
        return self.Ts_vo_cam[:, :3, 3]


def estimate_camera_rotation(
    camera: CameraTrack,
    encoder: EncoderTrack,
    T_tcp_cam_nominal: Array,
    prior: MountRotation | None = None,
    settings: MatchingSettings = DEFAULT_SETTINGS,
) -> CameraRotationEstimate:
    """The camera's rotation against the TCP, as the machine's own motion shows it here and now.

    Model:   chords dy = R_base_vo dx over ~8 cm of path, dx from odometry, dy from the camera by kinematics,
             p_base_cam = (T_base_tcp T_tcp_cam_nominal).p, at the camera's times plus the offset found; robust Kabsch;
             R_tcp_cam = mean over t of R_base_tcp^T R_base_vo R_vo_cam; fused with the prior by covariance.
             Replaces eq. 20's R_fm R_cfa; "camera axes = TCP axes" is never assumed.
    Args:    camera, encoder: tracks on the PC clock; T_tcp_cam_nominal: its lever arm and, for refusal, its rotation
             are used (4, 4); prior: from the tool marker, or None.
    Returns: the estimate; a status with its reason and no rotation when the path cannot tell.
    Raises:  CalibrationInputError: shapes, times running backwards, or no rotation.
    Source:  Makinen et al. 2023, eq. 17-22, with chords in place of the point set matching.
    """
    require_track(camera.t_s, camera.Ts_vo_cam, "camera track")
    require_track(encoder.t_s, encoder.Ts_base_tcp, "encoder track")
    T_tcp_cam = require_pose(T_tcp_cam_nominal, "T_tcp_cam_nominal")
    if prior is not None:
        require_rotation(prior.R_tcp_cam, "prior.R_tcp_cam")
        require_covariance(prior.covariance, 3, "prior.covariance")
    tracks = _prepare(camera, encoder, T_tcp_cam)
    refusal = _path_refusal(tracks, settings)
    if refusal is not None:
        return refusal
    pairs = chord_pairs(_points_at(tracks, 0.0), settings.chord_m)
    offset = _offset(tracks, pairs, settings)
    return _match(tracks, pairs, offset, T_tcp_cam[:3, :3], prior, settings)


def _prepare(camera: CameraTrack, encoder: EncoderTrack, T_tcp_cam: Array) -> _Tracks:
    Ts_vo, Ts_enc = np.asarray(camera.Ts_vo_cam, dtype=float), np.asarray(encoder.Ts_base_tcp, dtype=float)
    t_cam, t_enc = np.asarray(camera.t_s, dtype=float), np.asarray(encoder.t_s, dtype=float)
    good_vo, good_enc = np.isfinite(Ts_vo).all(axis=(1, 2)), np.isfinite(Ts_enc).all(axis=(1, 2))
    Ts_vo, t_cam, Ts_enc, t_enc = Ts_vo[good_vo], t_cam[good_vo], Ts_enc[good_enc], t_enc[good_enc]
    if len(t_enc) >= 2:
        inside = (t_cam >= t_enc[0]) & (t_cam <= t_enc[-1])
        Ts_vo, t_cam = Ts_vo[inside], t_cam[inside]
    points = Ts_enc[:, :3, 3] + Ts_enc[:, :3, :3] @ T_tcp_cam[:3, 3]
    return _Tracks(t_cam, Ts_vo, t_enc, Ts_enc[:, :3, :3], points)


def _points_at(tracks: _Tracks, offset_s: float) -> Array:
    return positions_at(tracks.t_cam_s + offset_s, tracks.t_enc_s, tracks.points_base)[0]


def _refused(status: CalibrationStatus, reason: str, tracks: _Tracks, n_used: int = 0, observable: float = 0.0):
    length = float(arc_lengths(tracks.points_base)[-1]) if len(tracks.points_base) > 1 else 0.0
    return CameraRotationEstimate(
        status=status,
        reason=reason,
        method=METHOD,
        R_tcp_cam=None,
        covariance=None,
        time_offset_s=0.0,
        residual_rms_mm=float("nan"),
        residual_max_mm=float("nan"),
        n_used=n_used,
        observability=observable,
        path_length_m=length,
    )


def _path_refusal(tracks: _Tracks, settings: MatchingSettings) -> CameraRotationEstimate | None:
    if len(tracks.t_cam_s) < settings.chords_min or len(tracks.t_enc_s) < settings.chords_min:
        counts = f"{len(tracks.t_cam_s)} camera and {len(tracks.t_enc_s)} encoder poses overlap in time"
        return _refused(
            CalibrationStatus.TOO_FEW,
            f"{counts}, at least {settings.chords_min} are needed; record both streams",
            tracks,
        )
    points = _points_at(tracks, 0.0)
    extent = float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())
    length = float(arc_lengths(points)[-1])
    if extent < settings.extent_min_m or length < settings.path_length_min_m:
        moved = f"the path reaches {1e3 * extent:.0f} mm from its middle over {1e3 * length:.0f} mm of length"
        limits = f"limits {1e3 * settings.extent_min_m:.0f} mm and {1e3 * settings.path_length_min_m:.0f} mm"
        return _refused(CalibrationStatus.DEGENERATE, f"{moved}, {limits}; run a longer calibration path", tracks)
    return None


def _offset(tracks: _Tracks, pairs: ChordPairs, settings: MatchingSettings) -> TimeOffset:
    return find_time_offset(
        tracks.t_cam_s,
        tracks.points_vo,
        tracks.t_enc_s,
        tracks.points_base,
        pairs,
        settings.time_offset_bound_s,
        settings.time_offset_step_s,
        settings.time_offset_contrast_min,
    )


def _match(
    tracks: _Tracks,
    pairs: ChordPairs,
    offset: TimeOffset,
    R_nominal: Array,
    prior: MountRotation | None,
    settings: MatchingSettings,
) -> CameraRotationEstimate:
    points, inside = positions_at(tracks.t_cam_s + offset.offset_s, tracks.t_enc_s, tracks.points_base)
    keep = inside[pairs.first] & inside[pairs.last]
    pairs = ChordPairs(pairs.first[keep], pairs.last[keep])
    if len(pairs) < settings.chords_min:
        need = f"{len(pairs)} chords of {1e3 * settings.chord_m:.0f} mm, at least {settings.chords_min} are needed"
        return _refused(CalibrationStatus.TOO_FEW, f"{need}; run a longer path or more frames", tracks, len(pairs))
    chords_base, chords_vo = chord_vectors(points, pairs), chord_vectors(tracks.points_vo, pairs)
    fit = fit_rotation(chords_base, chords_vo)
    seen = _observability(chords_base, chords_vo, fit)
    R_tcp_cam, R_base_tcp = _mount_from(tracks, offset.offset_s, fit.R_a_b)
    refusal = _fit_refusal(fit, chords_base, seen, geodesic_angle(R_nominal, R_tcp_cam), tracks, settings)
    if refusal is not None:
        return refusal
    covariance = _covariance(points, tracks.points_vo, pairs, fit, R_base_tcp, settings)
    mount, notes = _fused(MountRotation(R_tcp_cam, covariance), prior)
    sigma_max = float(np.sqrt(np.linalg.eigvalsh(mount.covariance)[-1]))
    if sigma_max > settings.sigma_max_rad:
        limit = np.rad2deg(settings.sigma_max_rad)
        reason = f"rotation known to {np.rad2deg(sigma_max):.1f} deg only, limit {limit:.1f} deg"
        return _refused(
            CalibrationStatus.POOR_FIT, f"{reason}; run a longer, more folded path", tracks, len(pairs), seen
        )
    norms_mm = 1e3 * np.linalg.norm(fit.residuals, axis=1)
    return CameraRotationEstimate(
        status=CalibrationStatus.OK,
        reason="; ".join([*notes, *_offset_notes(offset, settings)]),
        method=METHOD if prior is None else f"{METHOD}+tool_marker",
        R_tcp_cam=mount.R_tcp_cam,
        covariance=mount.covariance,
        time_offset_s=offset.offset_s,
        residual_rms_mm=float(np.sqrt(np.mean(norms_mm[fit.weights > 0.25] ** 2))),
        residual_max_mm=float(norms_mm.max()),
        n_used=int(np.sum(fit.weights > 0.25)),
        observability=seen,
        path_length_m=float(arc_lengths(points)[-1]),
    )


def _observability(chords_base: Array, chords_vo: Array, fit: RotationFit) -> float:
    return min(observability(rotation_information(chords, fit.weights)) for chords in (chords_base, chords_vo))


def _mount_from(tracks: _Tracks, offset_s: float, R_base_vo: Array) -> tuple[Array, Array]:
    """R_tcp_cam as the mean over the track, and the TCP's mean rotation in base."""
    t = np.clip(tracks.t_cam_s + offset_s, tracks.t_enc_s[0], tracks.t_enc_s[-1])
    Rs_base_tcp = Slerp(tracks.t_enc_s, Rotation.from_matrix(tracks.Rs_base_tcp))(t).as_matrix()
    Rs_tcp_cam = Rs_base_tcp.transpose(0, 2, 1) @ R_base_vo @ tracks.Ts_vo_cam[:, :3, :3]
    return nearest_rotation(Rs_tcp_cam.mean(axis=0)), nearest_rotation(Rs_base_tcp.mean(axis=0))


def _fit_refusal(
    fit: RotationFit, chords: Array, seen: float, from_nominal_rad: float, tracks: _Tracks, settings: MatchingSettings
) -> CameraRotationEstimate | None:
    n = len(chords)
    if seen < settings.observability_min:
        line = f"the path is nearly a straight line (observability {seen:.3f}, limit {settings.observability_min})"
        return _refused(CalibrationStatus.DEGENERATE, f"{line}; run a folded path", tracks, n, seen)
    relative = fit.sigma_m / float(np.linalg.norm(chords, axis=1).mean())
    inliers = float(np.mean(np.linalg.norm(fit.residuals, axis=1) < 5.0 * max(fit.sigma_m, 1e-4)))
    texts = (
        (relative, settings.residual_relative_max, "the tracks do not fit each other: residual over chord"),
        (1.0 - inliers, 1.0 - settings.inliers_min_frac, "too many chords disagree: share"),
        (abs(fit.scale - 1.0), settings.scale_error_max_frac, "odometry scale is wrong: departure from 1"),
        (
            from_nominal_rad,
            settings.from_nominal_max_rad,
            "camera far from its nominal mounting (mirrored?): angle [rad]",
        ),
    )
    for value, limit, text in texts:
        if value > limit:
            remedy = "check odometry, baseline and mounting, then run the path again"
            return _refused(
                CalibrationStatus.POOR_FIT, f"{text} {value:.2f}, limit {limit:.2f}; {remedy}", tracks, n, seen
            )
    return None


def _covariance(
    points: Array, points_vo: Array, pairs: ChordPairs, fit: RotationFit, R_base_tcp: Array, settings: MatchingSettings
) -> Array:
    """Covariance of R_tcp_cam, left perturbation, TCP axes (3, 3) [rad^2]."""
    rotated = fit.scale * chord_vectors(points_vo, pairs) @ fit.R_a_b.T
    arc = arc_lengths(points)
    moving = np.diff(arc) > 0.002 * settings.chord_m
    step_residuals = np.diff(points, axis=0) - fit.scale * np.diff(points_vo, axis=0) @ fit.R_a_b.T
    chord_m = float(np.mean(arc[pairs.last] - arc[pairs.first]))
    drift, jitter = fit_noise(np.diff(arc)[moving], step_residuals[moving], chord_m, fit.sigma_m)
    in_base = rotation_covariance(rotated, fit.weights, pairs, np.diff(arc), drift, jitter)
    return R_base_tcp.T @ in_base @ R_base_tcp + settings.sigma_model_rad**2 * np.eye(3)


def _fused(data: MountRotation, prior: MountRotation | None) -> tuple[MountRotation, list[str]]:
    if prior is None:
        return data, []
    fused = fuse_rotations(data, prior)
    note = f"odometry and tool marker disagree (chi2 {fused.chi2:.0f} of 16.3), covariance inflated; check the marker"
    return fused.mount, [note] if fused.inflated else []


def _offset_notes(offset: TimeOffset, settings: MatchingSettings) -> list[str]:
    if not offset.observable:
        return ["time offset not observable on this path, 0 used"]
    if offset.at_bound:
        return [
            f"time offset at its bound of {1e3 * settings.time_offset_bound_s:.0f} ms; check the camera's time stamps"
        ]
    return []
