"""Stereo pairs for the replay, rendered once by the simulated camera: a look pose, the tool on a moving path."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from machine.description import Machine
from machine.poses import pose
from machine.rotations import Array
from sim_plc.camera.renderer import StereoRenderer
from sim_plc.draw_world import draw_world
from sim_plc.plant.plant import Plant
from sim_plc.world import rng_for

RATE_HZ = 20.0  # at which the path is sampled unless told otherwise; the replay may be faster or slower
JPEG_QUALITY = 95  # as the simulated camera's
RADIUS_M = 0.10
TURN_S = 5.0  # for one round: 0.13 m/s


@dataclass(frozen=True, slots=True)
class _Circle:
    """A tool that goes round in its own x-y plane."""

    T_base_start: Array

    def pose_at(self, t_ns: int, /) -> Array:
        """T_base_tcp."""
        angle = 2.0 * np.pi * t_ns * 1e-9 / TURN_S
        shift = RADIUS_M * np.array([np.sin(angle), 1.0 - np.cos(angle), 0.5 * np.sin(angle)])
        return self.T_base_start @ pose(np.eye(3), shift)


def render_pairs(
    machine: Machine, folder: Path, n: int = 100, seed: int = 1, preset: str = "realistic", rate_hz: float = RATE_HZ
) -> list[Path]:
    """The pairs, side by side as JPEG, named by their time [ns]; what is there already is not rendered again."""
    times_ns = [round(number * 1e9 / rate_hz) for number in range(n)]
    files = [folder / f"{t_ns:016d}.jpg" for t_ns in times_ns]
    if all(file.is_file() for file in files):
        return files
    folder.mkdir(parents=True, exist_ok=True)
    world = draw_world(machine, preset, seed)
    renderer = StereoRenderer(world)
    circle = _Circle(Plant(world.plant, world.q_start_rad).T_base_tcp())
    rng = rng_for(seed, "camera")
    for t_ns, file in zip(times_ns, files, strict=True):
        picture = np.hstack(renderer.render(circle, t_ns, rng))
        good, jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        if not good:
            raise RuntimeError(f"{file.name}: OpenCV could not encode the rendered pair")
        file.write_bytes(jpeg.tobytes())
    return files
