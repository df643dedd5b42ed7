"""Compiles the bundle adjustment's kernels: some 25 s of CPU on a new machine, cached afterwards."""

import numpy as np

from server.vision.bundle import BundleProblem, BundleSettings, adjust_bundle


def warm_up_bundle() -> None:
    """Adjust two frames before twelve random points."""
    rng = np.random.default_rng(1)
    points = rng.uniform(-1.0, 1.0, (12, 3)) + np.array([0.0, 0.0, 4.0])
    Ts = np.tile(np.eye(4), (2, 1, 1))
    Ts[1, 0, 3] = 0.1
    frames, seen = np.nonzero(np.ones((2, 12)))
    x, y, z = (points[seen] - Ts[frames, :3, 3]).T
    problem = BundleProblem(
        Ts_vo_cam=Ts,
        points_vo=points,
        frames=frames,
        points=seen,
        uv=np.column_stack([x / z, y / z, (x - 0.1) / z, y / z]),
        sigma_px=np.full((24, 2), 0.1),
        focal_px=(500.0, 500.0),
        baseline_m=0.1,
        fixed=np.array([True, False]),
    )
    adjust_bundle(problem, BundleSettings(point_covariances=True))
