"""The fast picture against the dense ray caster, rolling shutter and relief included."""

from dataclasses import replace
from importlib.resources import files

import cv2
import numpy as np
import pytest

from benchmarks.simulator.demo_scene import demo_tcp_pose, demo_world
from benchmarks.simulator.exact_renderer import Window, reference_window
from machine.camera import project
from machine.description import Machine, parse_machine_toml
from machine.poses import inverse_pose, pose, transform_points
from machine.rotations import rotation_from_rotvec
from sim_plc.camera.renderer import RenderSetup, StereoRenderer, key_poses

READOUT_S = 0.011


class Sideways:
    """A tool that moves along x_ooi at a constant speed."""

    def __init__(self, T_base_tcp: np.ndarray, speed_m_s: float) -> None:
        self.T_base_tcp, self.speed_m_s = T_base_tcp, speed_m_s

    def pose_at(self, t_ns: int, /) -> np.ndarray:
        T = self.T_base_tcp.copy()
        T[0, 3] += self.speed_m_s * 1e-9 * t_ns
        return T


@pytest.fixture(scope="module")
def machine() -> Machine:
    return parse_machine_toml(files("machine").joinpath("machines", "hiab033.toml").read_text())


@pytest.fixture(scope="module")
def renderer(machine: Machine) -> StereoRenderer:
    return StereoRenderer(
        RenderSetup(*demo_world(machine, wall_relief_m=0.05, readout_s=READOUT_S, structure_frac=0.3))
    )


def oblique(machine: Machine) -> np.ndarray:
    turn = pose(rotation_from_rotvec(np.deg2rad([8.0, -8.0, 8.0])), np.zeros(3))
    return demo_tcp_pose(machine, 0.75, (-0.15, 0.1)) @ turn


WALL_WINDOWS = [Window(420, 330, 620, 450), Window(0, 0, 120, 80), Window(640, 560, 760, 700)]
BEAM_WINDOWS = [Window(120, 200, 260, 290), Window(900, 290, 1060, 400)]  # ends and tops, clear of the hoses


@pytest.mark.parametrize("window", WALL_WINDOWS + BEAM_WINDOWS)
def test_fast_picture_is_the_dense_one(machine: Machine, renderer: StereoRenderer, window: Window) -> None:
    eye = renderer.eyes[1]
    Ts_base_tcp = key_poses(Sideways(oblique(machine), 0.3), 0, READOUT_S, 5)
    dense = reference_window(renderer, eye, Ts_base_tcp, window)
    fast = renderer.render_sharp_image(eye, Ts_base_tcp)
    renderer.structure.paint(fast, 1, Ts_base_tcp[2])
    fast = fast[window.v0 : window.v1, window.u0 : window.u1].astype(float)
    a, b = (cv2.GaussianBlur(image, (5, 5), 0.6)[4:-4, 4:-4] for image in (dense, fast))
    difference = b - a
    shift_px = [(g * difference).sum() / (g * g).sum() for g in np.gradient(a)]
    assert np.abs(difference).mean() < 2.5  # grey levels, on texture of 30 to 60 rms
    assert abs(difference.mean()) < 0.5  # grey levels
    assert np.abs(shift_px).max() < 0.06  # the map between nodes is bilinear: worst in the corners of an oblique view


def test_rolling_shutter_shifts_each_row_by_its_own_time(machine: Machine) -> None:
    camera, scene = demo_world(machine, readout_s=READOUT_S, noise_grey=0.0)
    renderer = StereoRenderer(RenderSetup(camera, replace(scene, tool_markers=())))
    speed_m_s = 2.0  # far above the machine's: 22 mm during the readout
    poses = Sideways(demo_tcp_pose(machine, 0.5), speed_m_s)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    left, _ = renderer.render(poses, 0, np.random.default_rng(0))
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(left)
    assert sorted(ids.ravel()) == [1, 2, 3]
    errors = []
    for marker_id, found in zip(ids.ravel(), corners, strict=True):
        marker = next(m for m in scene.ooi_markers if m.marker_id == marker_id)
        h = 0.5 * marker.side_m
        outline = np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])
        for point, seen in zip(outline, found.reshape(4, 2), strict=True):
            t_ns = round((seen[1] / (camera.left.height_px - 1) - 0.5) * READOUT_S * 1e9)
            T_cam_ooi = inverse_pose(poses.pose_at(t_ns) @ camera.T_tcp_cam_left)
            errors.append(seen - project(camera.left, transform_points(T_cam_ooi @ marker.T_on_marker, point[None]))[0])
    assert np.abs(np.mean(errors, axis=0)).max() < 0.1  # px; with one pose for all rows it is 1 px
    assert np.abs(errors).max() < 0.5  # px
