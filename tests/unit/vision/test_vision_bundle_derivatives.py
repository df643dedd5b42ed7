"""The compiled system against one built from finite differences of an independent residual, dense, in numpy."""

from dataclasses import replace

import numpy as np
import pytest
from bundle_scenes import FOCAL_PX, SIGMA_PX, make_scene, rays_of

from machine.rotations import rotation_from_rotvec
from server.vision.bundle import adjust_bundle
from server.vision.bundle_contracts import BundleLoss, BundleSettings, kernel_layout_and_start, make_work
from server.vision.bundle_covariance import gaussian_factor
from server.vision.bundle_reduced import assemble, choose_charts
from server.vision.bundle_residuals import CAUCHY, HUBER, NONE, linearise, loss, weight

STEP = 1e-6


def moved(T, step):
    result = T.copy()
    result[:3, :3] = rotation_from_rotvec(step[:3]) @ T[:3, :3]
    result[:3, 3] += step[3:]
    return result


def residual_vector(problem, x):
    """All residuals [sigma] of the start moved by x: free frames, then points."""
    Ts, points = problem.Ts_vo_cam.copy(), problem.points_vo.copy()
    free = np.flatnonzero(~problem.fixed_frames)
    for place, frame in enumerate(free):
        Ts[frame] = moved(Ts[frame], x[6 * place : 6 * place + 6])
    o = 6 * len(free)
    points += x[o:].reshape(-1, 3)
    off = rays_of(Ts, points, problem.frame_indices, problem.point_indices) - problem.rays
    return np.nan_to_num(off * np.tile(FOCAL_PX, 2) / SIGMA_PX).ravel()


def numeric_jacobian(problem, size):
    columns = []
    for k in range(size):
        step = np.zeros(size)
        step[k] = STEP
        columns.append((residual_vector(problem, step) - residual_vector(problem, -step)) / (2.0 * STEP))
    return np.array(columns).T


@pytest.fixture(scope="module")
def scene():
    return make_scene(np.random.default_rng(1), n_frames=4, n_points=27, seen_frac=0.95)


def test_reduced_system_is_the_schur_complement_of_the_numeric_one(scene):
    problem = scene.problem
    layout, start, _ = kernel_layout_and_start(problem, BundleSettings(loss=BundleLoss.NONE))
    work = make_work(layout)
    linearise(layout, start, work)
    choose_charts(layout, start, work)
    assemble(layout, work, 0.0)

    bodies = 6 * layout.n_columns
    size = bodies + 3 * len(problem.points_vo)
    J, r = numeric_jacobian(problem, size), residual_vector(problem, np.zeros(size))
    H, g = J.T @ J, J.T @ r
    eliminated = H[:bodies, bodies:] @ np.linalg.inv(H[bodies:, bodies:])
    expected = H[:bodies, :bodies] - eliminated @ H[bodies:, :bodies]
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    reduced = np.tril(work.reduced_matrix) + np.tril(work.reduced_matrix, -1).T
    assert np.abs((reduced - expected) / scale).max() < 1e-5
    right = g[:bodies] - eliminated @ g[bodies:]
    assert work.reduced_rhs == pytest.approx(right, abs=1e-5 * np.abs(g[:bodies]).max())
    assert work.reduced_diagonal == pytest.approx(np.diag(H)[:bodies], rel=1e-5)


def test_covariances_are_the_inverse_of_the_numeric_system(scene):
    """Poses at the optimum, against the inverse of the whole J^T J."""
    settings = BundleSettings(loss=BundleLoss.NONE, step_tol_sigma=1e-7)
    found = adjust_bundle(scene.problem, settings)
    optimum = replace(scene.problem, Ts_vo_cam=found.Ts_vo_cam, points_vo=found.points_vo)
    J = numeric_jacobian(optimum, 18 + 3 * len(optimum.points_vo))
    whole = found.variance_factor * np.linalg.inv(J.T @ J)
    assert found.joint_covariance[6:, 6:] == pytest.approx(whole[:18, :18], rel=1e-3, abs=1e-5 * whole[:18, :18].max())


@pytest.mark.parametrize("kind", [NONE, HUBER, CAUCHY])
def test_weight_is_the_slope_of_the_loss(kind):
    for square in (0.01, 1.0, 3.9, 4.1, 30.0, 1e4):
        slope = (loss(kind, 2.0, square * (1 + 1e-6)) - loss(kind, 2.0, square * (1 - 1e-6))) / (2e-6 * square)
        assert weight(kind, 2.0, square) == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize(("kind", "scale"), [(NONE, 1.0), (HUBER, 1.0), (HUBER, 2.0), (CAUCHY, 1.0), (CAUCHY, 2.0)])
def test_variance_factor_of_a_loss_is_that_of_many_means(kind, scale):
    """M-estimates of the mean of 40 Gaussian draws in the plane: their variance over that of the plain mean."""
    rng = np.random.default_rng(3)
    draws = rng.normal(size=(4000, 40, 2))
    mean = draws.mean(axis=1)
    for _ in range(30):
        squares = ((draws - mean[:, None]) ** 2).sum(axis=2)
        if kind == HUBER:
            weights = np.minimum(1.0, scale / np.sqrt(squares))
        else:
            weights = np.ones_like(squares) if kind == NONE else 1.0 / (1.0 + squares / scale**2)
        mean = (weights[:, :, None] * draws).sum(axis=1) / weights.sum(axis=1)[:, None]
    assert 40.0 * mean.var() == pytest.approx(gaussian_factor(kind, scale, 2), rel=0.06)
