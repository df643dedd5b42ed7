"""Where the rendered markers lie: refined corners against the analytic projection, in OpenCV's pixel convention."""

from dataclasses import replace
from importlib.resources import files

import cv2
import numpy as np
import pytest

from benchmarks.simulator.demo_scene import demo_tcp_pose, demo_world
from machine.camera import project
from machine.description import Machine, parse_machine_toml
from machine.poses import inverse_pose, pose, transform_points
from machine.rotations import rotation_from_rotvec
from sim_plc.camera.renderer import RenderSetup, StereoRenderer

BIAS_MAX_PX = 0.03
RMS_MAX_PX = 0.2


@pytest.fixture(scope="module")
def machine() -> Machine:
    return parse_machine_toml(files("machine").joinpath("machines", "hiab033.toml").read_text())


def corners_of(side_m: float) -> np.ndarray:
    h = 0.5 * side_m
    return np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])


def detect(image: np.ndarray) -> dict[int, np.ndarray]:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementWinSize = 4
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
    if ids is None:
        return {}
    return {int(i): corner.reshape(4, 2).astype(float) for i, corner in zip(ids.ravel(), corners, strict=True)}


def random_poses(machine: Machine, n: int) -> list[np.ndarray]:
    """Tool in front of the OOI so that the camera is 0.5 to 1.3 m away, at up to 8 deg and 0.15 m off."""
    rng = np.random.default_rng(5)
    poses = []
    for distance_m in np.linspace(0.04, 0.83, n):
        turn = pose(rotation_from_rotvec(np.deg2rad(rng.uniform(-8, 8, 3))), np.zeros(3))
        x_m, y_m = rng.uniform(-0.12, 0.12, 2) * min(1.0, distance_m + 0.3)
        poses.append(demo_tcp_pose(machine, distance_m, (x_m, y_m)) @ turn)
    return poses


def test_ooi_corners_lie_where_the_projection_says(machine: Machine) -> None:
    camera, scene = demo_world(machine, noise_grey=2.0, psf_px=0.6)
    renderer = StereoRenderer(RenderSetup(camera, replace(scene, tool_markers=())))
    errors = []
    for T_base_tcp in random_poses(machine, 14):
        for eye, image in zip(renderer.eyes, renderer.render_static(T_base_tcp), strict=True):
            found = detect(image)
            T_cam_ooi = inverse_pose(T_base_tcp @ eye.T_tcp_cam) @ scene.T_base_ooi
            for marker in scene.ooi_markers:
                points = transform_points(T_cam_ooi @ marker.T_on_marker, corners_of(marker.side_m))
                if marker.marker_id in found:
                    errors.append(found[marker.marker_id] - project(camera.left, points))
    errors = np.concatenate(errors)
    assert len(errors) > 4 * 6 * 10
    assert np.abs(errors.mean(axis=0)).max() < BIAS_MAX_PX
    assert np.sqrt((errors**2).mean()) < RMS_MAX_PX


def test_tool_corners_lie_where_the_projection_says(machine: Machine) -> None:
    camera, scene = demo_world(machine, mount_tilt_deg=2.0)
    renderer = StereoRenderer(RenderSetup(camera, scene))
    images = renderer.render_static(demo_tcp_pose(machine, 0.5))
    marker = scene.tool_markers[0]
    for eye, image in zip(renderer.eyes, images, strict=True):
        T_cam_marker = inverse_pose(eye.T_tcp_cam) @ scene.T_tcp_tool @ marker.T_on_marker
        expected = project(camera.left, transform_points(T_cam_marker, corners_of(marker.side_m)))
        error = detect(image)[marker.marker_id] - expected
        assert np.abs(error).max() < 0.3  # px; single corners carry noise and the detector's own error
        assert expected[:, 1].min() > 0.5 * camera.left.height_px  # the tool is in the picture's lower half


@pytest.mark.parametrize("distance_m", [0.1, 0.15])
def test_all_markers_are_found_near_the_goal_in_both_eyes(machine: Machine, distance_m: float) -> None:
    truths = demo_world(machine, wall_relief_m=0.05, noise_grey=4.0, psf_px=0.9, readout_s=0.011, exposure_s=0.004)
    renderer = StereoRenderer(RenderSetup(*truths))
    for image in renderer.render_static(demo_tcp_pose(machine, distance_m)):
        assert set(detect(image)) >= {1, 2, 3, 10}


@pytest.mark.parametrize("distance_m", [0.6, 0.9])
def test_at_the_start_each_eye_finds_the_tool_and_the_pair_all_of_the_ooi(machine: Machine, distance_m: float) -> None:
    """The tool plate hides one lower OOI marker from each eye when it hangs squarely in front."""
    renderer = StereoRenderer(RenderSetup(*demo_world(machine, wall_relief_m=0.05, noise_grey=4.0, psf_px=0.9)))
    seen = [set(detect(image)) for image in renderer.render_static(demo_tcp_pose(machine, distance_m))]
    assert all(10 in ids and ids & {1, 2, 3} for ids in seen)
    assert seen[0] | seen[1] >= {1, 2, 3}
