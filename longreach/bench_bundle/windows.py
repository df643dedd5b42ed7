"""Simulated keyframe windows: what one adjustment costs, and whether its covariance holds the error."""

import time
from dataclasses import dataclass

import numpy as np

from machine.poses import pose
from machine.rotations import rotation_from_rotvec, rotvec_from_rotation
from server.vision.bundle import BundleProblem, BundleResult, BundleSettings, adjust_bundle
from server.vision.contracts import Array

FOCAL_PX, BASELINE_M, SIGMA_PX = 528.0, 0.12, 0.12  # ZED2 at 720p; sigma of one aligned coordinate
SEEN_FRAC = 0.75  # of the points by each keyframe: 6 of 8
ONE_EYE_FRAC = 0.1
OUTLIER_PX = 20.0
TIMED_RUNS = 30


@dataclass(frozen=True, slots=True)
class Window:
    """A problem and its truth."""

    problem: BundleProblem
    Ts_vo_cam: Array
    points_vo: Array


def simulated_window(rng: np.random.Generator, n_frames: int, n_points: int, outlier_frac: float = 0.0) -> Window:
    """Keyframes on a 6 cm raster before a rough wall at 1.1 to 1.6 m; the first one fixed."""
    Ts = np.tile(np.eye(4), (n_frames, 1, 1))
    for number, T in enumerate(Ts):
        at = np.array([0.06 * number, 0.03 * np.sin(number), 0.02 * number])
        T[:] = pose(rotation_from_rotvec(0.05 * rng.normal(size=3)), at + 0.01 * rng.normal(size=3))
    points = rng.uniform((-0.8, -0.6, 1.1), (1.2, 0.6, 1.6), (n_points, 3))
    frames, seen = np.nonzero(rng.random((n_frames, n_points)) < SEEN_FRAC)
    arm = points[seen] - Ts[frames, :3, 3]
    x, y, z = np.einsum("nji,nj->ni", Ts[frames, :3, :3], arm).T
    uv = np.column_stack([x / z, y / z, (x - BASELINE_M) / z, y / z])
    uv += SIGMA_PX / FOCAL_PX * rng.normal(size=uv.shape)
    wrong = rng.random(len(uv)) < outlier_frac
    uv[wrong] += OUTLIER_PX / FOCAL_PX * rng.normal(size=(int(wrong.sum()), 4))
    uv[rng.random(len(uv)) < ONE_EYE_FRAC, 2:] = np.nan
    start = Ts.copy()
    for T in start[1:]:
        T[:3, :3] = rotation_from_rotvec(0.005 * rng.normal(size=3)) @ T[:3, :3]
        T[:3, 3] += 0.005 * rng.normal(size=3)
    problem = BundleProblem(
        Ts_vo_cam=start,
        points_vo=points + 0.02 * rng.normal(size=points.shape),
        frames=frames,
        points=seen,
        uv=uv,
        sigma_px=np.full((len(frames), 2), SIGMA_PX),
        focal_px=(FOCAL_PX, FOCAL_PX),
        baseline_m=BASELINE_M,
        fixed=np.arange(n_frames) == 0,
    )
    return Window(problem, Ts, points)


def joint_nees(window: Window, result: BundleResult) -> float:
    """Squared Mahalanobis error of all free poses together, over its degrees of freedom: 1 where honest."""
    errors = np.array(
        [
            np.concatenate([rotvec_from_rotation(true[:3, :3] @ found[:3, :3].T), true[:3, 3] - found[:3, 3]])
            for true, found in zip(window.Ts_vo_cam, result.Ts_vo_cam, strict=True)
        ]
    )
    free = np.repeat(~window.problem.fixed, 6)
    error = errors.ravel()[free]
    return float(error @ np.linalg.solve(result.joint_covariance[np.ix_(free, free)], error) / len(error))


def adjustment_ms(n_frames: int, n_points: int, iterations: int, seed: int) -> float:
    """Median CPU time of one whole `adjust_bundle` call with exactly so many iterations, warm."""
    problem = simulated_window(np.random.default_rng(seed), n_frames, n_points).problem
    settings = BundleSettings(iterations_max=iterations, step_tol_sigma=0.0)
    spent = []
    for _ in range(TIMED_RUNS):
        started = time.thread_time()
        adjust_bundle(problem, settings)
        spent.append(1e3 * (time.thread_time() - started))
    return float(np.median(spent[1:]))
