"""Images of one marker from the dense reference ray caster, then point spread, noise and 8 bits (JPEG if wanted)."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.simulator.demo_scene import demo_world
from benchmarks.simulator.exact_renderer import Window, reference_window
from machine.camera import project_stereo
from machine.description import Machine, Marker
from machine.markers import marker_corners
from machine.poses import inverse_pose
from machine.rotations import Array
from sim_plc.camera.renderer import RenderSetup, StereoRenderer

MARKER_ID = 1
_SURROUND = 1.6  # half size of the window over the marker's half size: quiet zone and some rock
_RAYS_MIN, _RAYS_MAX = 4, 8  # per pixel and axis
_RAYS_TOTAL = 2.5e5  # per image
_READ_SHARE = 0.3  # part of the variance at mid grey that does not grow with brightness


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """What stands between the sharp picture and the grey values."""

    psf_px: float = 0.6  # standard deviation of the point spread
    noise_grey: float = 2.0  # standard deviation at mid grey
    jpeg_quality: int = 0  # 0: no JPEG


class Studio:
    """Takes pictures of one printed marker of one side length in front of a flat wall."""

    def __init__(self, machine: Machine, side_m: float) -> None:
        camera, scene = demo_world(machine)
        marker = Marker(marker_id=MARKER_ID, side_m=side_m, on="ooi", T_on_marker=np.eye(4))
        bare = replace(scene, ooi_markers=(marker,), tool_markers=(), wall_offset_m=0.03)
        self._machine, self._side_m = machine, side_m
        self._renderer = StereoRenderer(RenderSetup(camera, bare, machine.dictionary))

    def window(self, T_cam_marker: Array, eye: int) -> Window:
        """The marker with its surroundings in one eye."""
        camera = self._machine.camera
        around = marker_corners(_SURROUND * self._side_m)
        px = project_stereo(camera, around @ T_cam_marker[:3, :3].T + T_cam_marker[:3, 3])[eye]
        low = np.maximum(np.floor(px.min(axis=0)).astype(int), 0)
        high = np.minimum(np.ceil(px.max(axis=0)).astype(int) + 1, [camera.width_px, camera.height_px])
        return Window(int(low[0]), int(low[1]), int(high[0]), int(high[1]))

    def sharp(self, T_cam_marker: Array, eye: int) -> tuple[Window, Array]:
        """The light on the pixels of one eye's window: (rows, cols) float grey."""
        T_base_tcp = inverse_pose(self._machine.T_tcp_cam_left @ T_cam_marker)
        window = self.window(T_cam_marker, eye)
        area = (window.u1 - window.u0) * (window.v1 - window.v0)
        rays = int(np.clip(np.sqrt(_RAYS_TOTAL / area), _RAYS_MIN, _RAYS_MAX))
        keys = np.stack([T_base_tcp, T_base_tcp])
        return window, reference_window(self._renderer, self._renderer.eyes[eye], keys, window, rays)


def sensed(sharp: Array, settings: SensorSettings, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Point spread, read and shot noise, clipped and rounded to 8 bits once, JPEG."""
    size = 2 * int(np.ceil(5.0 * settings.psf_px)) + 1
    spread = sharp if settings.psf_px == 0.0 else cv2.GaussianBlur(sharp, (size, size), settings.psf_px)
    sigma = settings.noise_grey * np.sqrt(_READ_SHARE + (1.0 - _READ_SHARE) * np.maximum(spread, 0.0) / 128.0)
    image = np.clip(np.rint(spread + sigma * rng.standard_normal(spread.shape)), 0, 255).astype(np.uint8)
    if settings.jpeg_quality == 0:
        return image
    _, coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, settings.jpeg_quality])
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), np.uint8)
