"""Checks at the public entries of this package: a broken contract raises CalibrationInputError, naming subject, value
and limit."""

import numpy as np

from server.calibration.contracts import Array


class CalibrationInputError(ValueError):
    """Input that no caller may hand over: wrong shape, not a rotation, time running backwards."""


def require_rotation(rotation: Array, subject: str) -> Array:
    """The rotation (3, 3) as float array. Raises: CalibrationInputError unless orthonormal to 1e-6 and right-handed."""
    R = np.asarray(rotation, dtype=float)
    if R.shape != (3, 3):
        raise CalibrationInputError(f"{subject} has shape {R.shape}, a rotation has (3, 3)")
    error = float(np.abs(R @ R.T - np.eye(3)).max())
    if not error <= 1e-6 or np.linalg.det(R) < 0.0:
        raise CalibrationInputError(f"{subject} departs from orthonormal by {error:.2e} (limit 1e-6) or is mirrored")
    return R


def require_pose(T: Array, subject: str) -> Array:
    """The pose (4, 4) as float array. Raises: CalibrationInputError unless it is one."""
    pose = np.asarray(T, dtype=float)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise CalibrationInputError(f"{subject} must be a finite (4, 4) pose, got shape {pose.shape}")
    require_rotation(pose[:3, :3], subject)
    return pose


def require_covariance(covariance: Array, size: int, subject: str) -> Array:
    """The covariance (size, size), symmetric and not negative. Raises: CalibrationInputError."""
    C = np.asarray(covariance, dtype=float)
    if C.shape != (size, size) or not np.isfinite(C).all():
        raise CalibrationInputError(f"{subject} must be finite of shape ({size}, {size}), got {C.shape}")
    scale = max(float(np.abs(C).max()), 1e-300)
    if np.abs(C - C.T).max() > 1e-9 * scale or np.linalg.eigvalsh(0.5 * (C + C.T)).min() < -1e-9 * scale:
        raise CalibrationInputError(f"{subject} is not symmetric and positive; give a covariance")
    return C


def require_track_shape(t_s: Array, Ts: Array, subject: str) -> None:
    """A track's times (n,) and poses (n, 4, 4). Raises: CalibrationInputError on any other shape."""
    t, poses = np.asarray(t_s), np.asarray(Ts)
    if t.ndim != 1 or poses.shape != (t.size, 4, 4):
        raise CalibrationInputError(f"{subject}: times {t.shape} and poses {poses.shape} must be (n,) and (n, 4, 4)")


def require_track(t_s: Array, Ts: Array, subject: str) -> None:
    """As `require_track_shape`. Raises: CalibrationInputError also on time running backwards."""
    require_track_shape(t_s, Ts, subject)
    t = np.asarray(t_s)
    if not np.isfinite(t).all() or (np.diff(t) <= 0.0).any():
        raise CalibrationInputError(
            f"{subject}: times must be finite and strictly increasing [s]; sort and deduplicate"
        )
