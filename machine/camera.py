"""One eye as pinhole plus Brown distortion, with OpenCV's axes, coefficients and pixel centres."""

import numpy as np

from machine.description import StereoCamera
from machine.errors import MachineError
from machine.rotations import Array

NEWTON_STEPS = 12


def distort_rays(camera: StereoCamera, rays: Array) -> Array:
    """Distorted normalised coordinates (n, 2) of undistorted ones (n, 2)."""
    k1, k2, p1, p2, k3 = camera.distortion
    x, y = rays[:, 0], rays[:, 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return np.stack([u, v], axis=1)


def distortion_jacobian(camera: StereoCamera, rays: Array) -> Array:
    """d(distorted)/d(undistorted), shape (n, 2, 2)."""
    k1, k2, p1, p2, k3 = camera.distortion
    x, y = rays[:, 0], rays[:, 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)  # d radial / d r2
    J = np.empty((len(rays), 2, 2))
    J[:, 0, 0] = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    J[:, 0, 1] = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    J[:, 1, 0] = J[:, 0, 1]
    J[:, 1, 1] = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    return J


def _focal(camera: StereoCamera) -> Array:
    return np.array([camera.fx_px, camera.fy_px])


def _centre(camera: StereoCamera) -> Array:
    return np.array([camera.cx_px, camera.cy_px])


def project(camera: StereoCamera, points_cam: Array) -> Array:
    """Pixels (n, 2) of points (n, 3) [m] in one eye's frame; points at or behind the eye give NaN."""
    points = _points(points_cam)
    depth = np.where(points[:, 2] > 1e-9, points[:, 2], np.nan)
    rays = points[:, :2] / depth[:, None]
    return distort_rays(camera, rays) * _focal(camera) + _centre(camera)


def project_stereo(camera: StereoCamera, points_cam_left: Array) -> tuple[Array, Array]:
    """Pixels (n, 2) in the left and in the right eye of points (n, 3) [m] in the left eye's frame."""
    shift = np.array([camera.baseline_m, 0.0, 0.0])
    return project(camera, points_cam_left), project(camera, _points(points_cam_left) - shift)


def projection_jacobian(camera: StereoCamera, points_cam: Array) -> Array:
    """d(pixel)/d(point in the eye's frame), shape (n, 2, 3) [px/m]."""
    points = _points(points_cam)
    inverse_depth = 1.0 / points[:, 2]
    rays = points[:, :2] * inverse_depth[:, None]
    pinhole = np.zeros((len(points), 2, 3))
    pinhole[:, 0, 0] = pinhole[:, 1, 1] = inverse_depth
    pinhole[:, 0, 2] = -rays[:, 0] * inverse_depth
    pinhole[:, 1, 2] = -rays[:, 1] * inverse_depth
    return _focal(camera)[None, :, None] * (distortion_jacobian(camera, rays) @ pinhole)


def undistort_to_rays(camera: StereoCamera, pixels: Array) -> Array:
    """Undistorted normalised coordinates (n, 2) of raw pixels (n, 2), by Newton's method.

    Converges to 1e-12 inside the image; a pixel whose ray the lens model cannot produce keeps its last iterate.
    """
    distorted = (np.asarray(pixels, dtype=float).reshape(-1, 2) - _centre(camera)) / _focal(camera)
    if not any(camera.distortion):
        return distorted
    rays = distorted.copy()
    for _ in range(NEWTON_STEPS):
        residual = distort_rays(camera, rays) - distorted
        if np.abs(residual).max(initial=0.0) < 1e-13:
            break
        J = distortion_jacobian(camera, rays)
        det = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
        rays[:, 0] -= (J[:, 1, 1] * residual[:, 0] - J[:, 0, 1] * residual[:, 1]) / det
        rays[:, 1] -= (J[:, 0, 0] * residual[:, 1] - J[:, 1, 0] * residual[:, 0]) / det
    return rays


def _points(points: Array) -> Array:
    array = np.asarray(points, dtype=float)
    if array.ndim != 2 or array.shape[1] != 3:
        raise MachineError(f"points have shape {array.shape}; give (n, 3) [m] in the eye's frame")
    return array
