"""Whatever the numbers are: a status, never an exception, never a confident pose."""

from dataclasses import replace

import numpy as np
import pytest
from bundle_scenes import errors, make_scene, only, rays_of
from hypothesis import given, settings
from hypothesis import strategies as st

from server.vision.bundle import adjust_bundle
from server.vision.bundle_contracts import BundleInputError, BundleLoss, BundleProblem, BundleSettings, BundleStatus

NASTY = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0.0, -1.0, 1e-300, 1e300, -1e12, float("nan"), float("inf")]),
    st.floats(-2.0, 2.0),
)


def well_formed(problem, found):
    k, m, n = len(problem.Ts_vo_cam), len(problem.points_vo), len(problem.frame_indices)
    assert found.Ts_vo_cam.shape == (k, 4, 4)
    assert found.points_vo.shape == (m, 3)
    assert found.covariances.shape == (k, 6, 6)
    assert found.inliers.shape == (n,)
    if found.status is BundleStatus.DEGENERATE:
        assert found.reason
        assert (np.diagonal(found.covariances, axis1=1, axis2=2) > 1.0).all()
        assert not found.inliers.any()
    else:
        assert np.isfinite(found.Ts_vo_cam).all()
        assert np.isfinite(found.covariances).all()
        assert np.linalg.eigvalsh(found.joint_covariance).min() > -1e-9


def not_believed(problem, **changes):
    changed = replace(problem, **changes)
    found = adjust_bundle(changed)
    well_formed(changed, found)
    return found.status is BundleStatus.DEGENERATE


@pytest.fixture(scope="module")
def problem():
    return make_scene(np.random.default_rng(1), n_frames=3, n_points=20).problem


def test_nothing_at_all():
    empty = BundleProblem(
        Ts_vo_cam=np.zeros((0, 4, 4)),
        points_vo=np.zeros((0, 3)),
        frame_indices=np.zeros(0, dtype=np.int64),
        point_indices=np.zeros(0, dtype=np.int64),
        rays=np.zeros((0, 4)),
        sigma_px=np.zeros((0, 2)),
        focal_px=(500.0, 500.0),
        baseline_m=0.1,
        fixed_frames=np.zeros(0, dtype=bool),
    )
    found = adjust_bundle(empty)
    assert found.status is BundleStatus.DEGENERATE
    well_formed(empty, found)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e200])
def test_numbers_that_are_none(problem, bad):
    Ts, points, uv, sigma = (
        np.array(array) for array in (problem.Ts_vo_cam, problem.points_vo, problem.rays, problem.sigma_px)
    )
    Ts[1, 0, 3] = bad
    points[0] = bad
    uv[3, 0] = bad
    sigma[4] = bad
    assert not_believed(problem, Ts_vo_cam=Ts)
    assert not_believed(problem, points_vo=points)
    assert not_believed(problem, rays=uv) or np.isnan(bad)
    assert not_believed(problem, sigma_px=sigma)
    assert not_believed(problem, focal_px=(bad, 500.0))
    assert not_believed(problem, baseline_m=bad)


@pytest.mark.parametrize("bad", [0.0, -0.1])
def test_sigma_focal_length_and_baseline_have_to_be_positive(problem, bad):
    sigma = problem.sigma_px.copy()
    sigma[2, 0] = bad
    assert not_believed(problem, sigma_px=sigma)
    assert not_believed(problem, focal_px=(500.0, bad))
    assert not_believed(problem, baseline_m=bad)


def test_a_matrix_that_is_no_rotation(problem):
    Ts = problem.Ts_vo_cam.copy()
    Ts[1, :3, :3] *= 1.01
    assert not_believed(problem, Ts_vo_cam=Ts)
    Ts[1, :3, :3] = np.diag([1.0, 1.0, -1.0])
    assert not_believed(problem, Ts_vo_cam=Ts)


def test_a_frame_that_sees_nothing_is_named(problem):
    found = adjust_bundle(only(problem, problem.frame_indices != 2))
    assert found.status is BundleStatus.DEGENERATE
    assert "frame 2" in found.reason


@pytest.mark.parametrize("n_points", [1, 2])
def test_too_few_points_determine_no_pose(n_points):
    scene = make_scene(np.random.default_rng(2), n_frames=2, n_points=n_points, seen_frac=1.1, one_eye_frac=0.0)
    assert adjust_bundle(scene.problem).status is BundleStatus.DEGENERATE


def test_points_on_one_line_determine_no_pose():
    scene = make_scene(np.random.default_rng(3), n_frames=2, n_points=30, seen_frac=1.1, one_eye_frac=0.0)
    line = np.array([0.1, 0.0, 1.3]) + np.linspace(-0.4, 0.4, 30)[:, None] * np.array([1.0, 0.2, 0.1])
    uv = rays_of(scene.Ts_vo_cam, line, scene.problem.frame_indices, scene.problem.point_indices)
    found = adjust_bundle(replace(scene.problem, points_vo=line, rays=uv))
    assert found.status is BundleStatus.DEGENERATE


def test_all_points_behind_the_eyes(problem):
    behind = problem.points_vo * np.array([1.0, 1.0, -1.0])
    assert not_believed(problem, points_vo=behind)


def test_rays_of_another_place_are_not_believed():
    """Frame 2's rays belong to other points altogether: its pose must not come back as if it were known."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        scene = make_scene(rng, n_frames=3, n_points=60)
        uv = scene.problem.rays.copy()
        own = np.flatnonzero(scene.problem.frame_indices == 2)
        uv[own] = uv[rng.permutation(own)]
        found = adjust_bundle(replace(scene.problem, rays=uv))
        error = np.abs(errors(scene.Ts_vo_cam, found.Ts_vo_cam)[2])
        sigma = np.sqrt(np.diag(found.covariances[2]))
        assert found.status is not BundleStatus.OK or (error < 5.0 * sigma).all(), found.reason


@pytest.mark.parametrize(
    "changes",
    [
        {"points_vo": np.zeros((3, 2))},
        {"Ts_vo_cam": np.zeros((3, 3, 4))},
        {"rays": np.zeros((5, 4))},
        {"rays": np.zeros(7)},
        {"fixed_frames": np.ones(9, dtype=bool)},
        {"frame_indices": np.array([0, 1, 7])},
    ],
)
def test_arrays_that_do_not_fit_together_raise(problem, changes):
    with pytest.raises(BundleInputError):
        adjust_bundle(replace(problem, **changes))


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_any_numbers_give_a_status(data):
    """A good problem in which some numbers were replaced by anything."""
    scene = make_scene(np.random.default_rng(data.draw(st.integers(0, 5))), n_frames=3, n_points=12)
    arrays = {
        name: np.array(getattr(scene.problem, name))
        for name in ("Ts_vo_cam", "points_vo", "rays", "sigma_px", "fixed_frames")
    }
    for _ in range(data.draw(st.integers(1, 6))):
        name = data.draw(st.sampled_from(["Ts_vo_cam", "points_vo", "rays", "sigma_px"]))
        flat = arrays[name].reshape(-1)
        flat[data.draw(st.integers(0, flat.size - 1))] = data.draw(NASTY)
    if data.draw(st.booleans()):
        arrays["fixed_frames"] = np.array(data.draw(st.lists(st.booleans(), min_size=3, max_size=3)))
    changed = replace(scene.problem, **arrays)
    chosen = BundleSettings(
        loss=data.draw(st.sampled_from(list(BundleLoss))), iterations_max=data.draw(st.sampled_from([0, 1, 5, 30]))
    )
    well_formed(changed, adjust_bundle(changed, chosen))


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 10**6), n_frames=st.integers(1, 4), n_points=st.integers(1, 8), scale=st.floats(0.01, 100.0))
def test_noise_instead_of_rays_gives_no_confident_pose(seed, n_frames, n_points, scale):
    rng = np.random.default_rng(seed)
    frames, points = np.nonzero(np.ones((n_frames, n_points)))
    noise = BundleProblem(
        Ts_vo_cam=np.tile(np.eye(4), (n_frames, 1, 1)),
        points_vo=rng.normal(size=(n_points, 3)) * scale + np.array([0.0, 0.0, 1.0]),
        frame_indices=frames,
        point_indices=points,
        rays=rng.normal(size=(len(frames), 4)),
        sigma_px=np.full((len(frames), 2), 0.1),
        focal_px=(500.0, 500.0),
        baseline_m=0.1,
        fixed_frames=np.arange(n_frames) == 0,
    )
    found = adjust_bundle(noise)
    well_formed(noise, found)
    if n_frames > 1 and found.status is BundleStatus.OK:
        assert np.sqrt(np.diagonal(found.covariances[1:], axis1=1, axis2=2)).max() > 1e-3
