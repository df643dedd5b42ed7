"""What the 3D view is given beside the state: the odometry's way and points; and viser's page without its extras."""

from types import SimpleNamespace

import numpy as np
import pytest

from machine.poses import inverse_pose, pose
from machine.rotations import rotation_from_rotvec
from server.api.panel_scene import SceneFeed, embedded_scene_page
from server.camera.contracts import OdometryMap
from server.vision.odometry import StereoOdometry

T_BASE_CAM = pose(rotation_from_rotvec(np.array([0.3, -0.2, 1.0])), np.array([2.0, 0.1, 1.4]))
T_VO_CAM_END = pose(rotation_from_rotvec(np.array([0.0, 0.1, 0.0])), np.array([0.05, 0.0, 0.3]))


@pytest.fixture
def vision():
    return SimpleNamespace(last_odometry=(), last_map=None)


@pytest.fixture
def feed(vision):
    return SceneFeed(SimpleNamespace(cell=SimpleNamespace(vision=vision)), SimpleNamespace())


def test_the_way_and_its_points_lie_where_the_camera_was_when_it_ended(feed, vision):
    assert feed._track_shown(T_BASE_CAM) is None
    vision.last_odometry = (SimpleNamespace(T_vo_cam=np.eye(4)), SimpleNamespace(T_vo_cam=T_VO_CAM_END))
    track = feed._track_shown(T_BASE_CAM)
    assert track[-1] == pytest.approx(T_BASE_CAM[:3, 3])
    assert feed._map_shown() is None  # it comes a little later
    point_base = np.array([3.0, 0.2, 1.1])
    point_vo = T_VO_CAM_END @ inverse_pose(T_BASE_CAM) @ np.append(point_base, 1.0)
    vision.last_map = OdometryMap(point_vo[None, :3], 1)
    elsewhere = pose(np.eye(3), np.array([9.0, 9.0, 9.0]))
    assert feed._track_shown(elsewhere) is track  # the machine has moved on; the way stays where it was
    assert feed._map_shown()[0] == pytest.approx(point_base)


def test_a_new_run_takes_the_old_points_away(feed, vision):
    vision.last_odometry = (SimpleNamespace(T_vo_cam=np.eye(4)),)
    vision.last_map = OdometryMap(np.ones((4, 3)), 1)
    feed._track_shown(T_BASE_CAM)
    assert feed._map_shown().shape == (4, 3)
    vision.last_odometry, vision.last_map = (SimpleNamespace(T_vo_cam=T_VO_CAM_END),), None
    feed._track_shown(T_BASE_CAM)
    assert feed._map_shown() is None


@pytest.mark.parametrize(("found", "told"), [((), 0), ((5,), 5), ((400, 301), 351), ((600,), 600), ((601,), 301)])
def test_the_map_is_thinned_to_what_can_be_looked_at(found, told):
    odometry = StereoOdometry.__new__(StereoOdometry)
    odometry._keyframes = [SimpleNamespace(points_vo=np.zeros((count, 3))) for count in found]
    assert odometry.map_points(600).shape == (told, 3)


def test_viser_s_own_notices_are_hidden_once_and_the_key_esc_stops_there_too():
    page = embedded_scene_page(b"<html><head></head><body></head></body></html>")
    assert page.count(b"<style>") == page.count(b"<script>") == 1
    assert b"/v1/stop" in page
    assert b"mantine-Notifications-root" in page
    assert embedded_scene_page(b"no page") == b"no page"
