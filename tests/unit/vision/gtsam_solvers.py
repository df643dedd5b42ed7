"""Two ways to the optimum of one problem from one start: ours and gtsam's LM."""

import time
from dataclasses import dataclass

import numpy as np
from gtsam_stereo_data import StereoData

from server.vision.bundle import adjust_bundle
from server.vision.bundle_contracts import BundleLoss, BundleProblem, BundleSettings
from server.vision.contracts import Array

TIGHT_STEP_SIGMA = 1e-6
ITERATIONS_MAX = 200


@dataclass(frozen=True, slots=True)
class Solved:
    """Poses (k, 4, 4), points (m, 3) [m], iterations, CPU seconds, and how the solver says that it ended."""

    solver: str
    Ts_vo_cam: Array
    points_vo: Array
    iterations: int
    cpu_s: float
    ending: str


def bundle_problem(data: StereoData) -> BundleProblem:
    """The data as our adjustment takes it: rectified rays, the first pose fixed."""
    fx, fy, _, u0, v0, baseline = data.calibration
    left, right, row = data.measured_px.T
    return BundleProblem(
        Ts_vo_cam=data.Ts_vo_cam,
        points_vo=data.points_vo,
        frame_indices=data.frames,
        point_indices=data.points,
        rays=np.column_stack([(left - u0) / fx, (row - v0) / fy, (right - u0) / fx]),
        sigma_px=np.ones((len(data.frames), 2)),
        focal_px=(float(fx), float(fy)),
        baseline_m=float(baseline),
        fixed_frames=np.arange(len(data.Ts_vo_cam)) == 0,
    )


def solve_ours(data: StereoData, huber_px: float | None, step_tol_sigma: float = TIGHT_STEP_SIGMA) -> Solved:
    """`adjust_bundle` until no unknown moves any more; compiled before the clock starts."""
    problem = bundle_problem(data)
    settings = BundleSettings(
        loss=BundleLoss.NONE if huber_px is None else BundleLoss.HUBER,
        loss_scale=huber_px or 1.0,
        iterations_max=ITERATIONS_MAX,
        step_tol_sigma=step_tol_sigma,
        inlier_sigma=1e6,  # the data hold gross errors that plain squares keep: nothing may be judged here
        inliers_min_frac=0.0,
    )
    adjust_bundle(problem, settings)
    started = time.thread_time()
    result = adjust_bundle(problem, settings)
    spent = time.thread_time() - started
    ending = f"{result.status.value} {result.reason}".strip()
    return Solved("longreach", result.Ts_vo_cam, result.points_vo, result.iterations, spent, ending)


def solve_gtsam(data: StereoData, huber_px: float | None) -> Solved:
    """GenericStereoFactor3D and gtsam's Levenberg-Marquardt, tolerances as tight as ours."""
    import gtsam

    X, L = gtsam.symbol_shorthand.X, gtsam.symbol_shorthand.L
    fx, fy, skew, u0, v0, baseline = data.calibration
    calibration = gtsam.Cal3_S2Stereo(fx, fy, skew, u0, v0, baseline)
    noise = gtsam.noiseModel.Isotropic.Sigma(3, 1.0)
    if huber_px is not None:
        noise = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(huber_px), noise)
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for number, T in enumerate(data.Ts_vo_cam):
        start.insert(X(number), gtsam.Pose3(T))
    for number, point in enumerate(data.points_vo):
        start.insert(L(number), point)
    for frame, point, (left, right, row) in zip(data.frames, data.points, data.measured_px, strict=True):
        seen = gtsam.StereoPoint2(left, right, row)
        graph.add(gtsam.GenericStereoFactor3D(seen, noise, X(int(frame)), L(int(point)), calibration))
    graph.add(gtsam.NonlinearEqualityPose3(X(0), gtsam.Pose3(data.Ts_vo_cam[0])))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(ITERATIONS_MAX)
    parameters.setRelativeErrorTol(1e-14)
    parameters.setAbsoluteErrorTol(1e-12)
    started = time.process_time()  # gtsam may use several threads
    optimiser = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters)
    values = optimiser.optimize()
    spent = time.process_time() - started
    Ts = np.array([values.atPose3(X(number)).matrix() for number in range(len(data.Ts_vo_cam))])
    points = np.array([values.atPoint3(L(number)) for number in range(len(data.points_vo))])
    return Solved("gtsam", Ts, points, optimiser.iterations(), spent, f"its own cost {optimiser.error():.6f}")
