"""A plate is taught beside the markers and recognised elsewhere without them; what only looks like it is refused."""

import re
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from target_scenes import SETTINGS, machine

from benchmarks.simulator.demo_scene import demo_tcp_pose, demo_world
from benchmarks.targets.scene import left_eye
from benchmarks.targets.virtual_jobs import tool_mask
from machine.poses import inverse_pose, pose
from machine.rotations import geodesic_angle, rotation_about
from server.camera.target_measuring import MARKER_PRINT_SCALE, view_by_markers
from server.targets.source import TargetPoseSource
from server.targets.taught import ObjectBox, TaughtObject, teach_object
from server.targets.taught_files import TaughtFileError, load_taught, save_taught
from server.targets.taught_tracking import TaughtTracker
from server.vision.aruco_source import ArucoPoseSource
from server.vision.contracts import PoseStatus
from sim_plc.camera.renderer import RenderSetup, StereoRenderer
from sim_plc.world import FixtureTruth

BOX = ObjectBox(np.array([0.55, 0.1, 0.0]), np.array([0.48, 0.38, 0.14]))
SEED = 5
PLACE = pose(rotation_about("z", np.deg2rad(15.0)), np.array([0.05, 0.1, 0.0]))


class Shown:
    def __init__(self, left, right, masks_px):
        self.left, self.right, self.masks_px = left, right, masks_px


@lru_cache
def stage(markers: bool):
    camera, scene = demo_world(machine(), wall_relief_m=0.05, texture_seed=7)
    if not markers:
        scene = replace(scene, ooi_markers=(), ooi_boards=())
    source = TargetPoseSource(ArucoPoseSource(machine()), machine().camera, tool_mask(machine()))
    return StereoRenderer(RenderSetup(camera, scene)), source


def shown(markers: bool, distance_m: float, across, *fixtures: FixtureTruth):
    """A pair with its masks, what the source makes of it, and the true T_ooi_cam."""
    renderer, source = stage(markers)
    renderer.show_fixtures(fixtures)
    T = demo_tcp_pose(machine(), distance_m, across)
    left, right = renderer.render_static(T, np.random.default_rng(3))
    seen = source.observe(left, right, 0)
    return Shown(left, right, source.masks_px), seen, left_eye(renderer, T)


@lru_cache
def views():
    fixture = FixtureTruth(SEED, pose(np.eye(3), BOX.centre_m))
    made = []
    for across in ((0.1, -0.05), (0.3, -0.15)):
        pair, seen, _ = shown(True, 0.35, across, fixture)
        made.append(view_by_markers(pair, seen, machine().camera, BOX, SETTINGS))
    return made


@lru_cache
def taught() -> TaughtObject:
    found = teach_object("plate", views(), BOX, machine().camera, SETTINGS)
    assert isinstance(found, TaughtObject), found
    return found


def found_in(*fixtures: FixtureTruth, light: float = 1.0):
    pair, _, T_ooi_cam = shown(False, 0.45, (0.0, 0.05), *fixtures)
    left, right = (np.clip(light * image, 0, 255).astype(np.uint8) for image in (pair.left, pair.right))
    fix = TaughtTracker(taught(), machine().camera, SETTINGS).find_target(left, right, pair.masks_px)
    return fix, inverse_pose(T_ooi_cam) @ PLACE


@pytest.mark.parametrize(("cover", "light"), [(0.0, 0.6), (0.3, 1.3)])
def test_the_object_is_found_elsewhere_in_another_light_and_partly_covered(cover, light):
    fix, truth = found_in(FixtureTruth(SEED, PLACE, cover_frac=cover), light=light)
    assert fix.ok, fix.reason
    assert np.linalg.norm(fix.T_cam_target[:3, 3] - truth[:3, 3]) < 0.002
    assert geodesic_angle(fix.T_cam_target[:3, :3], truth[:3, :3]) < np.deg2rad(0.5)


@pytest.mark.parametrize(
    ("variant", "why"),
    [("other", "recognised"), ("scaled", "worse than their noise|another"), ("row", "fit another|limits")],
)
def test_a_look_alike_is_refused_with_its_reason(variant, why):
    fix, _ = found_in(FixtureTruth(SEED, PLACE, variant))
    assert not fix.ok
    assert fix.T_cam_target is None
    assert "'plate'" in fix.reason
    assert re.search(why, fix.reason), fix.reason


def test_two_of_them_in_view_are_refused():
    beside = PLACE @ pose(np.eye(3), np.array([-0.6, 0.0, 0.0]))
    fix, _ = found_in(FixtureTruth(SEED, PLACE), FixtureTruth(SEED, beside))
    assert not fix.ok
    assert "another" in fix.reason


def test_the_source_serves_it_as_the_object_of_interest():
    pair, _, _ = shown(False, 0.45, (0.0, 0.05), FixtureTruth(SEED, PLACE))
    _, source = stage(False)
    source.use_target(taught())
    seen = source.observe(pair.left, pair.right, 0)
    again = source.observe(pair.left, pair.right, 1)  # now by flow
    source.use_target(None)
    assert (seen.ooi.status, again.ooi.status) == (PoseStatus.OK, PoseStatus.OK)
    assert np.allclose(seen.ooi.T_cam_object, again.ooi.T_cam_object, atol=1e-4)
    assert source.observe(pair.left, pair.right, 2).ooi.status is PoseStatus.NOT_SEEN


def test_a_view_without_markers_and_a_single_view_are_refused():
    pair, seen, _ = shown(False, 0.45, (0.0, 0.05), FixtureTruth(SEED, PLACE))
    assert "markers are not seen" in view_by_markers(pair, seen, machine().camera, BOX, SETTINGS)
    assert "limit 2" in teach_object("plate", views()[:1], BOX, machine().camera, SETTINGS)


def test_a_view_whose_object_moved_is_refused():
    moved = FixtureTruth(SEED, pose(np.eye(3), BOX.centre_m + np.array([0.03, 0.0, 0.0])))
    pair, seen, _ = shown(True, 0.35, (0.2, -0.1), moved)
    third = view_by_markers(pair, seen, machine().camera, BOX, SETTINGS)
    assert "has moved" in teach_object("plate", [*views(), third], BOX, machine().camera, SETTINGS)


def test_a_file_gives_the_same_object_and_another_file_is_refused(tmp_path):
    path = save_taught(tmp_path, taught())
    again = load_taught(path)
    assert again.name == "plate"
    assert again.agree_frac == taught().agree_frac
    for before, after in zip(taught().views, again.views, strict=True):
        assert np.array_equal(before.reference_left, after.reference_left)
        assert np.array_equal(before.landmarks.points_target, after.landmarks.points_target)
        assert np.array_equal(before.descriptors, after.descriptors)
    path.write_bytes(b"no such file")
    with pytest.raises(TaughtFileError, match="teach it again"):
        load_taught(path)


def test_landmarks_keep_off_the_prints():
    assert MARKER_PRINT_SCALE > 4.0 / 3.0  # a quiet zone of one module of six on either side
    for view in taught().views:
        assert np.abs(view.landmarks.points_target).max(axis=0) == pytest.approx([0.2, 0.15, 0.04], abs=0.06)
