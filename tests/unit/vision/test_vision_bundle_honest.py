"""The covariance holds the error: normalised squared errors over many simulated windows."""

import numpy as np
import pytest
from bundle_scenes import errors, make_scene
from scipy.stats import chi2

from server.vision.bundle import adjust_bundle
from server.vision.bundle_contracts import BundleLoss, BundleSettings, BundleStatus

windowed = pytest.mark.parametrize("windows", [50, pytest.param(200, marks=pytest.mark.slow)])  # the same limits


def joint_squares(windows, loss, **scene_arguments):
    """Squared Mahalanobis error of all free poses of each window."""
    poses = []
    for seed in range(windows):
        scene = make_scene(np.random.default_rng([17, seed]), n_frames=4, n_points=60, **scene_arguments)
        found = adjust_bundle(scene.problem, BundleSettings(loss=loss, iterations_max=200))
        assert found.status is BundleStatus.OK, found.reason
        error = errors(scene.Ts_vo_cam, found.Ts_vo_cam)[1:].ravel()
        covariance = found.joint_covariance[6:24, 6:24]
        poses.append(error @ np.linalg.solve(covariance, error))
    return np.array(poses)


@windowed
@pytest.mark.parametrize("loss", list(BundleLoss))
def test_poses_are_as_far_off_as_their_covariance_says(loss, windows):
    poses = joint_squares(windows, loss)
    low, high = chi2.ppf([0.001, 0.999], 18 * windows)
    assert low < poses.sum() < high
    inside = (poses < chi2.ppf(0.95, 18)).mean()
    assert 0.90 < inside < 0.985


@windowed
@pytest.mark.parametrize("loss", [BundleLoss.HUBER, BundleLoss.CAUCHY])
def test_outliers_leave_the_covariance_honest(loss, windows):
    poses = joint_squares(windows, loss, outlier_frac=0.1)
    assert 0.9 < poses.mean() / 18.0 < 1.1


@windowed
def test_sigmas_that_are_too_small_leave_the_covariance_honest(windows):
    poses = joint_squares(windows, BundleLoss.HUBER, noise=2.5)
    assert 0.9 < poses.mean() / 18.0 < 1.15
