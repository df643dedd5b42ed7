"""Bundle adjustment: the truth from exact rays, the same answer in any order, gauge, outliers."""

from dataclasses import replace

import numpy as np
import pytest
from bundle_scenes import SIGMA_PX, Scene, errors, make_scene, moved, only, rays_of

from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from server.vision.bundle import adjust_bundle
from server.vision.bundle_contracts import BundleLoss, BundleSettings, BundleStatus

TIGHT = BundleSettings(step_tol_sigma=1e-6, iterations_max=100)
SQUARES = replace(TIGHT, loss=BundleLoss.NONE)


@pytest.mark.parametrize("loss", list(BundleLoss))
@pytest.mark.parametrize("n_frames", [2, 3, 8])
def test_exact_rays_give_the_truth(loss, n_frames):
    scene = make_scene(np.random.default_rng(n_frames), n_frames=n_frames, noise=0.0)
    found = adjust_bundle(scene.problem, replace(TIGHT, loss=loss))
    assert found.status is BundleStatus.OK
    assert np.abs(found.Ts_vo_cam - scene.Ts_vo_cam).max() < 1e-9
    seen, rays = scene.problem.point_indices, (~np.isnan(scene.problem.rays)).sum(axis=1)
    known = np.bincount(seen, rays, minlength=len(scene.points_vo)) > 2  # not those that one eye saw once
    assert known.mean() > 0.85
    assert np.abs(found.points_vo - scene.points_vo)[known].max() < 1e-9, "m"
    assert found.inliers.all()
    assert found.cost_after < 1e-9 < found.cost_before


def test_exact_rays_of_a_rectified_pair_give_the_truth():
    scene = make_scene(np.random.default_rng(1), noise=0.0)
    found = adjust_bundle(replace(scene.problem, rays=scene.problem.rays[:, :3].copy()), TIGHT)
    assert found.status is BundleStatus.OK
    assert np.abs(found.Ts_vo_cam - scene.Ts_vo_cam).max() < 1e-9


def test_far_points_and_a_bad_depth_start_converge():
    """KITTI-like: depths to 200 m, half of the points started at half or twice their depth."""
    rng = np.random.default_rng(2)
    Ts = np.array(
        [pose(rotation_from_rotvec(0.01 * rng.normal(size=3)), np.array([0.0, 0.0, 0.9 * k])) for k in range(6)]
    )
    depth = np.exp(rng.uniform(np.log(8.0), np.log(200.0), 150))
    points = np.column_stack([rng.uniform(-0.6, 0.6, 150) * depth, rng.uniform(-0.2, 0.2, 150) * depth, depth])
    frames, seen = np.nonzero(np.ones((6, 150)))
    scene = make_scene(rng)
    problem = replace(
        scene.problem,
        Ts_vo_cam=np.array([T if k == 0 else moved(T, rng, 0.01, 0.1) for k, T in enumerate(Ts)]),
        points_vo=points * np.exp2(rng.integers(-1, 2, (150, 1))),
        frame_indices=frames,
        point_indices=seen,
        rays=rays_of(Ts, points, frames, seen, 0.54),
        sigma_px=np.full((len(frames), 2), 0.3),
        baseline_m=0.54,
        fixed_frames=np.arange(6) == 0,
    )
    found = adjust_bundle(problem, SQUARES)
    assert found.status is BundleStatus.OK
    assert found.iterations < 20
    assert np.abs(found.Ts_vo_cam - Ts).max() < 1e-8


def test_order_of_points_frames_and_observations_changes_nothing():
    rng = np.random.default_rng(3)
    scene = make_scene(rng, outlier_frac=0.05)
    problem = scene.problem
    k, m, n = 5, len(problem.points_vo), len(problem.frame_indices)
    frame_order, point_order, row_order = rng.permutation(k), rng.permutation(m), rng.permutation(n)
    new_frame, new_point = np.argsort(frame_order), np.argsort(point_order)
    shuffled = replace(
        problem,
        Ts_vo_cam=problem.Ts_vo_cam[frame_order],
        fixed_frames=problem.fixed_frames[frame_order],
        points_vo=problem.points_vo[point_order],
        frame_indices=new_frame[problem.frame_indices[row_order]],
        point_indices=new_point[problem.point_indices[row_order]],
        rays=problem.rays[row_order],
        sigma_px=problem.sigma_px[row_order],
    )
    one, two = adjust_bundle(problem, TIGHT), adjust_bundle(shuffled, TIGHT)
    assert one.status is two.status is BundleStatus.OK
    assert np.abs(one.Ts_vo_cam[frame_order] - two.Ts_vo_cam).max() < 1e-9
    assert np.abs(one.points_vo[point_order] - two.points_vo).max() < 1e-8
    assert one.covariances[frame_order] == pytest.approx(two.covariances, rel=1e-5, abs=1e-14)
    assert (one.inliers[row_order] == two.inliers).all()
    assert one.cost_after == pytest.approx(two.cost_after, rel=1e-9)


def test_another_gauge_gives_the_same_shape():
    scene = make_scene(np.random.default_rng(4))
    problem = replace(scene.problem, Ts_vo_cam=scene.Ts_vo_cam)
    one = adjust_bundle(problem, SQUARES)
    two = adjust_bundle(replace(problem, fixed_frames=np.arange(5) == 3), SQUARES)
    relative_one = np.linalg.inv(one.Ts_vo_cam[1]) @ one.Ts_vo_cam[4]
    relative_two = np.linalg.inv(two.Ts_vo_cam[1]) @ two.Ts_vo_cam[4]
    assert one.cost_after == pytest.approx(two.cost_after, rel=1e-9)
    assert np.abs(relative_one - relative_two).max() < 1e-9
    assert (one.covariances[0] == 0.0).all()
    assert (two.covariances[3] == 0.0).all()


def test_no_gauge_is_degenerate_and_says_so():
    scene = make_scene(np.random.default_rng(7))
    found = adjust_bundle(replace(scene.problem, fixed_frames=np.zeros(5, dtype=bool)))
    assert found.status is BundleStatus.DEGENERATE
    assert "fixed" in found.reason


def test_one_eye_only_has_no_scale_and_says_so():
    scene = make_scene(np.random.default_rng(8), one_eye_frac=1.1)
    found = adjust_bundle(scene.problem, SQUARES)
    assert found.status is BundleStatus.DEGENERATE
    assert found.covariances[1][3, 3] > 1.0


@pytest.mark.parametrize("loss", [BundleLoss.HUBER, BundleLoss.CAUCHY])
def test_a_fifth_of_wrong_rays_does_not_move_the_poses(loss):
    for seed in range(5):
        clean = make_scene(np.random.default_rng(seed), n_points=120)
        problem = clean.problem
        rng = np.random.default_rng(100 + seed)
        wrong = rng.random(len(problem.rays)) < 0.2
        uv = problem.rays.copy()
        uv[wrong] += (
            rng.uniform(10.0, 40.0, (int(wrong.sum()), 1)) / 528.0 * rng.choice([-1.0, 1.0], (int(wrong.sum()), 4))
        )
        found = adjust_bundle(replace(problem, rays=uv), replace(TIGHT, loss=loss))
        best = adjust_bundle(only(problem, ~wrong), SQUARES)
        assert found.status is BundleStatus.OK
        sigma = np.sqrt(np.diagonal(best.covariances[1:], axis1=1, axis2=2))
        assert (np.abs(errors(best.Ts_vo_cam, found.Ts_vo_cam)[1:]) < 1.5 * sigma).all(), "of what noise alone does"
        redundant = (
            np.bincount(problem.point_indices)[problem.point_indices] >= 4
        )  # with fewer rays, wrong ones may fit each other
        assert found.inliers[wrong & redundant].mean() < 0.01
        assert found.inliers[~wrong].mean() > 0.9


def test_squares_alone_are_moved_by_wrong_rays():
    """What the loss is for: without it the same rays spoil everything, and the result is not believed or far off."""
    scene = make_scene(np.random.default_rng(0), n_points=120, outlier_frac=0.2)
    robust, squares = adjust_bundle(scene.problem, TIGHT), adjust_bundle(scene.problem, SQUARES)
    robust_m = np.abs(errors(scene.Ts_vo_cam, robust.Ts_vo_cam)[:, 3:]).max()
    squares_m = np.abs(errors(scene.Ts_vo_cam, squares.Ts_vo_cam)[:, 3:]).max()
    assert squares_m > 5.0 * robust_m


def test_sigma_too_small_is_found_and_passed_on():
    scene = make_scene(np.random.default_rng(12), noise=3.0, n_points=150)
    found = adjust_bundle(scene.problem, TIGHT)
    assert found.status is BundleStatus.OK
    assert found.rms_sigma == pytest.approx(3.0, rel=0.15)
    assert found.variance_factor == pytest.approx(9.0, rel=0.3)


def test_a_point_behind_the_eye_is_left_out():
    scene = make_scene(np.random.default_rng(13), noise=0.0)
    points = scene.problem.points_vo.copy()
    points[:3, 2] = -1.0
    found = adjust_bundle(replace(scene.problem, points_vo=points), TIGHT)
    behind = scene.problem.point_indices < 3
    assert found.status is BundleStatus.OK
    assert np.abs(found.Ts_vo_cam - scene.Ts_vo_cam).max() < 1e-9
    assert not found.inliers[behind].any()


def test_few_iterations_say_that_they_did_not_suffice():
    scene = make_scene(np.random.default_rng(14))
    found = adjust_bundle(scene.problem, BundleSettings(iterations_max=1))
    assert found.status is BundleStatus.NOT_CONVERGED
    assert found.cost_after < found.cost_before


def test_the_problem_is_not_changed():
    scene = make_scene(np.random.default_rng(15), outlier_frac=0.1)
    before = {name: np.array(getattr(scene.problem, name)) for name in ("Ts_vo_cam", "points_vo", "rays", "sigma_px")}
    adjust_bundle(scene.problem)
    for name, array in before.items():
        assert np.array_equal(getattr(scene.problem, name), array, equal_nan=True)


def test_frames_that_agree_on_nothing_are_not_believed():
    rng = np.random.default_rng(16)
    scene: Scene = make_scene(rng)
    noise = rng.uniform(-0.5, 0.5, scene.problem.rays.shape)
    found = adjust_bundle(replace(scene.problem, rays=noise), BundleSettings())
    assert found.status is not BundleStatus.OK or found.variance_factor > (10.0 / SIGMA_PX) ** 2
