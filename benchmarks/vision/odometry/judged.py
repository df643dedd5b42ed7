"""A run of the odometry beside the truth: errors in the odometry's own frame, without any alignment."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from machine.rotations import Array, rotvec_from_rotation
from server.vision.contracts import OdometryPose, OdometryStatus

CHI2_95_OF_3 = float(chi2.ppf(0.95, 3))
MOVED_M = 0.05  # nearer to the start a scale means nothing


@dataclass(frozen=True, slots=True)
class Judged:
    """Per pair: errors (n, 6) (rotation vector [rad], left perturbation; position [m]), chi2 of each half, states."""

    errors: Array
    rotation_chi2: Array
    position_chi2: Array
    statuses: tuple[OdometryStatus, ...]
    n_points: Array
    ms: Array
    n_keyframes: int


@dataclass(frozen=True, slots=True)
class PathFigures:
    """What one run comes to. Errors over all pairs that are not LOST; shares 0..1; scale_frac: found over true, - 1."""

    n_pairs: int
    n_ok: int
    n_lost: int
    n_keyframes: int
    max_mm: float
    end_mm: float
    max_deg: float
    scale_frac: float
    held_position: float
    held_rotation: float
    worst_sigma: float  # largest position error in its own sigmas (root of chi2), OK pairs only
    ms_median: float
    ms_p99: float


def judge(poses: list[OdometryPose], Ts_true: Array, ms: list[float], n_keyframes: int) -> Judged:
    """Errors of poses against the true camera path in the frame of its first pose."""
    errors, squares = [], []
    for found, T in zip(poses, Ts_true, strict=True):
        rotation = rotvec_from_rotation(found.T_vo_cam[:3, :3] @ T[:3, :3].T)
        error = np.concatenate([rotation, found.T_vo_cam[:3, 3] - T[:3, 3]])
        errors.append(error)
        squares.append([_chi2(error[half], found.covariance[half, half]) for half in (slice(0, 3), slice(3, 6))])
    halves = np.array(squares)
    return Judged(
        errors=np.array(errors),
        rotation_chi2=halves[:, 0],
        position_chi2=halves[:, 1],
        statuses=tuple(one.status for one in poses),
        n_points=np.array([one.n_points for one in poses]),
        ms=np.array(ms),
        n_keyframes=n_keyframes,
    )


def _chi2(error: Array, covariance: Array) -> float:
    if not covariance.any():  # the first pose is the frame itself
        return float("nan")
    return float(error @ np.linalg.solve(covariance, error))


def scale_of(found: Array, true: Array) -> float:
    """Found over true length minus 1, by least squares over positions (n, 3) that are away from the start."""
    away = np.linalg.norm(true, axis=1) > MOVED_M
    return float((found[away] * true[away]).sum() / (true[away] ** 2).sum() - 1.0) if away.any() else float("nan")


def figures_of(judged: Judged, Ts_true: Array) -> PathFigures:
    """Sum up one run."""
    lost = np.array([status is OdometryStatus.LOST for status in judged.statuses])
    ok = np.array([status is OdometryStatus.OK for status in judged.statuses])
    known = ~lost & ~np.isnan(judged.position_chi2)
    away_mm = 1e3 * np.linalg.norm(judged.errors[:, 3:], axis=1)
    turned_deg = np.rad2deg(np.linalg.norm(judged.errors[:, :3], axis=1))
    true = Ts_true[:, :3, 3]
    return PathFigures(
        n_pairs=len(lost),
        n_ok=int(ok.sum()),
        n_lost=int(lost.sum()),
        n_keyframes=judged.n_keyframes,
        max_mm=float(away_mm[~lost].max(initial=0.0)),
        end_mm=float(away_mm[-1]),
        max_deg=float(turned_deg[~lost].max(initial=0.0)),
        scale_frac=scale_of((true + judged.errors[:, 3:])[known], true[known]),
        held_position=float((judged.position_chi2[known] < CHI2_95_OF_3).mean()) if known.any() else float("nan"),
        held_rotation=float((judged.rotation_chi2[known] < CHI2_95_OF_3).mean()) if known.any() else float("nan"),
        worst_sigma=float(np.sqrt(judged.position_chi2[known & ok].max(initial=0.0))),
        ms_median=float(np.median(judged.ms)),
        ms_p99=float(np.percentile(judged.ms, 99)),
    )
