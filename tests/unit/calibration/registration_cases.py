"""Simulated tracks for registration: three paths, five kinds of error, exact truth."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from machine.poses import pose
from machine.rotations import Array, rotation_from_rotvec
from server.calibration.contracts import CameraTrack, EncoderTrack

#: Nominal pose of the camera on the TCP: looks along -z of the TCP, half a metre behind the tool.
T_TCP_CAM_NOMINAL = np.array([[0.0, -1, 0, 0.18], [-1, 0, 0, 0.06], [0, 0, -1, 0.5], [0, 0, 0, 1.0]])
CAMERA_HZ, ENCODER_HZ, SPEED_PEAK_M_S = 15.0, 100.0, 0.14
DRIFT_FRAC, SCALE_FRAC, JITTER_M = 0.005, 0.003, 0.001
OUTLIER_FRAC, OUTLIER_M = 0.1, 0.05
CLOCK_OFFSET_S = 0.15
MOUNT_RAD = np.deg2rad(4.0)
KINDS = ("noise", "outliers", "offset", "warp 1 cm", "warp 2 cm")


def paper_path() -> Array:
    """Corner points of the paper's path: legs turned by 0 and 45 deg in turn, no reversals, 0.95 m (7, 3) [m]."""
    turns = np.deg2rad([0.0, 45.0, 0.0, 45.0, 0.0, 45.0])
    lengths = np.array([0.20, 0.10, 0.15, 0.12, 0.20, 0.18])
    steps = lengths[:, None] * np.column_stack((np.cos(turns), np.sin(turns), 0.0 * turns))
    return np.vstack((np.zeros(3), np.cumsum(steps, axis=0)))


def folded_path(out_of_plane: bool) -> Array:
    """Corner points of a folded, asymmetric path of 1.0 m; with legs of 12 cm out of the plane, or flat (5, 3) [m]."""
    flat = np.array([[0.0, 0.0], [0.25, 0.05], [0.20, 0.27], [0.00, 0.21], [-0.05, 0.08]])
    depth = np.array([0.0, 0.12, 0.0, 0.12, 0.0])
    corners = np.column_stack((flat, depth if out_of_plane else 0.0 * depth))
    return corners / float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum())


PATHS = {"paper": paper_path(), "folded 2-D": folded_path(False), "folded 3-D": folded_path(True)}


@dataclass(frozen=True, slots=True)
class RegistrationCase:
    """Both tracks and what is true of them: the mounting R_tcp_cam, base from odometry, and the clock offset [s]."""

    camera: CameraTrack
    encoder: EncoderTrack
    R_tcp_cam: Array
    R_base_vo: Array
    offset_s: float


def position_on(corners: Array, t_s: Array) -> Array:
    """Positions at times along straight legs with quintic timing, at rest half a second before and after (n, 3) [m]."""
    out, begin = np.tile(corners[0], (len(t_s), 1)), 0.5
    for a, b in pairwise(corners):
        duration = _leg_s(a, b)
        u = np.clip((t_s - begin) / duration, 0.0, 1.0)
        along = u**3 * (10 - 15 * u + 6 * u**2)
        out[t_s >= begin] = (a + along[:, None] * (b - a))[t_s >= begin]
        begin += duration
    return out


def _leg_s(a: Array, b: Array) -> float:
    return max(1.875 * float(np.linalg.norm(b - a)) / SPEED_PEAK_M_S, 0.5)


def draw_case(path: str, kind: str, seed: int) -> RegistrationCase:
    """One trial.

    Model:   odometry = scale (1 + 0.3 % sd) x true camera path (+ warp) + random walk, at its end 0.5 % of the path per
             axis, + jitter of 1 mm per axis; outliers: every tenth position off by 5 cm sd per axis; offset: stamps of
             the camera 0.15 s early, its clock is behind; warp: a smooth random field over space, its peak as named.
             The orientation is held; the mounting is 4 deg off its nominal about a random axis.
    Args:    path: of `PATHS`; kind: of `KINDS`; seed: of this trial.
    Source:  machine.md section 5, "Experiments".
    """
    rng = np.random.default_rng([seed, list(PATHS).index(path), KINDS.index(kind)])
    corners = PATHS[path]
    R_base_tcp, R_base_vo = (rotation_from_rotvec(rng.normal(size=3)) for _ in range(2))
    R_tcp_cam = rotation_from_rotvec(MOUNT_RAD * _unit(rng)) @ T_TCP_CAM_NOMINAL[:3, :3]
    total_s = 1.0 + sum(_leg_s(a, b) for a, b in pairwise(corners))
    t_enc, t_cam = np.arange(0.0, total_s, 1.0 / ENCODER_HZ), np.arange(0.05, total_s, 1.0 / CAMERA_HZ)
    start = np.array([3.0, 0.5, 1.5])
    Ts_base_tcp = _held(R_base_tcp, start + position_on(corners, t_enc) @ R_base_tcp.T)
    on_path = position_on(corners, t_cam) @ R_base_tcp.T
    Ts_vo_cam = _held(R_base_vo.T @ R_base_tcp @ R_tcp_cam, _odometry(on_path @ R_base_vo, kind, rng))
    offset_s = CLOCK_OFFSET_S if kind == "offset" else 0.0
    return RegistrationCase(
        camera=CameraTrack(t_cam - offset_s, Ts_vo_cam),
        encoder=EncoderTrack(t_enc, Ts_base_tcp),
        R_tcp_cam=R_tcp_cam,
        R_base_vo=R_base_vo,
        offset_s=offset_s,
    )


def _unit(rng: np.random.Generator) -> Array:
    axis = rng.normal(size=3)
    return axis / np.linalg.norm(axis)


def _held(R: Array, points: Array) -> Array:
    Ts = np.tile(pose(R, np.zeros(3)), (len(points), 1, 1))
    Ts[:, :3, 3] = points
    return Ts


def _odometry(points: Array, kind: str, rng: np.random.Generator) -> Array:
    """True points (n, 3) as the odometry would tell them [m]."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    walk = rng.normal(size=(len(steps), 3)) * DRIFT_FRAC * np.sqrt(steps.sum() * steps)[:, None]
    scale = 1.0 + SCALE_FRAC * rng.normal()
    seen = points[0] + scale * (points - points[0]) + np.vstack((np.zeros(3), np.cumsum(walk, axis=0)))
    seen = seen + JITTER_M * rng.normal(size=points.shape)
    if kind == "outliers":
        off = rng.random(len(points)) < OUTLIER_FRAC
        seen[off] += OUTLIER_M * rng.normal(size=(int(off.sum()), 3))
    if kind.startswith("warp"):
        seen = seen + warp(points, 0.01 * float(kind.split()[1]), rng)
    return seen


def warp(points: Array, peak_m: float, rng: np.random.Generator) -> Array:
    """A smooth non-rigid displacement of points (n, 3), largest value `peak_m` (n, 3) [m].

    Model:   each axis a Gaussian process over the place, squared exponential, its length the largest reach from the
             path's middle (so it has a strong linear part and a bend); mean removed, scaled to the peak.
    """
    centred = points - points.mean(axis=0)
    length = float(np.linalg.norm(centred, axis=1).max())
    apart = np.sum((centred[:, None] - centred[None]) ** 2, axis=2)
    values, vectors = np.linalg.eigh(np.exp(-apart / (2.0 * length**2)))
    field = vectors @ (np.sqrt(np.maximum(values, 0.0))[:, None] * rng.normal(size=points.shape))
    field = field - field.mean(axis=0)
    return field * (peak_m / float(np.linalg.norm(field, axis=1).max()))
