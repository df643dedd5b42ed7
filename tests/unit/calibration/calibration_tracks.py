"""Synthetic tracks for the calibration tests: a path at rest-to-rest legs, odometry noise, mount and clock offset."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from server.calibration.contracts import CameraTrack, EncoderTrack

#: Offsets of the folded path in TCP axes [m]; the module that plans it holds the same numbers.
FOLDED = np.array([
    [0.0, 0.0, 0.0], [0.13, 0.04, 0.0], [0.11, -0.11, 0.10], [-0.07, -0.09, 0.02], [-0.10, 0.06, 0.10],
    [0.05, 0.12, 0.08], [0.0, 0.0, 0.0],
])  # fmt: skip
T_TCP_CAM = np.array([[0.0, -1, 0, 0.18], [-1, 0, 0, 0.06], [0, 0, -1, 0.5], [0, 0, 0, 1.0]])


def paper_offsets() -> np.ndarray:
    xi = np.array([0, 45, 0, 45, 0, 45.0])
    lengths = np.array([0.2, 0.1, 0.15, 0.12, 0.2, 0.18])
    steps = lengths[:, None] * np.column_stack((np.cos(np.deg2rad(xi)), np.sin(np.deg2rad(xi)), 0.0 * xi))
    return np.vstack((np.zeros(3), np.cumsum(steps, axis=0)))


@dataclass(frozen=True)
class Case:
    camera: CameraTrack
    encoder: EncoderTrack
    R_tcp_cam: np.ndarray


def leg_positions(offsets: np.ndarray, t: np.ndarray, v_peak: float = 0.14, t_start: float = 0.5) -> np.ndarray:
    """Positions at times t along quintic legs, at rest before and after."""
    out = np.tile(offsets[0], (len(t), 1))
    begin = t_start
    for a, b in pairwise(offsets):
        duration = max(1.875 * float(np.linalg.norm(b - a)) / v_peak, 0.5)
        u = np.clip((t - begin) / duration, 0.0, 1.0)
        s = u**3 * (10 - 15 * u + 6 * u**2)
        out[t >= begin] = (a + s[:, None] * (b - a))[t >= begin]
        begin += duration
    return out


def duration_of(offsets: np.ndarray, v_peak: float = 0.14) -> float:
    return 1.875 * float(np.linalg.norm(np.diff(offsets, axis=0), axis=1).sum()) / v_peak + 1.0


def make_case(offsets: np.ndarray, seed: int, mount_deg: float = 4.0, offset_s: float = 0.0, **noise: Any) -> Case:
    """Camera stamps are late by offset_s: camera time + offset = encoder time.

    Noise: random-walk drift of 0.5 % of the path (3-D norm at its end), scale 0.3 %, jitter 1 mm per axis, and a
    wobble of the orientation that encoders and odometry both see.
    """
    rng = np.random.default_rng(seed)
    drift, scale, jitter = noise.get("drift", 0.005), noise.get("scale", 0.003), noise.get("jitter", 0.001)
    R_base_tcp = rotation_from_rotvec(rng.normal(size=3))
    axis = rng.normal(size=3)
    R_tcp_cam = rotation_from_rotvec(np.deg2rad(mount_deg) * axis / np.linalg.norm(axis)) @ T_TCP_CAM[:3, :3]
    total = duration_of(offsets)
    t_enc = np.arange(0.0, total, 0.01)
    t_cam_true = np.arange(0.05, total, 1 / 15)
    p_tcp = np.array([3.0, 0.5, 1.5])

    def tcp(t: np.ndarray) -> np.ndarray:
        wobble = np.deg2rad(noise.get("wobble_deg", 0.2))
        points = p_tcp + leg_positions(offsets, t) @ R_base_tcp.T
        turns = Rotation.from_rotvec(wobble * np.column_stack((np.sin(t), np.cos(1.3 * t), 0.0 * t))).as_matrix()
        Ts = np.tile(np.eye(4), (len(t), 1, 1))
        Ts[:, :3, :3], Ts[:, :3, 3] = turns @ R_base_tcp, points
        return Ts

    mount = pose(R_tcp_cam, T_TCP_CAM[:3, 3])
    Ts_base_cam = tcp(t_cam_true) @ mount
    T_vo_base = pose(rotation_from_rotvec(rng.normal(size=3)), rng.normal(size=3))
    Ts_vo = T_vo_base @ Ts_base_cam
    length = float(np.linalg.norm(np.diff(offsets, axis=0), axis=1).sum())
    arc = np.linalg.norm(np.diff(Ts_vo[:, :3, 3], axis=0), axis=1)
    walk = rng.normal(size=(len(arc), 3)) * (drift * length / np.sqrt(3.0)) * np.sqrt(arc / max(length, 1e-9))[:, None]
    clean = Ts_vo[0, :3, 3] + (1 + scale * rng.normal()) * (Ts_vo[:, :3, 3] - Ts_vo[0, :3, 3])
    Ts_vo[:, :3, 3] = clean + np.vstack((np.zeros(3), np.cumsum(walk, axis=0))) + jitter * rng.normal(size=clean.shape)
    outliers = rng.random(len(clean)) < noise.get("outliers", 0.0)
    Ts_vo[outliers, :3, 3] += 0.05 * rng.normal(size=(outliers.sum(), 3))
    return Case(CameraTrack(t_cam_true - offset_s, Ts_vo), EncoderTrack(t_enc, tcp(t_enc)), R_tcp_cam)
