"""The grid of the bench: sides, distances, tilts, noise; and random true poses in each cell."""

from dataclasses import dataclass

import numpy as np

from machine.camera import project_stereo
from machine.description import StereoCamera
from machine.markers import marker_corners
from machine.poses import pose
from machine.rotations import Array, rotation_about, rotation_from_rotvec

SIDES_M = (0.10, 0.15)
DISTANCES_M = (0.4, 0.6, 0.8, 1.0, 1.4, 2.0)
TILTS_DEG = (0.0, 10.0, 20.0, 30.0, 45.0, 60.0)
SIGMAS_PX = (0.1, 0.3)
BORDER_PX = 12.0
_TRIES = 1000


@dataclass(frozen=True, slots=True)
class Cell:
    """One box of the table."""

    side_m: float
    distance_m: float
    tilt_deg: float
    sigma_px: float

    @property
    def name(self) -> str:
        """For file names."""
        return f"s{self.side_m * 1e3:.0f}-z{self.distance_m * 1e3:.0f}-t{self.tilt_deg:.0f}-n{self.sigma_px * 1e3:.0f}"

    def seed(self, seed: int) -> tuple[int, ...]:
        """The cell's own stream of random numbers."""
        numbers = self.side_m * 1e3, self.distance_m * 1e3, self.tilt_deg * 10.0, self.sigma_px * 1e3
        return seed, *(round(number) for number in numbers)


def grid() -> tuple[Cell, ...]:
    """All cells."""
    return tuple(
        Cell(side, distance, tilt, sigma)
        for side in SIDES_M
        for distance in DISTANCES_M
        for tilt in TILTS_DEG
        for sigma in SIGMAS_PX
    )


def random_pose(cell: Cell, camera: StereoCamera, rng: np.random.Generator) -> Array:
    """T_cam_marker: tilted by exactly the cell's tilt against the line of sight, about a random axis in its plane.

    Roll is random, and so is the place in the picture, with the whole marker in both eyes. `distance_m` is the depth.
    """
    for _ in range(_TRIES):
        T = _any_pose(cell, camera, rng)
        corners = marker_corners(cell.side_m) @ T[:3, :3].T + T[:3, 3]
        if np.all(corners[:, 2] > 0.05) and all(_inside(px, camera) for px in project_stereo(camera, corners)):
            return T
    raise ValueError(f"no pose of {cell} lies in view of both eyes")


def _any_pose(cell: Cell, camera: StereoCamera, rng: np.random.Generator) -> Array:
    px = rng.uniform((0.0, 0.0), (camera.width_px, camera.height_px))
    ray = np.array([(px[0] - camera.cx_px) / camera.fx_px, (px[1] - camera.cy_px) / camera.fy_px, 1.0])
    position = ray * cell.distance_m + np.array([0.5 * camera.baseline_m, 0.0, 0.0])
    sight = position - np.array([0.5 * camera.baseline_m, 0.0, 0.0])
    axis = np.cross([0.0, 0.0, 1.0], sight)
    angle = float(np.arctan2(np.linalg.norm(axis), sight[2]))
    towards = rotation_from_rotvec(axis / max(float(np.linalg.norm(axis)), 1e-12) * angle)
    about = rng.uniform(0.0, 2.0 * np.pi)
    tilt = rotation_from_rotvec(np.deg2rad(cell.tilt_deg) * np.array([np.cos(about), np.sin(about), 0.0]))
    roll = rotation_about("z", rng.uniform(0.0, 2.0 * np.pi))
    return pose(towards @ rotation_about("x", np.pi) @ tilt @ roll, position)


def _inside(px: Array, camera: StereoCamera) -> bool:
    return bool(np.all(px > BORDER_PX) and np.all(px < [camera.width_px - BORDER_PX, camera.height_px - BORDER_PX]))
