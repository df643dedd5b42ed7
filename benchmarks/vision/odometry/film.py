"""One rendered run, kept in memory as the simulated camera sends it: side-by-side JPEGs, stamps, true poses."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import files

import cv2
import numpy as np

from benchmarks.simulator.demo_scene import demo_world
from benchmarks.vision.odometry.paths import Shape, drawn_path
from machine.camera import project_stereo
from machine.description import Machine, parse_machine_toml
from machine.markers import marker_corners
from machine.poses import inverse_pose, pose, transform_points
from machine.rotations import Array, rotation_from_rotvec
from server.targets.tool_mask import plate_and_shaft
from server.vision.contracts import Image
from sim_plc.camera.renderer import RenderSetup, StereoRenderer
from sim_plc.presets import spread_of
from sim_plc.world import CameraTruth, SceneTruth, rng_for

JPEG_QUALITY = 95  # as the simulated camera's default
SPEED_M_S = (0.10, 0.15)
START_DEG = 6.0  # the camera looks at the wall this squarely
WALL_OFFSET_M = 0.06
MASK_SCALE = 2.0  # as the server's default


@dataclass(frozen=True, slots=True)
class FilmCase:
    """What is rendered. `contrast_frac` None: drawn from the preset."""

    shape: Shape
    distance_m: float  # camera to wall at the start
    seed: int
    rate_hz: float = 30.0
    disparity_bias_px: float = 0.0
    contrast_frac: float | None = None
    structure_frac: float = 0.0  # of the picture, covered by the crane itself; 0: only the tool
    structure_contrast_frac: float = 1.0

    @property
    def name(self) -> str:
        """One word, good as a file name."""
        extra = f"-bias{self.disparity_bias_px:g}" if self.disparity_bias_px else ""
        extra += "" if self.contrast_frac is None else f"-contrast{self.contrast_frac:g}"
        if self.structure_frac:
            extra += f"-structure{self.structure_frac:g}x{self.structure_contrast_frac:g}"
        return f"{self.shape}-{self.distance_m:g}m-{self.rate_hz:g}hz-{self.seed}{extra}"


@dataclass(frozen=True, slots=True)
class Film:
    """n pairs: side-by-side JPEGs, stamps (mid-exposure of the middle row), true camera poses Ts_vo_cam (n, 4, 4)."""

    jpegs: tuple[bytes, ...]
    t_exposure_ns: tuple[int, ...]
    Ts_vo_cam: Array
    tool_left_px: Array
    tool_right_px: Array
    readout_s: float

    def pair(self, number: int) -> tuple[Image, Image]:
        """Left and right eye (h, w), decoded."""
        both = cv2.imdecode(np.frombuffer(self.jpegs[number], np.uint8), cv2.IMREAD_GRAYSCALE)
        if both is None:
            raise ValueError(f"pair {number} of this film is no JPEG")
        left, right = np.hsplit(np.asarray(both, np.uint8), 2)
        return np.ascontiguousarray(left), np.ascontiguousarray(right)


@lru_cache
def nominal_machine() -> Machine:
    """The machine whose camera is used."""
    return parse_machine_toml(files("machine").joinpath("machines", "hiab033.toml").read_text(encoding="utf-8"))


def tool_polygons() -> tuple[Array, Array]:
    """Where the tool is in both eyes, as the pipeline masks it."""
    machine = nominal_machine()
    corners = transform_points(inverse_pose(machine.T_tcp_cam_left) @ machine.T_tcp_tool, marker_corners(0.15))
    left, right = project_stereo(machine.camera, corners)
    return plate_and_shaft(left, MASK_SCALE), plate_and_shaft(right, MASK_SCALE)


def draw_scene(case: FilmCase) -> tuple[CameraTruth, SceneTruth]:
    """Camera and wall of preset `realistic`, but with the camera file exact and no markers on the wall."""

    def draw(name: str) -> float:
        return float(spread_of("realistic", name).draw(rng_for(case.seed, name))[0])

    machine = nominal_machine()
    camera, scene = demo_world(
        machine,
        noise_grey=draw("image_noise"),
        psf_px=draw("psf"),
        exposure_s=draw("exposure"),
        readout_s=draw("readout"),
        wall_relief_m=draw("wall_relief"),
        texture_contrast_frac=draw("texture_contrast") if case.contrast_frac is None else case.contrast_frac,
        texture_seed=case.seed,
        structure_frac=case.structure_frac,
        structure_contrast_frac=case.structure_contrast_frac,
    )
    right = replace(machine.camera, cx_px=machine.camera.cx_px + case.disparity_bias_px)
    return replace(camera, right=right), replace(scene, ooi_markers=(), wall_offset_m=WALL_OFFSET_M)


def start_pose(case: FilmCase, rng: np.random.Generator) -> Array:
    """T_base_tcp with the left eye `distance_m` in front of the wall, roughly square to it."""
    machine = nominal_machine()
    facing = pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, case.distance_m - WALL_OFFSET_M]))
    tilt = pose(rotation_from_rotvec(np.deg2rad(rng.uniform(-START_DEG, START_DEG, 3))), np.zeros(3))
    return facing @ tilt @ inverse_pose(machine.T_tcp_cam_left)


def render_film(case: FilmCase, advance: Callable[[int, int], None] = lambda done, total: None) -> Film:
    """All pairs of one case; `advance(done, total)` is called after each."""
    camera, scene = draw_scene(case)
    rng = rng_for(case.seed, f"{case.shape} {case.distance_m:g}")
    path = drawn_path(case.shape, start_pose(case, rng), float(rng.uniform(*SPEED_M_S)), rng)
    renderer = StereoRenderer(RenderSetup(camera, scene))
    period_ns = round(1e9 / case.rate_hz)
    stamps = tuple(range(50_000_000, round(1e9 * path.duration_s), period_ns))
    jpegs = []
    for number, t_ns in enumerate(stamps, start=1):
        picture = np.hstack(renderer.render(path, t_ns, rng))
        jpegs.append(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes())
        advance(number, len(stamps))
    Ts_base_cam = np.array([path.pose_at(t) @ camera.T_tcp_cam_left for t in stamps])
    return Film(tuple(jpegs), stamps, inverse_pose(Ts_base_cam[0]) @ Ts_base_cam, *tool_polygons(), camera.readout_s)
