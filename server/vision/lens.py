"""Points between the raw image and the ideal pinhole of one eye: images are never remapped, points are.

Pixel centres everywhere in vision: the centre of the top left pixel is (0, 0), as OpenCV has it.
"""

import numpy as np

from machine.description import StereoCamera
from server.vision.contracts import Array

UNDISTORT_ITERATIONS = 30


def distort(camera: StereoCamera, rays: Array) -> Array:
    """Raw pixels (n, 2) of ideal rays (n, 2) = (x/z, y/z).

    Model:   radial k1, k2, k3 and tangential p1, p2 on the normalised plane, then u = fx x + cx, v = fy y + cy.
    Source:  OpenCV camera model.
    """
    k1, k2, p1, p2, k3 = camera.distortion
    x, y = rays[:, 0], rays[:, 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return np.stack([camera.fx_px * xd + camera.cx_px, camera.fy_px * yd + camera.cy_px], axis=1)


def undistort(camera: StereoCamera, points_px: Array) -> Array:
    """Ideal rays (n, 2) = (x/z, y/z) of raw pixels (n, 2): the inverse of `distort`, by fixed-point iteration."""
    k1, k2, p1, p2, k3 = camera.distortion
    xd = (points_px[:, 0] - camera.cx_px) / camera.fx_px
    yd = (points_px[:, 1] - camera.cy_px) / camera.fy_px
    x, y = xd.copy(), yd.copy()
    for _ in range(UNDISTORT_ITERATIONS):
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        x_new = (xd - 2.0 * p1 * x * y - p2 * (r2 + 2.0 * x * x)) / radial
        y_new = (yd - p1 * (r2 + 2.0 * y * y) - 2.0 * p2 * x * y) / radial
        moved = float(np.max(np.abs(x_new - x) + np.abs(y_new - y), initial=0.0))
        x, y = x_new, y_new
        if moved < 1e-13:
            break
    return np.stack([x, y], axis=1)


def focal_px(camera: StereoCamera) -> Array:
    """(fx, fy) [px]."""
    return np.array([camera.fx_px, camera.fy_px])
