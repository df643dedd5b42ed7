"""One eye's rays, precomputed: through the true lens distortion, for sparse nodes and for every pixel's corners."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import RectBivariateSpline

from machine.camera import undistort_to_rays
from machine.description import StereoCamera
from machine.rotations import Array

RAY_NODE_STEP_PX = 8  # spacing of the sparse rays; the map between them is bilinear
_SPLINE_STEP_PX = 16  # the corners' rays are cubic splines through exact rays of this spacing, good to 1e-7
_FOLD_RADIUS = 1.8  # beyond this |ray| the lens polynomial is no longer trusted to be one to one


@dataclass(frozen=True, slots=True)
class EyeRays:
    """Precomputed rays of one eye: (x/z, y/z) at sparse nodes and at the pixels' corners.

    `node_rays` (rows, cols, 2): node (i, j) sits at pixel (u, v) = ((j - 1) step_px, (i - 1) step_px).
    `pixel_corner_rays` (height + 1, width + 1, 2) float32: corner (i, j) sits at pixel (j - 0.5, i - 0.5).
    """

    camera: StereoCamera
    node_rays: Array
    step_px: int
    pixel_corner_rays: NDArray[np.float32]


def can_project_all(points_cam: Array) -> bool:
    """Whether all points lie where the lens model is one to one (in front, and not far outside the field of view)."""
    return bool(np.all(projectable_mask(points_cam)))


def projectable_mask(points_cam: Array) -> NDArray[np.bool_]:
    """Which points (n, 3) lie where the lens model is one to one, (n,)."""
    depth = points_cam[:, 2]
    return np.asarray((depth > 0.02) & (np.hypot(*points_cam[:, :2].T) < _FOLD_RADIUS * depth))


def rays_at(camera: StereoCamera, u_px: ArrayLike, v_px: ArrayLike) -> Array:
    """Normalised coordinates (len(v), len(u), 2) of the pixel grid u x v."""
    grid = np.stack(np.meshgrid(np.asarray(u_px, float), np.asarray(v_px, float)), axis=-1)
    return undistort_to_rays(camera, grid.reshape(-1, 2)).reshape(grid.shape)


def _corner_rays(camera: StereoCamera) -> NDArray[np.float32]:
    u_px = np.arange(-_SPLINE_STEP_PX, camera.width_px + 2 * _SPLINE_STEP_PX, _SPLINE_STEP_PX)
    v_px = np.arange(-_SPLINE_STEP_PX, camera.height_px + 2 * _SPLINE_STEP_PX, _SPLINE_STEP_PX)
    coarse = rays_at(camera, u_px, v_px)
    u, v = np.arange(camera.width_px + 1) - 0.5, np.arange(camera.height_px + 1) - 0.5
    both = [RectBivariateSpline(v_px, u_px, coarse[..., k])(v, u) for k in range(2)]
    return np.stack(both, axis=-1).astype(np.float32)


def eye_rays(camera: StereoCamera, step_px: int = RAY_NODE_STEP_PX) -> EyeRays:
    """All the rays one eye needs; nodes reach one step beyond the picture's edges.

    Raises: ValueError: the picture's sides are no multiples of the step.
    """
    if camera.width_px % step_px or camera.height_px % step_px:
        size = f"{camera.width_px} x {camera.height_px} px"
        raise ValueError(f"picture size {size}: both sides must be multiples of the node step, {step_px} px")
    u_px = step_px * np.arange(-1, camera.width_px // step_px + 2)
    v_px = step_px * np.arange(-1, camera.height_px // step_px + 2)
    return EyeRays(camera, rays_at(camera, u_px, v_px), step_px, _corner_rays(camera))
