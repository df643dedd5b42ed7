"""Pose sources on whole images: the same contract for markers in both eyes and for a target that is no marker."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pose_source_contract import DotPlateSource, check_blind, check_contract, draw_dots
from vision_scenes import deviation, machine, renderer, tcp_in_ooi, truth_of

from machine.poses import pose
from server.camera.health.findings import FaultCode
from server.camera.health.markers import MarkerMonitor
from server.vision.aruco_source import ArucoPoseSource, MonoArucoPoseSource
from server.vision.contracts import PoseStatus
from server.vision.detection import EyeDetector
from server.vision.errors import NoMarkersError


@pytest.fixture(scope="module")
def pair_and_truth():
    T_ooi_tcp = tcp_in_ooi(0.5, (0.02, -0.2), (3.0, -2.0, 4.0))
    return renderer().render_static(T_ooi_tcp, np.random.default_rng(1)), truth_of(T_ooi_tcp)


def test_markers_in_both_eyes_keep_the_contract(pair_and_truth):
    pair, truth = pair_and_truth
    observation = check_contract(ArucoPoseSource(machine()), pair, truth, position_m=3e-4, rotation_rad=2e-3)
    assert {view.marker_id for view in observation.marker_views if view.used} == {1, 2, 3, 10}
    assert observation.warnings == tuple(view.reason for view in observation.marker_views if not view.used)


def test_dots_keep_the_same_contract():
    ring = np.array([[np.cos(a), np.sin(a), 0.0] for a in np.linspace(0, 2 * np.pi, 6, endpoint=False)])
    ring[0] *= 0.6
    plates = {"tool": (0.06 * ring + [0, 0, 0.01], 6.0), "ooi": (0.15 * ring, 10.0)}
    T_ooi_tcp = tcp_in_ooi(0.6, (0.3, 0.0), (2.0, 3.0, -5.0))
    truth = truth_of(T_ooi_tcp)
    starts = {name: T @ pose(np.eye(3), np.array([0.004, -0.003, 0.01])) for name, T in truth.items()}
    source = DotPlateSource(machine().camera, plates, starts)
    check_contract(source, draw_dots(machine().camera, truth, plates), truth, position_m=2e-3, rotation_rad=1e-2)


def test_the_papers_mono_source_is_coarser_but_right(pair_and_truth):
    pair, truth = pair_and_truth
    source = MonoArucoPoseSource(machine())
    observation = source.observe(*pair, 1)
    for name, found in (("tool", observation.tool), ("ooi", observation.ooi)):
        assert found.status is PoseStatus.OK
        assert len(found.marker_ids) == 1
        error = deviation(found.T_cam_object, truth[name])
        assert 1e-5 < np.linalg.norm(error[3:]) < 0.1, "m"
    assert all(view.corners_right_px is None for view in observation.marker_views)
    check_blind(source, pair[0].shape)


def test_one_marker_of_the_ooi_is_enough(pair_and_truth):
    pair, truth = pair_and_truth
    seen = ArucoPoseSource(machine()).observe(*pair, 0)
    keep = next(view for view in seen.marker_views if view.marker_id in (1, 2, 3) and view.used)
    images = [image.copy() for image in pair]
    for view in seen.marker_views:
        if view.marker_id in (1, 2, 3) and view.marker_id != keep.marker_id:
            for image, corners in zip(images, (view.corners_left_px, view.corners_right_px), strict=True):
                if corners is not None:
                    x, y = np.round(corners.mean(axis=0)).astype(int)
                    image[y - 12 : y + 12, x - 12 : x + 12] = 128
    found = ArucoPoseSource(machine()).observe(*images, 0).ooi
    assert found.status in (PoseStatus.OK, PoseStatus.ORIENTATION_AMBIGUOUS)
    assert found.marker_ids == (keep.marker_id,)
    assert np.linalg.norm(deviation(found.T_cam_object, truth["ooi"])[3:]) < 2e-3, "m"


def test_one_eye_black_still_gives_poses_and_a_warning(pair_and_truth):
    (left, right), truth = pair_and_truth
    observation = ArucoPoseSource(machine()).observe(left, np.zeros_like(right), 0)
    assert observation.tool.T_cam_object is not None
    assert np.linalg.norm(deviation(observation.tool.T_cam_object, truth["tool"])[3:]) < 3e-3, "m"
    assert any("right image is black" in warning for warning in observation.warnings)


def test_swapped_eyes_are_rejected(pair_and_truth):
    (left, right), _ = pair_and_truth
    observation = ArucoPoseSource(machine()).observe(right, left, 0)
    assert observation.tool.status is PoseStatus.REJECTED
    assert observation.ooi.status is PoseStatus.REJECTED
    assert "swapped" in observation.tool.reason


def test_a_repeated_id_is_flagged_and_not_used(pair_and_truth):
    (left, right), _ = pair_and_truth
    corners = next(
        view for view in ArucoPoseSource(machine()).observe(left, right, 0).marker_views if view.marker_id == 10
    ).corners_left_px
    low, high = corners.min(axis=0).astype(int) - 25, corners.max(axis=0).astype(int) + 25
    doubled = left.copy()
    doubled[20 : 20 + high[1] - low[1], 20 : 20 + high[0] - low[0]] = left[low[1] : high[1], low[0] : high[0]]
    observation = ArucoPoseSource(machine()).observe(doubled, right, 0)
    assert observation.tool.status is PoseStatus.NOT_SEEN
    assert "two places" in observation.tool.reason
    assert any(view.marker_id == 10 and not view.used for view in observation.marker_views)


def test_the_cameras_health_names_by_code_what_the_pose_source_finds(pair_and_truth):
    """It knows the finding by words that both read from the same place: a rewording cannot part them."""
    (left, right), _ = pair_and_truth
    seen = {
        view.marker_id: view.corners_left_px.astype(int)
        for view in ArucoPoseSource(machine()).observe(left, right, 0).marker_views
    }
    low, high = seen[10].min(axis=0) - 25, seen[10].max(axis=0) + 25
    doubled = left.copy()
    doubled[20 : 20 + high[1] - low[1], 20 : 20 + high[0] - low[0]] = left[low[1] : high[1], low[0] : high[0]]
    for eyes, code in (
        ((left, right), None),
        ((doubled, right), FaultCode.MARKER_TWICE),
        ((right, left), FaultCode.EYES_SWAPPED),
        ((left, np.roll(right, 6, axis=0)), FaultCode.ROWS_DIFFER),
    ):
        observation = ArucoPoseSource(machine()).observe(*eyes, 0)
        pair: Any = SimpleNamespace(observation=observation, frame=SimpleNamespace(left=eyes[0], right=eyes[1]))
        found = MarkerMonitor(machine().camera).check(pair)
        assert {finding.code for finding in found} == ({code} if code else set()), found
        assert all(finding.forbids_look for finding in found)


def test_following_gives_the_same_corners_as_full_searches(pair_and_truth):
    (left, _), _ = pair_and_truth
    wanted = frozenset({1, 2, 3, 10})
    tracking = EyeDetector(machine().camera, machine().dictionary, wanted)
    full_searches = 0
    for shift in range(0, 12, 2):
        moved = np.roll(left, shift, axis=1)
        afresh = EyeDetector(machine().camera, machine().dictionary, wanted)
        one, other = afresh.detect(moved), tracking.detect(moved)
        full_searches += other.full_search
        assert one.markers.keys() == other.markers.keys()
        for marker_id, corners in one.markers.items():
            assert np.abs(corners - other.markers[marker_id]).max() < 0.02, "px"
    assert full_searches <= 3


def test_a_lost_marker_is_searched_in_the_whole_image(pair_and_truth):
    (left, _), _ = pair_and_truth
    detector = EyeDetector(machine().camera, machine().dictionary, frozenset({10}))
    first = detector.detect(left).markers[10]
    jumped = np.roll(left, 300, axis=1)
    found = detector.detect(jumped)
    assert found.full_search
    assert np.abs(found.markers[10] - first - [300, 0]).max() < 0.15, "px; the lens bows the sides otherwise there"


def test_a_machine_without_tool_marker_is_refused():
    bare = replace(machine(), markers=machine().markers_on("ooi"))
    with pytest.raises(NoMarkersError, match="tool"):
        ArucoPoseSource(bare)
