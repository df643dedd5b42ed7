"""What a machine's own lens and rig errors make of its odometry: the space in which it measures its way is bent.

A focal length, principal point, distortion and disparity that are off give, to first order, an affine image of the true
way, up to two parts in a hundred off.
"""

import numpy as np
from numpy.typing import NDArray

from machine.camera import project, undistort_to_rays
from machine.description import StereoCamera
from machine.poses import inverse_pose, pose
from machine.rotations import Array, rotation_from_rotvec
from sim_plc.world import World, rng_for

STEP_M = 0.1  # about half the size of a calibration path
BORDER_PX = 20.0
GRID = (8, 6)
_ROUNDS = 3


def bent_path(Ts_base_cam: Array, affine: Array) -> Array:
    """Camera path (n, 4, 4) from its first pose on, its positions moved by `affine` (3, 3) of themselves."""
    relative = inverse_pose(Ts_base_cam[0]) @ Ts_base_cam
    relative[:, :3, 3] += relative[:, :3, 3] @ affine.T
    return relative


def lens_affine(world: World, T_base_tcp: Array) -> Array:
    """What share of a true step (3, 3) the odometry adds to it, camera axes, in front of the wall.

    Model:   points of the wall are triangulated with the nominal camera from the true eyes' pixels, once; from a pose
             one step on, the true eyes' pixels of the same points are explained by a nominal pose (least squares over
             both eyes). Found less true step, over the step, for each axis.
    """
    nominal, true = world.nominal.camera, (world.camera.left, world.camera.right)
    points = _wall_points(world, T_base_tcp)
    mapped = _triangulated(nominal, _pixels(true, points))
    columns = []
    for axis in np.eye(3):
        seen = _pixels(true, points - STEP_M * axis)
        columns.append((_camera_at(nominal, mapped, seen, STEP_M * axis) - STEP_M * axis) / STEP_M)
    return np.column_stack(columns)


def _wall_points(world: World, T_base_tcp: Array) -> Array:
    """True points (n, 3) [m] of the wall in the left eye, in view of both, within the relief."""
    left = world.camera.left
    T_cam_ooi = inverse_pose(T_base_tcp @ world.camera.T_tcp_cam_left) @ world.scene.T_base_ooi
    columns = np.linspace(BORDER_PX, left.width_px - BORDER_PX, GRID[0])
    rows = np.linspace(BORDER_PX, left.height_px - BORDER_PX, GRID[1])
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    rays = np.column_stack([undistort_to_rays(left, pixels), np.ones(len(pixels))])
    normal = T_cam_ooi[:3, 2]
    depths = (T_cam_ooi[:3, 3] - world.scene.wall_offset_m * normal) @ normal / (rays @ normal)
    half = 0.5 * world.scene.wall_relief_m
    relief = rng_for(world.seed, "wall points").uniform(-half, half, len(rays))
    points = rays * depths[:, None] + relief[:, None] * normal
    right = _pixels((left, world.camera.right), points)[:, 2:]
    return points[(depths > 0.0) & _in_image(left, right)]


def _pixels(eyes: tuple[StereoCamera, StereoCamera], points: Array) -> Array:
    """Left and right pixels side by side (n, 4)."""
    shift = np.array([eyes[0].baseline_m, 0.0, 0.0])
    return np.concatenate([project(eyes[0], points), project(eyes[1], points - shift)], axis=1)


def _triangulated(camera: StereoCamera, pixels: Array) -> Array:
    left, right = undistort_to_rays(camera, pixels[:, :2]), undistort_to_rays(camera, pixels[:, 2:])
    depth = camera.baseline_m / (left[:, 0] - right[:, 0])
    return np.column_stack([left[:, 0], 0.5 * (left[:, 1] + right[:, 1]), np.ones(len(depth))]) * depth[:, None]


def _in_image(camera: StereoCamera, pixels: Array) -> NDArray[np.bool_]:
    last = np.array([camera.width_px, camera.height_px])
    return np.all(np.isfinite(pixels) & (pixels > 0.0) & (pixels < last), axis=1)


def _camera_at(camera: StereoCamera, points: Array, pixels: Array, guess: Array) -> Array:
    """Position (3,) [m] of the camera that explains the pixels of points best, its rotation free."""
    inside = _in_image(camera, pixels[:, :2]) & _in_image(camera, pixels[:, 2:])
    points, pixels = points[inside], pixels[inside]

    def residual(x: Array) -> Array:
        T = inverse_pose(pose(rotation_from_rotvec(x[:3]), x[3:]))
        return (_pixels((camera, camera), points @ T[:3, :3].T + T[:3, 3]) - pixels).ravel()

    x = np.concatenate([np.zeros(3), guess])
    for _ in range(_ROUNDS):
        r = residual(x)
        J = np.column_stack([(residual(x + 1e-6 * one) - r) / 1e-6 for one in np.eye(6)])
        x = x - np.linalg.lstsq(J, r, rcond=None)[0]
    return x[3:]
