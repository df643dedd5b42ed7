"""One eye as pinhole plus Brown distortion, with OpenCV's axes, coefficients and pixel centres.

The eye's frame: x right, y down, z forward along the optical axis; the centre of the top left pixel is (0, 0).
"""

import numpy as np
from numba import njit

from machine.description import StereoCamera
from machine.errors import MachineError
from machine.lens import fold_radius
from machine.rotations import Array

NEWTON_ITERATIONS_MAX = 50  # 5 suffice inside the image of the nominal lens
NEWTON_CONVERGED_STEP = 1e-14  # normalised units: 5e-12 px
DEPTH_MIN_M = 1e-9  # at or behind the eye


def distort_rays(camera: StereoCamera, rays: Array) -> Array:
    """Distorted normalised coordinates.

    Model:   r2 = x^2 + y^2, g = 1 + k1 r2 + k2 r2^2 + k3 r2^3; x' = x g + 2 p1 x y + p2 (r2 + 2 x^2),
             y' = y g + p1 (r2 + 2 y^2) + 2 p2 x y.
    Args:    rays: undistorted (x/z, y/z), shape (n, 2).
    Returns: (n, 2). Beyond `fold_radius` the model folds back and means nothing.
    Source:  Brown 1966; OpenCV's camera model with (k1, k2, p1, p2, k3).
    """
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


def _focal_lengths_px(camera: StereoCamera) -> Array:
    return np.array([camera.fx_px, camera.fy_px])


def _principal_point_px(camera: StereoCamera) -> Array:
    return np.array([camera.cx_px, camera.cy_px])


def project(camera: StereoCamera, points_cam: Array) -> Array:
    """Pixels (n, 2) of points (n, 3) [m] in one eye's frame; points at or behind the eye give NaN."""
    points = _checked_points(points_cam)
    depth = np.where(points[:, 2] > DEPTH_MIN_M, points[:, 2], np.nan)
    rays = points[:, :2] / depth[:, None]
    return distort_rays(camera, rays) * _focal_lengths_px(camera) + _principal_point_px(camera)


def project_stereo(camera: StereoCamera, points_cam_left: Array) -> tuple[Array, Array]:
    """Pixels (n, 2) in the left and in the right eye of points (n, 3) [m] in the left eye's frame."""
    shift = np.array([camera.baseline_m, 0.0, 0.0])
    return project(camera, points_cam_left), project(camera, _checked_points(points_cam_left) - shift)


def projection_jacobian(camera: StereoCamera, points_cam: Array) -> Array:
    """d(pixel)/d(point), analytic.

    Args:    points_cam: (n, 3) [m] in one eye's frame, in front of it.
    Returns: (n, 2, 3) [px/m]; NaN for points at or behind the eye.
    """
    points = _checked_points(points_cam)
    inverse_depth = 1.0 / np.where(points[:, 2] > DEPTH_MIN_M, points[:, 2], np.nan)
    rays = points[:, :2] * inverse_depth[:, None]
    pinhole = np.zeros((len(points), 2, 3))
    pinhole[:, 0, 0] = pinhole[:, 1, 1] = inverse_depth
    pinhole[:, :, 2] = -rays * inverse_depth[:, None]
    return _focal_lengths_px(camera)[None, :, None] * (distortion_jacobian(camera, rays) @ pinhole)


def undistort_to_rays(camera: StereoCamera, pixels: Array) -> Array:
    """Undistorted normalised coordinates of raw pixels, by Newton's method.

    Args:    pixels: (n, 2) [px] in one eye's raw image.
    Returns: rays (x/z, y/z), (n, 2), good to 1e-9 px inside the image. Far outside it, where the lens model has no ray,
             the outermost ray that it has, |ray| = `fold_radius`. A pixel of NaN stays NaN.
    Raises:  MachineError: wrong shape.
    """
    pixels = np.asarray(pixels, dtype=float)
    if pixels.ndim != 2 or pixels.shape[1] != 2:
        raise MachineError(f"pixels have shape {pixels.shape}; give (n, 2) [px]")
    distorted = (pixels - _principal_point_px(camera)) / _focal_lengths_px(camera)
    return undistort_normalised(distorted, np.array(camera.distortion), fold_radius(camera.distortion))


@njit(cache=True, nogil=True)
def undistort_normalised(distorted: Array, coefficients: Array, radius_max: float) -> Array:
    """Compiled `undistort_to_rays`, of distorted normalised coordinates (n, 2)."""
    k1, k2, p1, p2, k3 = coefficients
    rays = np.empty_like(distorted)
    for i in range(distorted.shape[0]):
        x, y = distorted[i]
        for _ in range(NEWTON_ITERATIONS_MAX):
            outside = np.sqrt(x * x + y * y) / radius_max
            if outside > 1.0:  # stay where the model is one to one
                x, y = x / outside, y / outside
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)  # d radial / d r2
            u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - distorted[i, 0]
            v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y - distorted[i, 1]
            if abs(u) < NEWTON_CONVERGED_STEP and abs(v) < NEWTON_CONVERGED_STEP:
                break
            xx = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
            xy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
            yy = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
            det = xx * yy - xy * xy
            if det <= 0.0:  # on the fold: there is no ray further out
                break
            x, y = x - (yy * u - xy * v) / det, y - (xx * v - xy * u) / det
        rays[i, 0], rays[i, 1] = x, y
    return rays


def _checked_points(points: Array) -> Array:
    array = np.asarray(points, dtype=float)
    if array.ndim != 2 or array.shape[1] != 3:
        raise MachineError(f"points have shape {array.shape}; give (n, 3) [m] in the eye's frame")
    return array
