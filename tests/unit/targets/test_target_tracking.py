"""The target is the same place in later looks; what was covered, moved or changed is reported and gives no pose."""

import cv2
import numpy as np
import pytest
from target_scenes import SETTINGS, anchored, machine, pair_at, pixel_of, true_in

from server.targets.source import TargetPoseSource
from server.targets.tracking import TargetTracker
from server.vision.contracts import ObjectPose, PairObservation, PoseStatus
from server.vision.look import pose_deviations
from server.vision.object_pose import NO_RIVAL_CHI2_MARGIN


def tracker() -> TargetTracker:
    return TargetTracker(anchored()[0], machine().camera, SETTINGS)


@pytest.mark.parametrize("distance_m", [0.7, 0.4, 0.1])
def test_the_same_place_is_found_from_another_distance(distance_m):
    """By recognition alone: the tracker has not seen the way there."""
    pair, T_ooi_cam = pair_at(distance_m, 5)
    fresh = tracker()
    fix = fresh.find_target(*pair)
    if not fix.ok:  # the way is too long for flow, so the next one recognises
        fix = fresh.find_target(*pair)
    assert fix.ok, fix.reason
    error = pose_deviations(fix.T_cam_target[None], true_in(T_ooi_cam))[0]
    assert np.linalg.norm(error[3:]) < 0.003
    assert np.rad2deg(np.linalg.norm(error[:3])) < 2.0
    assert np.linalg.eigvalsh(fix.covariance).min() > 0.0


def test_a_covered_target_gives_no_pose():
    (left, right), T_ooi_cam = pair_at(0.5, 6)
    u, v = pixel_of(T_ooi_cam)
    texture = np.random.default_rng(0).integers(0, 255, (61, 61)).astype(np.uint8)
    left = left.copy()
    left[v - 30 : v + 31, u - 30 : u + 31] = texture
    fix = tracker().find_target(left, right)
    assert not fix.ok
    assert "covered" in fix.reason
    assert fix.T_cam_target is None


def test_a_target_that_moved_against_its_surroundings_gives_no_pose():
    """The patch's pixels are shifted as an object of 10 mm of motion would be."""
    pair, T_ooi_cam = pair_at(0.5, 6)
    u, v = pixel_of(T_ooi_cam)
    depth_m = true_in(T_ooi_cam)[2, 3]
    shift = round(0.010 * machine().camera.fx_px / depth_m)
    disparity = round(machine().camera.fx_px * machine().camera.baseline_m / depth_m)
    half, moved = 70, []
    for image, column in zip(pair, (u, u - disparity), strict=True):
        copy = image.copy()
        area = image[v - half : v + half, column - half - shift : column + half - shift]
        copy[v - half : v + half, column - half : column + half] = area
        moved.append(copy)
    fix = tracker().find_target(*moved)
    assert not fix.ok
    assert "moved" in fix.reason


def test_light_that_changes_alike_everywhere_changes_nothing():
    pair, T_ooi_cam = pair_at(0.5, 6)
    dimmed = [np.asarray(cv2.convertScaleAbs(image, alpha=0.6, beta=5)) for image in pair]
    fix = tracker().find_target(*dimmed)
    assert fix.ok, fix.reason
    assert np.linalg.norm(fix.T_cam_target[:3, 3] - true_in(T_ooi_cam)[:3, 3]) < 0.003


def test_another_wall_is_not_taken_for_the_target():
    left, right = (np.ascontiguousarray(image[::-1, ::-1]) for image in pair_at(0.5, 6)[0])
    fix = tracker().find_target(left, right)
    assert not fix.ok
    assert not fix.surroundings_seen


def test_the_own_tool_over_the_patch_does_not_count_against_it():
    (left, right), T_ooi_cam = pair_at(0.5, 6)
    u, v = pixel_of(T_ooi_cam)
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=float) * 110.0 + np.array([u, v])
    left = left.copy()
    cv2.fillPoly(left, [np.round(square).astype(np.int32)], 30)
    hidden = tracker().find_target(left, right, ([square], []))
    assert hidden.ok, hidden.reason
    assert np.isnan(hidden.agree_frac)


class _Mask:
    left_polygons = right_polygons = ()

    def update(self, views):
        pass


class _Tool:
    """A marker source that sees the tool and no OOI."""

    def observe(self, left, right, t_exposure_ns):
        tool = ObjectPose("tool", PoseStatus.OK, "", np.eye(4), np.eye(6), (7,), 0.1, NO_RIVAL_CHI2_MARGIN)
        ooi = ObjectPose("ooi", PoseStatus.NOT_SEEN, "no marker", None, None, (), float("nan"), NO_RIVAL_CHI2_MARGIN)
        return PairObservation(t_exposure_ns, tool, ooi, (), ())


def test_the_source_keeps_the_pose_contract_with_and_without_a_target():
    source = TargetPoseSource(_Tool(), machine().camera, _Mask(), SETTINGS)
    pair, _ = pair_at(0.7, 1)
    assert source.observe(*pair, 5).ooi.reason == "no marker"
    source.use_target(anchored()[0])
    seen = source.observe(*pair, 6)
    assert (seen.t_exposure_ns, seen.tool.marker_ids) == (6, (7,))
    assert seen.ooi.status is PoseStatus.OK, seen.ooi.reason
    assert seen.ooi.covariance.shape == (6, 6)
    for grey in (0, 90, 255):
        blank = np.full(pair[0].shape, grey, np.uint8)
        blind = source.observe(blank, blank, 7)
        assert blind.ooi.status is PoseStatus.NOT_SEEN
        assert blind.ooi.T_cam_object is None
        assert blind.ooi.reason
    small = source.observe(pair[0][:100], pair[1][:100], 8)
    assert small.ooi.status is PoseStatus.NOT_SEEN
    source.use_target(None)
    assert source.observe(*pair, 9).ooi.reason == "no marker"
