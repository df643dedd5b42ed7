"""Odometry without images: the true camera path with the fitted errors of scale, walk, bend and jitter."""

import numpy as np

from benchmarks.reproduce.noise_model import OdometryNoise
from machine.poses import inverse_pose
from machine.rotations import Array, rotation_from_rotvec
from server.calibration.chords import arc_lengths


def odometry_path(Ts_base_cam: Array, noise: OdometryNoise, rng: np.random.Generator) -> Array:
    """Ts_vo_cam (n, 4, 4) as the odometry would give it for a camera path (n, 4, 4); starts at the identity.

    The path is the true one as the machine's lens bends it: see `fast_lens.bent_path`.
    """
    true = inverse_pose(Ts_base_cam[0]) @ Ts_base_cam
    arc = arc_lengths(true[:, :3, 3])
    found = true.copy()
    found[:, :3, 3] *= 1.0 + noise.scale_frac * rng.standard_normal()
    found[:, :3, 3] += position_errors(arc, noise, rng)
    turns = walk(arc, noise.turn_drift_rad_sqrt_m, rng) + noise.turn_jitter_rad * rng.standard_normal((len(arc), 3))
    found[:, :3, :3] = np.array([rotation_from_rotvec(turn) for turn in turns]) @ true[:, :3, :3]
    found[0] = np.eye(4)
    return found


def position_errors(arc_m: Array, noise: OdometryNoise, rng: np.random.Generator) -> Array:
    """Errors (n, 3) [m] without scale along a path of arc lengths (n,) [m]; zero at the start."""
    errors = walk(arc_m, noise.drift_m_sqrt_m, rng) + bend(arc_m, noise.bend_m, noise.bend_length_m, rng)
    errors += noise.jitter_m * rng.standard_normal((len(arc_m), 3))
    return errors - errors[0]


def walk(arc_m: Array, sd_sqrt_m: float, rng: np.random.Generator) -> Array:
    """Random walk in arc length (n, 3), zero at the start."""
    steps = np.sqrt(np.diff(arc_m, prepend=arc_m[0]))[:, None] * rng.standard_normal((len(arc_m), 3))
    return sd_sqrt_m * np.cumsum(steps, axis=0)


def bend(arc_m: Array, sd: float, length_m: float, rng: np.random.Generator) -> Array:
    """Stationary process in arc length (n, 3): sd, correlated as exp(-distance / length)."""
    draws = rng.standard_normal((len(arc_m), 3))
    keep = np.exp(-np.diff(arc_m) / length_m) if length_m > 0.0 else np.zeros(len(arc_m) - 1)
    values = np.empty_like(draws)
    values[0] = draws[0]
    for k, share in enumerate(keep, start=1):
        values[k] = share * values[k - 1] + np.sqrt(1.0 - share**2) * draws[k]
    return sd * values
