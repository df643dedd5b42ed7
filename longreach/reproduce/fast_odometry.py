"""Odometry without images: the true camera path with the fitted errors of scale, walk, bend and jitter."""

import numpy as np

from longreach.reproduce.noise_model import OdometryNoise
from machine.poses import inverse_pose
from machine.rotations import Array, rotation_from_rotvec
from server.calibration.chords import arc_lengths
from sim_plc.world import World


def odometry_path(Ts_base_cam: Array, noise: OdometryNoise, rng: np.random.Generator, rig_scale: float = 1.0) -> Array:
    """Ts_vo_cam (n, 4, 4) as the odometry would give it for a true camera path (n, 4, 4); starts at the identity.

    Args:    rig_scale: found over true length by the rig's own error, see `rig_scale`.
    """
    true = inverse_pose(Ts_base_cam[0]) @ Ts_base_cam
    arc = arc_lengths(true[:, :3, 3])
    found = true.copy()
    found[:, :3, 3] *= rig_scale * (1.0 + noise.scale_frac * rng.standard_normal())
    found[:, :3, 3] += position_errors(arc, noise, rng)
    turns = walk(arc, noise.turn_drift_rad_sqrt_m, rng) + noise.turn_jitter_rad * rng.standard_normal((len(arc), 3))
    found[:, :3, :3] = np.array([rotation_from_rotvec(turn) for turn in turns]) @ true[:, :3, :3]
    found[0] = np.eye(4)
    return found


def rig_scale(world: World, T_base_tcp: Array) -> float:
    """Found over true length that this machine's disparity bias makes of motion before the wall.

    Model:   d = f b / z is seen as d - delta, so every point seems d / (d - delta) times as far away, and every step as
             long; delta is how far the right eye's true middle lies beyond the left's.
    """
    left, right = world.camera.left, world.camera.right
    T_cam_ooi = inverse_pose(T_base_tcp @ world.camera.T_tcp_cam_left) @ world.scene.T_base_ooi
    disparity = left.fx_px * left.baseline_m / (T_cam_ooi[2, 3] + world.scene.wall_offset_m)
    return float(disparity / (disparity - (right.cx_px - left.cx_px)))


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
