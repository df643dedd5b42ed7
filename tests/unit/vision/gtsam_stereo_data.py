"""The stereo visual odometry sets that PyPI's gtsam ships, as plain arrays, and the one cost that judges everybody."""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from server.vision.contracts import Array

DEPTH_MIN_M = 1e-6
SETS = {
    "large": ("VO_calibration.txt", "VO_camera_poses_large.txt", "VO_stereo_factors_large.txt"),
    "00s": ("VO_calibration00s.txt", "VO_camera_poses00s.txt", "VO_stereo_factors00s.txt"),
}


@dataclass(frozen=True, slots=True)
class StereoData:
    """k poses T_vo_cam, m landmarks (m, 3) [m] and n rows of measured (u left, u right, v) [px]; sigma is 1 px.

    calibration: fx, fy, skew, u0, v0 [px], baseline [m]. frames, points (n,): which pose sees which landmark.
    """

    calibration: Array
    Ts_vo_cam: Array
    points_vo: Array
    frames: NDArray[np.int64]
    points: NDArray[np.int64]
    measured_px: Array


def gtsam_data_folder() -> Path | None:
    """Folder of gtsam's example data; None where gtsam is not installed or has none."""
    spec = find_spec("gtsam")
    if spec is None or spec.origin is None:
        return None
    folder = Path(spec.origin).parent / "Data"
    return folder if (folder / SETS["large"][2]).is_file() else None


def read_stereo_data(folder: Path, name: str = "large") -> StereoData:
    """One of SETS; a landmark starts where the first pose that sees it puts it."""
    calibration_file, poses_file, factors_file = SETS[name]
    poses = np.loadtxt(folder / poses_file)
    rows = np.loadtxt(folder / factors_file)
    Ts = poses[:, 1:].reshape(-1, 4, 4)
    numbers = poses[:, 0].astype(int)
    frames = np.searchsorted(numbers, rows[:, 0].astype(int))
    _, first, points = np.unique(rows[:, 1].astype(int), return_index=True, return_inverse=True)
    T_first = Ts[frames[first]]
    starts = np.einsum("nij,nj->ni", T_first[:, :3, :3], rows[first, 5:8]) + T_first[:, :3, 3]
    Ts[:, :3, :3] = _nearest_rotations(Ts[:, :3, :3])  # the files hold six digits
    return StereoData(np.loadtxt(folder / calibration_file), Ts, starts, frames, points, rows[:, 2:5])


def _nearest_rotations(rotations: Array) -> Array:
    u, _, vt = np.linalg.svd(rotations)
    return u @ vt


def squares_px(data: StereoData, Ts_vo_cam: Array, points_vo: Array) -> Array:
    """|residual|^2 (n,) [px^2] of every measurement; NaN where the landmark lies behind the eye.

    Model:   u_left = fx x/z + u0, u_right = u_left - fx baseline/z, v = fy y/z + v0, with x, y, z in the left eye.
    """
    fx, fy, _, u0, v0, baseline = data.calibration
    T, point = Ts_vo_cam[data.frames], points_vo[data.points]
    x, y, z = np.einsum("nji,nj->ni", T[:, :3, :3], point - T[:, :3, 3]).T
    z = np.where(z > DEPTH_MIN_M, z, np.nan)
    u_left = fx * x / z + u0
    predicted = np.column_stack([u_left, u_left - fx * baseline / z, fy * y / z + v0])
    return np.asarray(((predicted - data.measured_px) ** 2).sum(axis=1))


def cost_of(squares: Array, huber_px: float | None) -> float:
    """Sum of rho / 2 over all measurements: squares, or Huber's loss on the length of the 3-vector; NaN stays NaN."""
    if huber_px is None:
        return float(0.5 * squares.sum())
    lengths = np.sqrt(squares)
    return float(np.where(lengths <= huber_px, 0.5 * squares, huber_px * (lengths - 0.5 * huber_px)).sum())
