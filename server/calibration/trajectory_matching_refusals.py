"""Refusals of trajectory matching: streams, paths and fits that do not determine a rotation, each with its reason."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from server.calibration.chord_rotation import ChordRotation
from server.calibration.chords import arc_lengths
from server.calibration.contracts import Array, CalibrationStatus, CameraRotationEstimate
from server.calibration.rotation_fit import RotationFit

_ORTHONORMAL_MAX = 1e-3
_REMEDY = "check odometry, baseline and mounting, then run the path again"


@dataclass(frozen=True, slots=True)
class MatchingSettings:
    """What the chord method uses and what it refuses."""

    chord_m: float = 0.08  # of the coarse start only
    time_offset_bound_s: float = 0.25
    time_offset_step_s: float = 0.025
    time_offset_contrast_min: float = 0.05
    time_offset_sigma_max_s: float = 0.1  # less sure than this: "not observable"
    path_length_min_m: float = 0.15
    extent_min_m: float = 0.05  # largest distance from the path's middle; a smaller path says nothing
    chords_min: int = 12
    observability_min: float = 0.02
    residual_relative_max: float = 0.15  # robust one-axis residual over the mean chord length
    inliers_min_frac: float = 0.5
    scale_error_max_frac: float = 0.10
    from_nominal_max_rad: float = float(np.deg2rad(25.0))
    sigma_max_rad: float = float(np.deg2rad(4.0))
    sigma_model_rad: float = float(np.deg2rad(0.25))  # kinematics along the path, which no residual shows


@dataclass(frozen=True, slots=True)
class Refusal:
    """A status other than OK, why and what to do, with what is known of the path."""

    status: CalibrationStatus
    reason: str
    n_used: int = 0
    observability: float = 0.0

    def estimate(self, method: str, path_length_m: float) -> CameraRotationEstimate:
        """The result without a rotation."""
        return CameraRotationEstimate(
            self.status,
            self.reason,
            method,
            n_used=self.n_used,
            observability=self.observability,
            path_length_m=path_length_m,
        )


def time_refusal(t_s: Array, subject: str) -> Refusal | None:
    """Times must be finite and strictly increasing: a clock that stands or jumps back makes every chord a guess."""
    t = np.asarray(t_s, dtype=float)
    if not np.isfinite(t).all():
        text = f"{subject}: {int((~np.isfinite(t)).sum())} of {t.size} times are not finite"
        return Refusal(CalibrationStatus.DEGENERATE, f"{text}; check the time stamps")
    steps = np.diff(t)
    if (steps <= 0.0).any():
        kind = "runs backwards" if (steps < 0.0).any() else "stands still (equal times)"
        text = f"{subject}: time {kind} at {int((steps <= 0.0).sum())} of {t.size} samples"
        return Refusal(CalibrationStatus.DEGENERATE, f"{text}; check the time stamps, record again")
    return None


def usable_poses(Ts: Array) -> NDArray[np.bool_]:
    """Which poses (n, 4, 4) are finite with an orthonormal, right-handed rotation: mask (n,)."""
    finite = np.isfinite(Ts.reshape(len(Ts), 16)).all(axis=1)
    R = np.where(np.reshape(finite, (-1, 1, 1)), Ts, np.eye(4))[:, :3, :3]
    error = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    return np.logical_and(finite, np.logical_and(error < _ORTHONORMAL_MAX, np.linalg.det(R) > 0.0))


def path_refusal(n_cam: int, n_enc: int, points: Array, settings: MatchingSettings) -> Refusal | None:
    """Too few poses that overlap in time, or a path (points (n, 3), by kinematics) too short for a rotation."""
    if min(n_cam, n_enc) < settings.chords_min:
        counts = f"{n_cam} camera and {n_enc} encoder poses overlap in time"
        text = f"{counts}, at least {settings.chords_min} are needed; record both streams"
        return Refusal(CalibrationStatus.TOO_FEW, text)
    extent = float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())
    length = float(arc_lengths(points)[-1])
    if extent < settings.extent_min_m or length < settings.path_length_min_m:
        moved = f"the path reaches {1e3 * extent:.0f} mm from its middle over {1e3 * length:.0f} mm of length"
        limits = f"limits {1e3 * settings.extent_min_m:.0f} mm and {1e3 * settings.path_length_min_m:.0f} mm"
        return Refusal(CalibrationStatus.DEGENERATE, f"{moved}, {limits}; run a longer calibration path")
    return None


def coarse_refusal(fit: RotationFit, chords: Array, seen: float, settings: MatchingSettings) -> Refusal | None:
    """What the coarse start shows: a straight line, tracks that do not fit, too many outliers, a wrong scale."""
    n = len(chords)
    if seen < settings.observability_min:
        line = f"the path is nearly a straight line (observability {seen:.3f}, limit {settings.observability_min})"
        return Refusal(CalibrationStatus.DEGENERATE, f"{line}; run a folded path", n, seen)
    relative = fit.sigma_m / float(np.linalg.norm(chords, axis=1).mean())
    inliers = float(np.mean(np.linalg.norm(fit.residuals, axis=1) < 5.0 * max(fit.sigma_m, 1e-4)))
    for value, limit, text in (
        (relative, settings.residual_relative_max, "the tracks do not fit each other: residual over chord"),
        (1.0 - inliers, 1.0 - settings.inliers_min_frac, "too many chords disagree: share"),
        (abs(fit.scale - 1.0), settings.scale_error_max_frac, "odometry scale is wrong: departure from 1"),
    ):
        if not value <= limit:
            return Refusal(CalibrationStatus.POOR_FIT, f"{text} {value:.2f}, limit {limit:.2f}; {_REMEDY}", n, seen)
    return None


def fine_refusal(
    fit: ChordRotation, from_nominal_rad: float, sigma_rad: float, seen: float, settings: MatchingSettings
) -> Refusal | None:
    """What the final fit shows: an offset out of range, no settling, a far mounting, a rotation hardly known."""
    n, bound = int(fit.inliers.sum()), settings.time_offset_bound_s
    texts = []
    if abs(fit.offset_s) >= bound:
        texts.append(f"time offset at its bound of {1e3 * bound:.0f} ms; check the camera's time stamps")
    elif not fit.converged:
        texts.append(f"the fit did not settle; {_REMEDY}")
    if not from_nominal_rad <= settings.from_nominal_max_rad:
        limit = f"{from_nominal_rad:.2f}, limit {settings.from_nominal_max_rad:.2f}"
        texts.append(f"camera far from its nominal mounting (mirrored?): angle [rad] {limit}; {_REMEDY}")
    if not sigma_rad <= settings.sigma_max_rad:
        known, limit = np.rad2deg([sigma_rad, settings.sigma_max_rad])
        texts.append(f"rotation known to {known:.1f} deg only, limit {limit:.1f} deg; run a longer, more folded path")
    return Refusal(CalibrationStatus.POOR_FIT, texts[0], n, seen) if texts else None
