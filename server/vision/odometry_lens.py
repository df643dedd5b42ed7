"""What the lens makes of the noise of a raw coordinate: away from the middle, a pixel is worth more."""

import numpy as np

from machine.camera import distortion_jacobian
from machine.description import StereoCamera
from server.vision.contracts import Array


def ray_noise(camera: StereoCamera, rays: Array) -> Array:
    """Covariances (n, 2, 2) of undistorted rays, in px of the focal length, for raw noise of 1 px; NaN rays give the
    identity.

    Model:   D^-1 D^-T, D = d(distorted ray) / d(ray).
    """
    known = np.isfinite(rays).all(axis=1)
    noise = np.tile(np.eye(2), (len(rays), 1, 1))
    inverse = np.linalg.inv(distortion_jacobian(camera, rays[known]))
    noise[known] = inverse @ inverse.transpose(0, 2, 1)
    return noise


def ray_sigma(camera: StereoCamera, rays: Array) -> Array:
    """The same as one number per ray (n,): the root of the mean variance of both coordinates."""
    noise = ray_noise(camera, rays)
    return np.sqrt(0.5 * (noise[:, 0, 0] + noise[:, 1, 1]))
