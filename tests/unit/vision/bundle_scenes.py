"""Small stereo scenes with exact truth for the bundle adjustment's tests."""

from dataclasses import dataclass, replace

import numpy as np

from machine.poses import pose
from machine.rotations import rotation_from_rotvec, rotvec_from_rotation
from server.vision.bundle_contracts import BundleProblem

FOCAL_PX, BASELINE_M, SIGMA_PX = (528.0, 530.0), 0.12, 0.12


@dataclass(frozen=True, slots=True)
class Scene:
    problem: BundleProblem
    Ts_vo_cam: np.ndarray
    points_vo: np.ndarray


def random_pose(rng, sigma_rad, sigma_m):
    return pose(rotation_from_rotvec(sigma_rad * rng.normal(size=3)), sigma_m * rng.normal(size=3))


def moved(T, rng, sigma_rad, sigma_m):
    step = random_pose(rng, sigma_rad, sigma_m)
    return pose(step[:3, :3] @ T[:3, :3], T[:3, 3] + step[:3, 3])


def rays_of(Ts_vo_cam, points_vo, frames, points, baseline_m=BASELINE_M):
    arm = points_vo[points] - Ts_vo_cam[frames, :3, 3]
    x, y, z = np.einsum("nji,nj->ni", Ts_vo_cam[frames, :3, :3], arm).T
    return np.column_stack([x / z, y / z, (x - baseline_m) / z, y / z])


def make_scene(rng, n_frames=5, n_points=60, noise=1.0, seen_frac=0.75, one_eye_frac=0.1, outlier_frac=0.0, off=1.0):
    """Frames on a 6 cm raster before points at 1.1 to 1.6 m; noise in units of SIGMA_PX; `off` scales the start."""
    Ts = np.array(
        [
            moved(pose(np.eye(3), np.array([0.06 * k, 0.03 * (k % 2), 0.02 * k])), rng, 0.05, 0.01)
            for k in range(n_frames)
        ]
    )
    points = rng.uniform((-0.7, -0.5, 1.1), (0.9, 0.5, 1.6), (n_points, 3))
    frames, seen = np.nonzero(rng.random((n_frames, len(points))) < seen_frac)
    uv = rays_of(Ts, points, frames, seen)
    uv += noise * SIGMA_PX * rng.normal(size=uv.shape) / np.tile(FOCAL_PX, 2)
    wrong = rng.random(len(uv)) < outlier_frac
    uv[wrong] += 20.0 / FOCAL_PX[0] * rng.normal(size=(int(wrong.sum()), 4))
    uv[rng.random(len(uv)) < one_eye_frac, 2:] = np.nan
    start = np.array([T if k == 0 else moved(T, rng, 0.005 * off, 0.005 * off) for k, T in enumerate(Ts)])
    problem = BundleProblem(
        Ts_vo_cam=start,
        points_vo=points + 0.02 * off * rng.normal(size=points.shape),
        frame_indices=frames,
        point_indices=seen,
        rays=uv,
        sigma_px=np.full((len(frames), 2), SIGMA_PX),
        focal_px=FOCAL_PX,
        baseline_m=BASELINE_M,
        fixed_frames=np.arange(n_frames) == 0,
    )
    return Scene(problem, Ts, points)


def only(problem, keep):
    """The same problem with some observations (n,) left out."""
    return replace(
        problem,
        frame_indices=problem.frame_indices[keep],
        point_indices=problem.point_indices[keep],
        rays=problem.rays[keep],
        sigma_px=problem.sigma_px[keep],
    )


def pose_error(T_true, T_found):
    """(6,): left perturbation [rad], then translation [m]."""
    return np.concatenate([rotvec_from_rotation(T_true[:3, :3] @ T_found[:3, :3].T), T_true[:3, 3] - T_found[:3, 3]])


def errors(Ts_true, Ts_found):
    return np.array([pose_error(a, b) for a, b in zip(Ts_true, Ts_found, strict=True)])
