"""Teaching a layout: right, honest about how well, and silent where the views do not tell."""

from dataclasses import replace

import numpy as np
import pytest
from vision_prints import photographed, printed
from vision_scenes import deviation, machine
from vision_teaching import looking_at, seen_view, true_layout, ways

from machine.poses import inverse_pose, pose
from machine.rotations import rotation_from_rotvec
from server.vision.marker_search import dictionary_by_name
from server.vision.teach import LayoutFrame, TeachTask, teach_layout
from server.vision.teach_contracts import TeachSettings, TeachStatus, angle_sigma_rad, position_sigma_m
from server.vision.teach_fit import LayoutState, Priors, fit_layout, free_rows, residuals_px, stepped_state
from server.vision.teach_start import SeenViews, corners_of
from server.vision.teach_views import OfferedView, ViewKeeper, teach_view

CAMERA = machine().camera
SETTINGS = TeachSettings()
CHI2_6_95 = 12.592


def task_of(markers, printed=None, name="reference", present=None):
    ids = tuple(marker.marker_id for marker in markers)
    sides = {marker.marker_id: marker.side_m for marker in markers} if printed is None else printed
    first = {ids[0]: (markers[0].T_on_marker, markers[0].side_m)} if present is None else present
    return TeachTask(ids, sides, LayoutFrame(name, first))


def taught(markers, views, **options):
    return teach_layout(views, task_of(markers, **options), CAMERA, SETTINGS)


def test_a_rendered_layout_is_measured_to_tenths_of_a_millimetre():
    rng = np.random.default_rng(11)
    markers = true_layout(rng)
    boards, dictionary = printed("DICT_4X4_50", *markers), dictionary_by_name("DICT_4X4_50")
    views = [
        teach_view(*photographed(boards, T, rng), dictionary, (1, 2, 3, 4), CAMERA)
        for T in ways(rng, n=8, distance_m=(0.7, 1.3))
    ]
    found = taught(markers, views)
    assert found.status is TeachStatus.OK, found.reason
    for one, marker in zip(found.markers, markers, strict=True):
        apart = deviation(one.T_on_marker, marker.T_on_marker)
        assert 1e3 * np.linalg.norm(apart[3:]) < min(0.3, 3e3 * position_sigma_m(one) + 0.02)
        assert np.rad2deg(np.linalg.norm(apart[:3])) < 0.1
        assert abs(one.stereo_side_m - marker.side_m) < 3.0 * one.stereo_side_sigma_m + 2e-5
        assert one.n_views == 8
    assert found.sigma_mm < 0.5
    assert found.residual_rms_px < 0.05


def worlds(n, seed):
    """Layouts whose true sides and baseline differ from the file as the settings say; the taught layouts."""
    for k in range(n):
        rng = np.random.default_rng([seed, k])
        known = true_layout(rng, n=3, side_m=0.12)
        true = [replace(one, side_m=one.side_m + rng.normal(0.0, SETTINGS.side_sigma_m)) for one in known]
        scale = rng.normal(0.0, SETTINGS.baseline_sigma_frac)
        camera = replace(CAMERA, baseline_m=CAMERA.baseline_m * (1.0 + scale))
        views = [seen_view(true, T, rng, SETTINGS.sigma_px, camera=camera) for T in ways(rng, n=8)]
        yield true, scale, taught(known, views)


@pytest.mark.parametrize("n", [60, pytest.param(1000, marks=pytest.mark.slow)])
def test_the_covariance_is_honest(n):
    squares, sides, scales, refused = [], [], [], 0
    for true, scale, found in worlds(n, seed=5):
        if found.status is not TeachStatus.OK:
            assert "side_m" in found.reason, "a side four sigma off its print"
            refused += 1
            continue
        for one, marker in list(zip(found.markers, true, strict=True))[1:]:
            apart = deviation(one.T_on_marker, marker.T_on_marker)
            squares.append(apart @ np.linalg.solve(one.covariance, apart))
        sides += [
            (one.side_m - marker.side_m) / one.side_sigma_m for one, marker in zip(found.markers, true, strict=True)
        ]
        scales.append((found.baseline_frac - scale) / found.baseline_sigma_frac)
    assert refused <= n // 200
    spread = 3.0 * np.sqrt(12.0 / n)  # three sigma of a mean of chi2(6); the two markers of a world hang together
    assert 6.0 - spread < np.mean(squares) < 6.0 + spread
    assert abs(np.mean(np.array(squares) < CHI2_6_95) - 0.95) < 3.0 * np.sqrt(0.05 * 0.95 / n)
    assert 0.75 < np.std(sides) < 1.25
    assert 0.7 < np.std(scales) < 1.3


def test_larger_noise_than_assumed_enlarges_the_covariance():
    rng = np.random.default_rng(8)
    markers = true_layout(rng)
    calm, noisy = (
        taught(markers, [seen_view(markers, T, rng, sigma, camera=CAMERA) for T in ways(rng, n=10)])
        for sigma in (0.06, 0.3)
    )
    assert calm.status is noisy.status is TeachStatus.OK
    ratio = angle_sigma_rad(noisy.markers[2]) / angle_sigma_rad(calm.markers[2])
    assert 3.0 < ratio < 7.0


def test_frames_differ_by_a_rigid_motion_only():
    rng = np.random.default_rng(9)
    markers = true_layout(rng)
    views = [seen_view(markers, T) for T in ways(rng)]
    shifted = pose(rotation_from_rotvec(np.array([0.01, -0.02, 0.03])), np.array([0.004, 0.002, -0.003]))
    present = {one.marker_id: (shifted @ one.T_on_marker, one.side_m) for one in markers}
    by_name = {name: taught(markers, views, name=name, present=present) for name in ("present", "reference", "middle")}
    for found in by_name.values():
        assert found.status is TeachStatus.OK, found.reason
        for k, marker in enumerate(markers):
            T = inverse_pose(found.markers[0].T_on_marker) @ found.markers[k].T_on_marker
            true = inverse_pose(markers[0].T_on_marker) @ marker.T_on_marker
            assert np.abs(T - true).max() < 1e-6
    for name in ("present", "reference"):
        for k, marker in enumerate(markers):
            assert np.abs(by_name[name].markers[k].T_on_marker - shifted @ marker.T_on_marker).max() < 1e-6
    middle = np.array([one.T_on_marker[:3, 3] for one in by_name["middle"].markers])
    assert np.abs(middle.mean(axis=0)).max() < 1e-9
    assert by_name["middle"].markers[0].T_on_marker[1, 0] == pytest.approx(0.0, abs=1e-9)
    assert position_sigma_m(by_name["reference"].markers[0]) < 1e-9  # it is the frame
    assert position_sigma_m(by_name["middle"].markers[0]) > 1e-6


def test_unknown_sides_come_from_the_baseline():
    rng = np.random.default_rng(10)
    markers = true_layout(rng)
    views = [seen_view(markers, T, rng, 0.06) for T in ways(rng)]
    found = taught(markers, views, printed={1: 0.15})
    assert found.status is TeachStatus.OK, found.reason
    for one in found.markers:
        assert abs(one.side_m - 0.15) < 3.0 * one.side_sigma_m
        assert one.side_sigma_m < 0.0003
    assert found.markers[1].printed_side_m is None
    free = taught(markers, views, printed={})
    assert free.status is TeachStatus.OK
    assert free.baseline_sigma_frac == pytest.approx(SETTINGS.baseline_sigma_frac, rel=0.01)


def views_of(markers, rng, n=10, sigma_px=0.06):
    return [seen_view(markers, T, rng, sigma_px) for T in ways(rng, n=n)]


def one_view_only(markers, rng):
    return views_of(markers, rng, n=1)


def one_place_many_times(markers, rng):
    return [seen_view(markers, looking_at((0.1, 0.1, 0.9)), rng, 0.06) for _ in range(12)]


def a_narrow_cone(markers, rng):
    return [seen_view(markers, looking_at((x, 0.0, 0.9)), rng, 0.06) for x in np.linspace(-0.09, 0.09, 12)]


def never_together(markers, rng):
    return [seen_view(markers, T, rng, 0.06, hidden=(1, 2) if k % 2 else (3, 4)) for k, T in enumerate(ways(rng, n=12))]


def one_never_seen(markers, rng):
    return [seen_view(markers, T, rng, 0.06, hidden=(4,)) for T in ways(rng)]


def an_id_twice(markers, rng):
    views = views_of(markers, rng)
    return [*views[:4], replace(views[4], repeated_ids=frozenset({2})), *views[5:]]


def a_marker_that_moved(markers, rng):
    places = ways(rng, n=12)
    T = pose(rotation_from_rotvec(np.array([0.0, 0.0, 0.01])), np.array([0.003, 0.0, 0.0])) @ markers[2].T_on_marker
    later = [*markers[:2], replace(markers[2], T_on_marker=T), *markers[3:]]
    return [seen_view(markers if k < 6 else later, one, rng, 0.06) for k, one in enumerate(places)]


def a_wrong_side(markers, rng):
    return views_of([replace(markers[0]), replace(markers[1], side_m=0.1485), *markers[2:]], rng)


def a_scaled_print(markers, rng):
    return views_of([replace(one, side_m=one.side_m * 0.97) for one in markers], rng)


def too_far(markers, rng):
    return [seen_view(markers, T, rng, 0.4) for T in ways(rng, n=5, distance_m=(2.5, 3.0), spread_deg=12.0)]


REFUSED = [
    (one_view_only, TeachStatus.TOO_FEW_VIEWS, "1 views differ"),
    (one_place_many_times, TeachStatus.TOO_ALIKE, "move the camera"),
    (a_narrow_cone, TeachStatus.TOO_ALIKE, "limit 15 deg"),
    (never_together, TeachStatus.NOT_CONNECTED, "markers {1, 2} and {3, 4} are never seen together"),
    (one_never_seen, TeachStatus.NO_MARKERS, "marker 4 is in no view"),
    (an_id_twice, TeachStatus.CONTRADICTION, "marker id 2 is seen at two places in view 5"),
    (a_marker_that_moved, TeachStatus.CONTRADICTION, "marker 3 moved"),
    (a_wrong_side, TeachStatus.CONTRADICTION, "marker 2: side_m = 0.15 m, but the images say 0.148"),
    (a_scaled_print, TeachStatus.CONTRADICTION, "the printed sides look -3.0"),
    (too_far, TeachStatus.NOT_DETERMINED, "come closer"),
]


@pytest.mark.parametrize(("scene", "status", "words"), REFUSED, ids=[row[0].__name__ for row in REFUSED])
def test_what_the_views_do_not_tell_is_refused_with_a_reason(scene, status, words):
    rng = np.random.default_rng(12)
    markers = true_layout(rng)
    found = taught(markers, scene(markers, rng))
    assert found.status is status, found.reason
    assert words in found.reason
    assert found.markers == ()


def test_no_views_and_no_layout_are_refused():
    markers = true_layout(np.random.default_rng(1))
    assert taught(markers, []).status is TeachStatus.NO_MARKERS
    assert taught(markers[:1], []).status is TeachStatus.NO_MARKERS


def test_two_markers_that_moved_are_both_named():
    rng = np.random.default_rng(13)
    markers = true_layout(rng, n=2)
    found = taught(markers, a_marker_that_moved([*markers, markers[1]], rng)[:6])
    assert found.status is TeachStatus.OK, found.reason
    T = pose(np.eye(3), np.array([0.004, 0.0, 0.0])) @ markers[1].T_on_marker
    later = [markers[0], replace(markers[1], T_on_marker=T)]
    views = [seen_view(markers if k < 6 else later, one, rng, 0.06) for k, one in enumerate(ways(rng, n=12))]
    found = taught(markers, views)
    assert found.status is TeachStatus.CONTRADICTION
    assert "markers 1, 2 moved against each other" in found.reason


def test_a_single_bad_sighting_is_left_out_and_told():
    rng = np.random.default_rng(14)
    markers = true_layout(rng)
    views = views_of(markers, rng, n=12)
    spoiled = dict(views[3].left_corners_px) | {2: np.asarray(views[3].left_corners_px[2]) + 4.0}
    views[3] = replace(views[3], left_corners_px=spoiled)
    found = taught(markers, views)
    assert found.status is TeachStatus.OK, found.reason
    assert "1 sightings" in found.notes[0]
    assert found.markers[1].n_views == 11
    for one, marker in zip(found.markers, markers, strict=True):
        assert 1e3 * np.linalg.norm(deviation(one.T_on_marker, marker.T_on_marker)[3:]) < 0.5


def test_seen_by_one_eye_only_still_counts():
    rng = np.random.default_rng(15)
    markers = true_layout(rng)
    views = [replace(view, right_corners_px={1: view.right_corners_px[1]}) for view in views_of(markers, rng, n=12)]
    found = taught(markers, views)
    assert found.status is TeachStatus.OK, found.reason


def test_jacobian_and_covariance_against_finite_differences():
    rng = np.random.default_rng(16)
    markers = true_layout(rng, n=3)
    views = views_of(markers, rng, n=4)
    seen = SeenViews((1, 2, 3), tuple(views))
    corners = corners_of(seen, CAMERA)
    T_ref = inverse_pose(markers[0].T_on_marker)
    state = LayoutState(
        np.array([T_ref @ one.T_on_marker for one in markers]),
        np.array([T @ markers[0].T_on_marker for T in ways(np.random.default_rng(17), n=4)]),
        np.full(3, 0.15),
        0.0,
    )
    priors = Priors(np.full(3, 0.15), np.full(3, 2e-4), 2e-3, 0.06)
    fit = fit_layout(state, corners, priors)

    def column(step, views_step=None):
        def at(sign):
            other = stepped_state(fit.state, sign * step)
            if views_step is not None:
                Ts = other.Ts_cam_ref.copy()
                for T, one in zip(Ts, sign * views_step, strict=True):
                    T[:3, :3] = rotation_from_rotvec(one[:3]) @ T[:3, :3]
                    T[:3, 3] += one[3:]
                other = replace(other, Ts_cam_ref=Ts)
            return residuals_px(other, corners).ravel()

        return (at(1.0) - at(-1.0)) / 2e-6

    k, free = 7 * 3 + 1, free_rows(3)
    J = np.column_stack(
        [column(1e-6 * np.eye(k)[row]) for row in free]
        + [column(np.zeros(k), 1e-6 * np.eye(24)[row].reshape(4, 6)) for row in range(24)]
    )
    information = J.T @ J / 0.06**2
    for place, row in enumerate(free):
        if row % 7 == 6 and row < 21:
            information[place, place] += 1.0 / 2e-4**2
    information[len(free) - 1, len(free) - 1] += 1.0 / 2e-3**2
    expected = np.linalg.inv(information)[: len(free), : len(free)]
    found = fit.covariance[np.ix_(free, free)]
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((found - expected) / scale).max() < 1e-3


def test_the_keeper_takes_what_rests_and_is_new():
    rng = np.random.default_rng(18)
    markers = true_layout(rng)
    keeper = ViewKeeper(CAMERA, SETTINGS)
    first, second = looking_at((0.0, 0.0, 0.9)), looking_at((0.2, 0.0, 0.9))

    def offer(T, hidden=()):
        return keeper.keep_if_new(seen_view(markers, T, rng, 0.05, hidden=hidden))

    assert [offer(first) for _ in range(3)] == [OfferedView.MOVING, OfferedView.MOVING, OfferedView.TAKEN]
    assert offer(first) is OfferedView.ALIKE
    moving = [offer(looking_at((x, 0.0, 0.9))) for x in np.linspace(0.02, 0.2, 6)]
    assert set(moving) == {OfferedView.MOVING}
    assert [offer(second) for _ in range(2)] == [OfferedView.MOVING, OfferedView.TAKEN]
    assert offer(second, hidden=(2, 3, 4)) is OfferedView.TOO_FEW_MARKERS
    assert offer(looking_at((0.0, 0.0, 0.9), roll_deg=20.0)) is OfferedView.MOVING
    assert [offer(looking_at((0.0, 0.0, 0.9), roll_deg=20.0)) for _ in range(3)][
        -1
    ] is OfferedView.ALIKE  # a roll tells nothing
    assert [offer(looking_at((0.0, 0.0, 1.2))) for _ in range(3)][-1] is OfferedView.TAKEN
    assert len(keeper.views) == 3


def test_a_marker_at_two_places_is_told_by_the_search():
    rng = np.random.default_rng(19)
    markers = true_layout(rng)
    twin = replace(markers[0], T_on_marker=pose(np.eye(3), np.zeros(3)))
    images = photographed(printed("DICT_4X4_50", *markers, twin), looking_at((0.0, 0.0, 0.9)), rng)
    view = teach_view(*images, dictionary_by_name("DICT_4X4_50"), (1, 2, 3, 4), CAMERA)
    assert view.repeated_ids == {1}
    assert 1 not in view.left_corners_px
