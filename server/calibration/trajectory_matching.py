"""Trajectory matching, the default: the camera's rotation from time-stamped chords, fused with its known mounting."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from machine.rotations import geodesic_angle, nearest_rotation, rotation_from_rotvec, rotvec_from_rotation
from server.calibration.checks import require_covariance, require_pose, require_rotation, require_track_shape
from server.calibration.chord_rotation import ChordRotation, fit_chord_rotation
from server.calibration.chords import (
    ChordPairs,
    arc_lengths,
    chord_pairs,
    chord_vectors,
    find_time_offset,
    observability,
    positions_at,
    rotation_information,
)
from server.calibration.contracts import (
    Array,
    CalibrationStatus,
    CameraRotationEstimate,
    CameraTrack,
    EncoderTrack,
    MountRotation,
)
from server.calibration.rotation_fit import RotationFit, fit_rotation
from server.calibration.trajectory_matching_refusals import (
    MatchingSettings,
    Refusal,
    coarse_refusal,
    fine_refusal,
    path_refusal,
    time_refusal,
    usable_poses,
)


@dataclass(frozen=True, slots=True)
class FusedRotation:
    """The joined rotation and how well the two agreed: `chi2` of their difference, 3 degrees of freedom."""

    mount_rotation: MountRotation
    chi2: float
    covariance_inflated: bool


def prior_from_tool_marker(R_tcp_tool: Array, R_cam_tool: Array, sigma_rad: float) -> MountRotation:
    """The camera's mounting as the tool marker in the image shows it.

    Model:   R_tcp_cam = R_tcp_tool R_cam_tool^T; its error is that of the marker's own mounting on the tool.
    Args:    R_tcp_tool: nominal tool marker mounting (3, 3); R_cam_tool: as seen (3, 3); sigma_rad: of the mounting,
             each axis [rad], > 0.
    Returns: mounting with covariance sigma^2 I.
    """
    R = require_rotation(R_tcp_tool, "R_tcp_tool") @ require_rotation(R_cam_tool, "R_cam_tool").T
    return MountRotation(R_tcp_cam=R, covariance=require_covariance(sigma_rad**2 * np.eye(3), 3, "sigma_rad^2 I"))


def fuse_rotations(data: MountRotation, prior: MountRotation, chi2_max: float = 16.3) -> FusedRotation:
    """Joint rotation of two independent estimates, in information form.

    Model:   d = log(R_prior R_data^T); P = (P_data^-1 + P_prior^-1)^-1; R = exp(P P_prior^-1 d) R_data. When d is
             improbable (chi2 = d^T (P_data + P_prior)^-1 d > chi2_max, 16.3 is 99.9 %), P is inflated by chi2 / 3.
    Args:    data, prior: covariance (3, 3) [rad^2], left perturbation, TCP axes.
    Returns: the joint mounting, its covariance, and the agreement.
    """
    d = rotvec_from_rotation(prior.R_tcp_cam @ data.R_tcp_cam.T)
    information_prior = np.linalg.inv(prior.covariance)
    P = np.linalg.inv(np.linalg.inv(data.covariance) + information_prior)
    P = 0.5 * (P + P.T)
    R = rotation_from_rotvec(P @ information_prior @ d) @ data.R_tcp_cam
    chi2 = float(d @ np.linalg.solve(data.covariance + prior.covariance, d))
    inflated = chi2 > chi2_max
    return FusedRotation(MountRotation(R, P * (chi2 / 3.0) if inflated else P), chi2, inflated)


METHOD_NAME = "chords"
DEFAULT_MATCHING_SETTINGS = MatchingSettings()
_VELOCITY_SPAN_S = 0.02


@dataclass(frozen=True, slots=True)
class _TrackPair:
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
    settings: MatchingSettings = DEFAULT_MATCHING_SETTINGS,
) -> CameraRotationEstimate:
    """The camera's rotation against the TCP, as the machine's own motion shows it here and now.

    Model:   chords dy = s R_base_vo dx of every length, dx from odometry, dy from the camera by kinematics,
             p_base_cam = (T_base_tcp T_tcp_cam_nominal).p, at the camera's times plus the offset; a robust fit on 8 cm
             chords is the start, all chords weighted by drift and jitter the result (`chord_rotation`);
             R_tcp_cam = mean over t of R_base_tcp^T R_base_vo R_vo_cam; fused with the prior by covariance.
             Replaces eq. 20's R_fm R_cfa; "camera axes = TCP axes" is never assumed.
    Args:    camera, encoder: tracks on the PC clock; T_tcp_cam_nominal: its lever arm and, for refusal, its rotation
             are used (4, 4); prior: from the tool marker, or None.
    Returns: the estimate; a status with its reason and no rotation when streams or path do not determine one.
    Source:  Makinen et al. 2023, eq. 17-22, with chords in place of the point set matching.
    """
    require_track_shape(camera.t_s, camera.Ts_vo_cam, "camera track")
    require_track_shape(encoder.t_s, encoder.Ts_base_tcp, "encoder track")
    T_tcp_cam = require_pose(T_tcp_cam_nominal, "T_tcp_cam_nominal")
    if prior is not None:
        require_rotation(prior.R_tcp_cam, "prior.R_tcp_cam")
        require_covariance(prior.covariance, 3, "prior.covariance")
    refusal = time_refusal(camera.t_s, "camera track") or time_refusal(encoder.t_s, "encoder track")
    if refusal is not None:
        return refusal.estimate(METHOD_NAME, 0.0)
    tracks = _prepare_tracks(camera, encoder, T_tcp_cam)
    points = _points_at(tracks, 0.0) if len(tracks.t_enc_s) else np.zeros((0, 3))
    length = float(arc_lengths(points)[-1]) if len(points) else 0.0
    refusal = path_refusal(len(tracks.t_cam_s), len(tracks.t_enc_s), points, settings)
    found = refusal or _match_tracks(tracks, T_tcp_cam[:3, :3], prior, settings)
    return found.estimate(METHOD_NAME, length) if isinstance(found, Refusal) else found


def _prepare_tracks(camera: CameraTrack, encoder: EncoderTrack, T_tcp_cam: Array) -> _TrackPair:
    Ts_vo, Ts_enc = np.asarray(camera.Ts_vo_cam, dtype=float), np.asarray(encoder.Ts_base_tcp, dtype=float)
    t_cam, t_enc = np.asarray(camera.t_s, dtype=float), np.asarray(encoder.t_s, dtype=float)
    good_vo, good_enc = usable_poses(Ts_vo), usable_poses(Ts_enc)
    Ts_vo, t_cam, Ts_enc, t_enc = Ts_vo[good_vo], t_cam[good_vo], Ts_enc[good_enc], t_enc[good_enc]
    if len(t_enc) >= 2:
        inside = (t_cam >= t_enc[0]) & (t_cam <= t_enc[-1])
        Ts_vo, t_cam = Ts_vo[inside], t_cam[inside]
    points = Ts_enc[:, :3, 3] + Ts_enc[:, :3, :3] @ T_tcp_cam[:3, 3]
    return _TrackPair(t_cam, Ts_vo, t_enc, Ts_enc[:, :3, :3], points)


def _points_at(tracks: _TrackPair, offset_s: float) -> Array:
    return positions_at(tracks.t_cam_s + offset_s, tracks.t_enc_s, tracks.points_base)[0]


def _match_tracks(
    tracks: _TrackPair, R_nominal: Array, prior: MountRotation | None, settings: MatchingSettings
) -> CameraRotationEstimate | Refusal:
    pairs = chord_pairs(_points_at(tracks, 0.0), settings.chord_m)
    search = (settings.time_offset_bound_s, settings.time_offset_step_s, settings.time_offset_contrast_min)
    t_cam_s, t_enc_s = tracks.t_cam_s, tracks.t_enc_s
    coarse_offset_s = find_time_offset(t_cam_s, tracks.points_vo, t_enc_s, tracks.points_base, pairs, *search)
    tracks, pairs = _overlapping_samples(tracks, coarse_offset_s, pairs)
    if len(pairs) < settings.chords_min:
        need = f"{len(pairs)} chords of {1e3 * settings.chord_m:.0f} mm, at least {settings.chords_min} are needed"
        return Refusal(CalibrationStatus.TOO_FEW, f"{need}; run a longer path or more frames", len(pairs))
    points = _points_at(tracks, coarse_offset_s)
    chords_base, chords_vo = chord_vectors(points, pairs), chord_vectors(tracks.points_vo, pairs)
    coarse = fit_rotation(chords_base, chords_vo)
    seen = _worst_observability(chords_base, chords_vo, coarse)
    refusal = coarse_refusal(coarse, chords_base, seen, settings)
    if refusal is not None:
        return refusal
    fit = fit_chord_rotation(
        tracks.points_vo,
        lambda offset_s: _points_and_velocities(tracks, offset_s),
        np.diff(arc_lengths(points)),
        coarse.R_a_b,
        coarse_offset_s,
        settings.time_offset_bound_s,
    )
    R_tcp_cam, R_base_tcp = _mount_from(tracks, fit.offset_s, fit.R_base_vo)
    covariance = R_base_tcp.T @ fit.covariance[:3, :3] @ R_base_tcp + settings.sigma_model_rad**2 * np.eye(3)
    mount, notes = _fuse_with_prior(MountRotation(R_tcp_cam, covariance), prior)
    sigma = float(np.sqrt(np.linalg.eigvalsh(mount.covariance)[-1]))
    refusal = fine_refusal(fit, geodesic_angle(R_nominal, R_tcp_cam), sigma, seen, settings)
    if refusal is not None:
        return refusal
    if float(np.sqrt(fit.covariance[4, 4])) > settings.time_offset_sigma_max_s:
        notes = [*notes, "time offset not observable on this path"]
    method = METHOD_NAME if prior is None else f"{METHOD_NAME}+tool_marker"
    return _build_estimate(tracks, fit, pairs, seen, mount, method, "; ".join(notes))


def _overlapping_samples(tracks: _TrackPair, offset_s: float, pairs: ChordPairs) -> tuple[_TrackPair, ChordPairs]:
    """The samples whose shifted time still lies inside the encoder track, and the chords between them."""
    t = tracks.t_cam_s + offset_s
    inside = (t >= tracks.t_enc_s[0]) & (t <= tracks.t_enc_s[-1])
    keep, number = inside[pairs.start_indices] & inside[pairs.end_indices], np.cumsum(inside) - 1
    kept = ChordPairs(number[pairs.start_indices[keep]], number[pairs.end_indices[keep]])
    return replace(tracks, t_cam_s=tracks.t_cam_s[inside], Ts_vo_cam=tracks.Ts_vo_cam[inside]), kept


def _points_and_velocities(tracks: _TrackPair, offset_s: float) -> tuple[Array, Array]:
    before, after = (_points_at(tracks, offset_s + side * _VELOCITY_SPAN_S) for side in (-1.0, 1.0))
    return _points_at(tracks, offset_s), (after - before) / (2.0 * _VELOCITY_SPAN_S)


def _build_estimate(
    tracks: _TrackPair,
    fit: ChordRotation,
    pairs: ChordPairs,
    seen: float,
    mount: MountRotation,
    method: str,
    notes: str,
) -> CameraRotationEstimate:
    points = _points_at(tracks, fit.offset_s)
    both_kept = fit.inliers[pairs.start_indices] & fit.inliers[pairs.end_indices]
    misses = chord_vectors(points - fit.scale * tracks.points_vo @ fit.R_base_vo.T, pairs)
    norms_mm = 1e3 * np.linalg.norm(misses, axis=1)
    return CameraRotationEstimate(
        status=CalibrationStatus.OK,
        reason=notes,
        method=method,
        R_tcp_cam=mount.R_tcp_cam,
        covariance=mount.covariance,
        time_offset_s=fit.offset_s,
        residual_rms_mm=float(np.sqrt(np.mean(norms_mm[both_kept] ** 2))) if both_kept.any() else float("nan"),
        residual_max_mm=float(norms_mm.max()),
        n_used=int(fit.inliers.sum()),
        observability=seen,
        path_length_m=float(arc_lengths(points)[-1]),
    )


def _worst_observability(chords_base: Array, chords_vo: Array, fit: RotationFit) -> float:
    return min(observability(rotation_information(chords, fit.weights)) for chords in (chords_base, chords_vo))


def _mount_from(tracks: _TrackPair, offset_s: float, R_base_vo: Array) -> tuple[Array, Array]:
    """R_tcp_cam as the mean over the track, and the TCP's mean rotation in base."""
    t = np.clip(tracks.t_cam_s + offset_s, tracks.t_enc_s[0], tracks.t_enc_s[-1])
    Rs_base_tcp = Slerp(tracks.t_enc_s, Rotation.from_matrix(tracks.Rs_base_tcp))(t).as_matrix()
    Rs_tcp_cam = Rs_base_tcp.transpose(0, 2, 1) @ R_base_vo @ tracks.Ts_vo_cam[:, :3, :3]
    return nearest_rotation(Rs_tcp_cam.mean(axis=0)), nearest_rotation(Rs_base_tcp.mean(axis=0))


def _fuse_with_prior(data: MountRotation, prior: MountRotation | None) -> tuple[MountRotation, list[str]]:
    if prior is None:
        return data, []
    fused = fuse_rotations(data, prior)
    note = f"odometry and tool marker disagree (chi2 {fused.chi2:.0f} of 16.3), covariance inflated; check the marker"
    return fused.mount_rotation, [note] if fused.covariance_inflated else []
