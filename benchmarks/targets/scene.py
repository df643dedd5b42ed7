"""Bare rock with known truth: what the renderer's wall has at a pixel, and poses to look at it from."""

from dataclasses import replace

import numpy as np

from benchmarks.simulator.demo_scene import demo_tcp_pose, demo_world
from machine.camera import undistort_to_rays
from machine.description import Machine, StereoCamera
from machine.poses import pose
from machine.rotations import Array, rotation_from_rotvec
from server.targets.surface import target_frame
from sim_plc.camera.renderer import RenderSetup, StereoRenderer
from sim_plc.camera.wall import Relief, wall_hit

NORMAL_BASE_PX = 8.0  # the relief's own grid is coarser than what so many pixels span
HIT_STEPS = 40
RELIEF_M = 0.05


def bare_rock(
    machine: Machine, seed: int, contrast_frac: float = 1.0, noise_grey: float = 2.0, structure_frac: float = 0.0
) -> StereoRenderer:
    """A renderer of the nominal camera before a wall without markers; base = OOI frame."""
    return StereoRenderer(bare_rock_setup(machine, seed, contrast_frac, noise_grey, structure_frac))


def bare_rock_setup(
    machine: Machine, seed: int, contrast_frac: float = 1.0, noise_grey: float = 2.0, structure_frac: float = 0.0
) -> RenderSetup:
    """The same, before anything is drawn."""
    camera, scene = demo_world(
        machine,
        noise_grey=noise_grey,
        wall_relief_m=RELIEF_M,
        texture_contrast_frac=contrast_frac,
        texture_seed=seed,
        structure_frac=structure_frac,
    )
    return RenderSetup(camera, replace(scene, ooi_markers=(), ooi_boards=()))


def view(machine: Machine, rng: np.random.Generator, distance_m: float, tilt_deg: float = 4.0) -> Array:
    """T_base_tcp that looks at the wall from about that distance of the tool, turned a little."""
    place = demo_tcp_pose(machine, distance_m, tuple(rng.uniform(-0.1, 0.1, 2)))
    turn = rotation_from_rotvec(np.deg2rad(rng.uniform(-tilt_deg, tilt_deg, 3)))
    return place @ pose(turn, rng.uniform(-0.03, 0.03, 3))


def true_target(relief: Relief, camera: StereoCamera, T_ooi_cam: Array, pixel: tuple[float, float]) -> Array:
    """T_cam_target as the wall truly is at a raw left pixel; `camera`: the true left eye."""

    def hit(place: Array) -> Array:
        ray = T_ooi_cam[:3, :3] @ np.append(undistort_to_rays(camera, place[None])[0], 1.0)
        dx, dy, dz = ray
        x, y, height = wall_hit(relief.heights_m, relief.mean_z_m, 0.0, T_ooi_cam[:3, 3].copy(), dx, dy, dz, HIT_STEPS)
        return np.array([x, y, relief.mean_z_m + height])

    at, step = np.array(pixel), np.diag([NORMAL_BASE_PX, NORMAL_BASE_PX])
    normal = np.cross(hit(at + step[0]) - hit(at - step[0]), hit(at + step[1]) - hit(at - step[1]))
    normal *= np.sign(normal[2]) / np.linalg.norm(normal)
    R_cam_ooi = T_ooi_cam[:3, :3].T
    return target_frame(R_cam_ooi @ normal, R_cam_ooi @ (hit(at) - T_ooi_cam[:3, 3]))


def left_eye(renderer: StereoRenderer, T_base_tcp: Array) -> Array:
    """T_ooi_cam of the true left eye."""
    return renderer.Ts_ooi_cam(renderer.eyes[0], T_base_tcp[None])[0]
