"""The stereo renderer: wall, OOI markers, motion blur, own structure, point spread, noise; one step per line."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from time import perf_counter
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from machine.camera import project
from machine.description import StereoCamera
from machine.poses import inverse_pose
from machine.rotations import Array
from sim_plc.camera.boards import Board, chess_board, marker_board, paint_board, shank_board
from sim_plc.camera.fixtures import fixture_boards
from sim_plc.camera.own_structure import EyeView, OwnStructure, eye_views
from sim_plc.camera.round_marks import drawn_mark, paint_mark
from sim_plc.camera.sensor import add_noise, motion_blur, noise_bank, point_spread
from sim_plc.camera.texture import Grey, TextureLevel, best_level, rock_texture, texture_levels
from sim_plc.camera.wall import Relief, node_map, paint_map, texel_map, wall_relief

# Where the tool is while a picture is being exposed: pose history, and the key poses of a rolling shutter.


class PoseHistory(Protocol):
    """True tool poses of the recent past."""

    def pose_at(self, t_ns: int, /) -> Array:
        """T_base_tcp (4, 4) at one true time [ns]."""
        ...


@dataclass(frozen=True, slots=True)
class StaticPose:
    """A tool at rest: the same pose at every time."""

    T_base_tcp: Array

    def pose_at(self, t_ns: int, /) -> Array:
        """T_base_tcp, whatever the time."""
        return self.T_base_tcp


def shutter_times_ns(t_mid_ns: int, readout_s: float, n_keys: int) -> list[int]:
    """Mid-exposure times of `n_keys` rows spread evenly from the first to the last row [ns].

    Model:   t(row) = t_mid + (row / (rows - 1) - 1/2) readout; `t_mid_ns` is the middle row's.
    """
    return [t_mid_ns + round((k / (n_keys - 1) - 0.5) * readout_s * 1e9) for k in range(n_keys)]


def key_poses(poses: PoseHistory, t_mid_ns: int, readout_s: float, n_keys: int) -> Array:
    """T_base_tcp at the key rows of one exposure, (n_keys, 4, 4); between keys the renderer interpolates linearly."""
    if readout_s == 0.0:
        return np.repeat(poses.pose_at(t_mid_ns)[None], n_keys, axis=0)
    return np.stack([poses.pose_at(t) for t in shutter_times_ns(t_mid_ns, readout_s, n_keys)])


if TYPE_CHECKING:
    from sim_plc.world import CameraTruth, FixtureTruth, SceneTruth, World

_N_SHUTTER_KEYS = 5  # poses per exposure; at 11 ms readout 2.75 ms apart, where lines between them are good to 1e-6 rad
_NOISE_BANK_SEED = 0x6E6F697365


@dataclass(frozen=True, slots=True)
class RenderSetup:
    """What the renderer needs of a world; made by hand where no world is at hand."""

    camera: "CameraTruth"
    scene: "SceneTruth"
    dictionary: str = "DICT_4X4_50"


@lru_cache(maxsize=2)
def _rock_texture_levels(seed: int, contrast_frac: float) -> tuple[TextureLevel, ...]:
    return texture_levels(rock_texture(seed, contrast_frac))


@lru_cache(maxsize=1)
def _image_noise_bank() -> NDArray[np.int8]:
    return noise_bank(np.random.default_rng(_NOISE_BANK_SEED))


def far_to_near(boards: tuple[Board, ...], T_object_cam: Array) -> list[Board]:
    """Boards in painter's order: the farthest from the camera first."""
    return sorted(boards, key=lambda board: -float(np.linalg.norm(board.T_object_board[:3, 3] - T_object_cam[:3, 3])))


class StageTimes:
    """Seconds spent per named stage since the start; `mark` ends a stage."""

    def __init__(self, clock: Callable[[], float] = perf_counter) -> None:
        self.total_s: dict[str, float] = {}
        self._clock = clock
        self._last = clock()

    def restart_stage_clock(self) -> None:
        """The next stage begins now."""
        self._last = self._clock()

    def mark(self, stage: str) -> None:
        """The stage that ran since the last mark has this name."""
        now = self._clock()
        self.total_s[stage] = self.total_s.get(stage, 0.0) + now - self._last
        self._last = now


class StereoRenderer:
    """Renders stereo pairs of one world. Not thread safe; one instance per thread."""

    def __init__(self, world: "World | RenderSetup") -> None:
        """Builds texture, relief, rays and the constant picture of the tool (about 2 s)."""
        self._camera = world.camera
        self._scene = scene = world.scene
        dictionary = world.dictionary if isinstance(world, RenderSetup) else world.nominal.dictionary
        self._levels = _rock_texture_levels(scene.texture_seed, scene.texture_contrast_frac)
        self._relief = wall_relief(scene.texture_seed, scene.wall_relief_m, scene.wall_offset_m)
        self._T_ooi_base = inverse_pose(scene.T_base_ooi)
        self._marks = tuple(drawn_mark(mark) for mark in scene.round_marks)
        markers = tuple(marker_board(dictionary, marker, np.eye(4)) for marker in scene.ooi_markers)
        chess = tuple(chess_board(dictionary, board, np.eye(4)) for board in scene.ooi_boards)
        self._fixture_boards: tuple[Board, ...] = ()
        self.show_fixtures(scene.fixtures)
        self._ooi_boards = markers + chess
        prints = tuple(marker_board(dictionary, marker, scene.T_tcp_tool) for marker in scene.tool_markers)
        self.tool_boards = tuple(shank_board(plate) for plate in prints) + prints
        self.eyes = eye_views(self._camera, self.tool_boards)
        self.structure = OwnStructure(scene.structure, scene.texture_seed, self.eyes)
        self.times = StageTimes()

    def show_fixtures(self, fixtures: "tuple[FixtureTruth, ...]") -> None:
        """Replace the fixtures on the wall from the next picture on."""
        self._fixture_boards = tuple(board for fixture in fixtures for board in fixture_boards(fixture))

    @property
    def relief(self) -> Relief:
        """The wall's height field."""
        return self._relief

    @property
    def levels(self) -> tuple[TextureLevel, ...]:
        """The wall's texture, finest first."""
        return self._levels

    @property
    def ooi_boards(self) -> tuple[Board, ...]:
        """The OOI's boards, in OOI axes."""
        return self._ooi_boards

    def Ts_ooi_cam(self, eye: EyeView, Ts_base_tcp: Array) -> Array:
        """Camera poses in the OOI for tool poses (n, 4, 4)."""
        return np.ascontiguousarray(self._T_ooi_base @ Ts_base_tcp @ eye.T_tcp_cam)

    def render(self, poses: PoseHistory, t_mid_ns: int, rng: np.random.Generator) -> tuple[Grey, Grey]:
        """One raw stereo pair (left, right), each (height, width) uint8.

        Args:    poses: true tool poses around the exposure. t_mid_ns: mid-exposure of the middle row, true time [ns].
                 rng: this frame's noise.
        """
        self.times.restart_stage_clock()
        Ts_base_tcp = key_poses(poses, t_mid_ns, self._camera.readout_s, _N_SHUTTER_KEYS)
        half_ns = round(0.5e9 * self._camera.exposure_s)
        ends = np.stack([poses.pose_at(t_mid_ns - half_ns), poses.pose_at(t_mid_ns + half_ns)])
        self.times.mark("poses")
        return self._render_eye_image(0, Ts_base_tcp, ends, rng), self._render_eye_image(1, Ts_base_tcp, ends, rng)

    def render_static(self, T_base_tcp: Array, rng: np.random.Generator | None = None) -> tuple[Grey, Grey]:
        """A pair with the tool at rest; noise from `rng`, or seed 0."""
        return self.render(StaticPose(T_base_tcp), 0, np.random.default_rng(0) if rng is None else rng)

    def render_sharp_image(self, eye: EyeView, Ts_base_tcp: Array) -> Grey:
        """Wall and OOI in one eye, before motion, point spread, tool and noise. `Ts_base_tcp` at the key rows."""
        keys = self.Ts_ooi_cam(eye, Ts_base_tcp)
        image = self._render_wall(eye, keys)
        self.times.mark("wall")
        for board in (*self._fixture_boards, *far_to_near(self._ooi_boards, keys[len(keys) // 2])):
            paint_board(image, eye.rays, board, keys)
        self.times.mark("markers")
        return image

    def _render_wall(self, eye: EyeView, keys: Array) -> Grey:
        camera, rays = eye.rays.camera, eye.rays
        image = np.empty((camera.height_px, camera.width_px), np.uint8)
        relief = self._relief
        flat = self._scene.wall_relief_m == 0.0
        points = node_map(rays.node_rays, rays.step_px, camera.height_px, keys, relief.heights_m, relief.mean_z_m, flat)
        level = self._levels[best_level(self._levels, self._wall_pixel_size_m(camera, keys[len(keys) // 2]))]
        paint_map(texel_map(points, level), rays.step_px, level.grey_image, image)
        for mark in self._marks:
            paint_mark(image, rays, mark, keys, relief)
        return image

    def _wall_pixel_size_m(self, camera: StereoCamera, T_ooi_cam: Array) -> float:
        """Side of a pixel on the wall at the picture's middle [m]."""
        return self._wall_depth_m(T_ooi_cam) / camera.fx_px

    def _wall_depth_m(self, T_ooi_cam: Array) -> float:
        """Depth of the wall along the optical axis [m], 0.05 to 30."""
        towards = min(float(T_ooi_cam[2, 2]), -1e-3)
        return float(np.clip((self._relief.mean_z_m - T_ooi_cam[2, 3]) / towards, 0.05, 30.0))

    def _motion_blur_vector_px(self, eye: EyeView, ends_base_tcp: Array) -> Array:
        """How far the wall's middle moves in the picture during the exposure, (2,) [px]."""
        start, end = self.Ts_ooi_cam(eye, ends_base_tcp)
        middle = start[:3, 3] + start[:3, 2] * self._wall_depth_m(start)
        seen = np.stack([T[:3, :3].T @ (middle - T[:3, 3]) for T in (start, end)])
        pixels = project(eye.rays.camera, seen)
        return pixels[1] - pixels[0]

    def _render_eye_image(self, number: int, Ts_base_tcp: Array, ends: Array, rng: np.random.Generator) -> Grey:
        image = self.render_sharp_image(self.eyes[number], Ts_base_tcp)
        if self._camera.exposure_s > 0.0:
            image = motion_blur(image, self._motion_blur_vector_px(self.eyes[number], ends))
        self.times.mark("motion blur")
        self.structure.paint(image, number, Ts_base_tcp[len(Ts_base_tcp) // 2])
        self.times.mark("own structure")
        image = point_spread(image, self._camera.psf_px)
        self.times.mark("point spread")
        add_noise(image, _image_noise_bank(), self._camera.noise_grey, rng)
        self.times.mark("noise")
        return image
