"""A flat wall of equal tiles in both eyes, through the lens, with noise: texture that repeats along the rows."""

import cv2
import numpy as np

from machine.camera import undistort_to_rays
from machine.description import StereoCamera
from server.vision.contracts import Image

TILE_PX = (30, 80)  # of one repetition in the image, so that several lie in the range of disparities
NOISE_GREY = 2.0


def tiled_pair(camera: StereoCamera, rng: np.random.Generator) -> tuple[Image, Image]:
    """Left and right raw images (h, w) of a wall parallel to the eyes."""
    period = int(rng.integers(*TILE_PX))
    height, width = camera.height_px, camera.width_px
    rough = rng.integers(0, 255, (2 * height, period)).astype(np.uint8)
    tile = cv2.GaussianBlur(rough, (0, 0), 2.0, borderType=cv2.BORDER_WRAP)
    tile = np.interp(tile, (float(tile.min()), float(tile.max())), (20.0, 235.0)).astype(np.uint8)
    wall = np.tile(tile, (1, 4 * width // period))
    u, v = np.meshgrid(np.arange(float(width)), np.arange(float(height)))
    rays = undistort_to_rays(camera, np.column_stack([u.ravel(), v.ravel()]))
    down = (rays[:, 1] * camera.fy_px + height).reshape(u.shape).astype(np.float32)
    across = rays[:, 0] * camera.fx_px + 1.5 * width
    disparity = float(rng.uniform(50.0, 120.0))
    eyes = []
    for shift in (0.0, disparity):
        columns = (across + shift).reshape(u.shape).astype(np.float32)
        seen = cv2.remap(wall, columns, down, cv2.INTER_CUBIC)
        eyes.append((seen + rng.normal(0.0, NOISE_GREY, u.shape)).clip(0, 255).astype(np.uint8))
    return eyes[0], eyes[1]
