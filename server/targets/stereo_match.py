"""Disparity of small windows along the epipolar line, and their sub-pixel refinement in raw images."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from machine.camera import distortion_jacobian, project, undistort_to_rays
from machine.description import StereoCamera
from server.targets.contracts import BoolArray
from server.vision.contracts import Array, Image
from server.vision.odometry_align import PATCH_HALF_PX, align_reference_patches
from server.vision.odometry_features import UNIQUE_RATIO_MAX

ROW_OFFSET_MAX_PX = 1  # EPIPOLAR_MAX_PX of the odometry: rows of the two eyes agree to one pixel
NOISE_MIN_GREY = 1.0  # standard deviation of the least noise that an 8-bit image has
PATCH_GRID_SIDE_SAMPLES = 11  # grid over the patch's diameter
PEAK_HALF_WIDTH_PX = 4  # nearer to the best disparity is the same peak of the correlation


@dataclass(frozen=True, slots=True)
class CoarseMatch:
    """Best disparity [px of focal length], its correlation, and its dissimilarity over that of the next best peak."""

    disparity_px: float
    correlation: float
    dissimilarity_ratio: float

    @property
    def is_unique(self) -> bool:
        """Whether no other disparity explains the window as well (ratio test of Lowe 2004)."""
        return self.dissimilarity_ratio <= UNIQUE_RATIO_MAX


def rectified_window(camera: StereoCamera, image: Image, u_px: Array, v_px: Array) -> NDArray[np.float32]:
    """Grey at the grid u (columns), v (rows) of undistorted coordinates [px of focal length about the axis]."""
    u, v = np.meshgrid(u_px / camera.fx_px, v_px / camera.fy_px)
    raw = project(camera, np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)])).astype(np.float32)
    maps = raw[:, 0].reshape(u.shape), raw[:, 1].reshape(u.shape)
    window = cv2.remap(image, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(window, dtype=np.float32)


def coarse_disparity(
    camera: StereoCamera, left: Image, right: Image, ray: Array, half_px: int, disparities_px: tuple[float, float]
) -> CoarseMatch:
    """Whole-pixel disparity of the window around one ray (2,) of the left eye.

    Model:   zero-mean normalised correlation of an undistorted window along the epipolar line, one row of slack.
    Returns: CoarseMatch; correlation -1 where the window has no grey variation.
    """
    u, v = ray[0] * camera.fx_px, ray[1] * camera.fy_px
    offsets = np.arange(-half_px, half_px + 1.0)
    rows = np.arange(-half_px - ROW_OFFSET_MAX_PX, half_px + ROW_OFFSET_MAX_PX + 1.0)
    least, most = np.floor(disparities_px[0]), np.ceil(disparities_px[1])
    template = rectified_window(camera, left, u + offsets, v + offsets)
    if float(template.std()) < 1e-3:
        return CoarseMatch(float("nan"), -1.0, 1.0)
    columns = np.arange(-half_px - most, half_px - least + 1.0)
    strip = rectified_window(camera, right, u + columns, v + rows)
    scores = np.nan_to_num(np.asarray(cv2.matchTemplate(strip, template, cv2.TM_CCOEFF_NORMED)), nan=-1.0).max(axis=0)
    best = int(scores.argmax())
    apart = np.abs(np.arange(len(scores)) - best) > PEAK_HALF_WIDTH_PX
    rival = float(scores[apart].max(initial=-1.0))
    floor = 2.0 * NOISE_MIN_GREY**2 / float(template.var())  # two windows of one place are no more alike than that
    unlike = [1.0 - max(score, 0.0) ** 2 + floor for score in (float(scores[best]), rival)]
    ambiguity = unlike[0] / unlike[1]
    return CoarseMatch(float(most - best), float(scores[best]), float(ambiguity))


@dataclass(frozen=True, slots=True)
class FineMatch:
    """Disparities (n,) and row differences (n,) [px of focal length], right raw pixels (n, 2), and which are good."""

    disparity_px: Array
    row_px: Array
    right_px: Array
    valid: BoolArray


def fine_disparities(
    camera: StereoCamera, left: Image, right: Image, left_px: Array, disparity_px: Array, slopes: Array
) -> FineMatch:
    """Sub-pixel disparities of raw left places (n, 2), from guesses (n,).

    Model:   patches warped by d(left)/d(right) = (1 - b, -c; 0, 1)^-1, with (b, c) the slopes (n, 2) of the disparity
             along columns and rows, and by the lens at both places; then `align_reference_patches`.
    """
    rays = undistort_to_rays(camera, left_px)
    focal = np.array([camera.fx_px, camera.fy_px])
    rays_right = rays - np.column_stack([disparity_px / camera.fx_px, np.zeros(len(rays))])
    guesses = project(camera, np.column_stack([rays_right, np.ones(len(rays))]))
    forward = np.tile(np.eye(2), (len(rays), 1, 1))
    forward[:, 0, 0] -= slopes[:, 0]
    forward[:, 0, 1] -= slopes[:, 1]
    scale = focal[:, None] / focal[None, :]
    lens_left = distortion_jacobian(camera, rays) * scale
    lens_right = distortion_jacobian(camera, rays_right) * scale
    warps = lens_left @ np.linalg.inv(forward) @ np.linalg.inv(lens_right)
    found = align_reference_patches(left, left_px, warps, right, guesses)
    seen = undistort_to_rays(camera, found.points_px)
    row = (rays[:, 1] - seen[:, 1]) * camera.fy_px
    good = found.valid & (np.abs(row) < ROW_OFFSET_MAX_PX)
    return FineMatch((rays[:, 0] - seen[:, 0]) * camera.fx_px, row, found.points_px, good)


def noise_grey(image: Image | Array) -> float:
    """Standard deviation of an image's noise [grey]; fine texture counts as noise.

    Source:  the Laplacian mask of Immerkaer 1996.
    """
    mask = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])
    filtered = cv2.filter2D(image.astype(np.float64), -1, mask)[1:-1, 1:-1]
    return float(np.sqrt(np.pi / 2.0) / 6.0 * np.abs(filtered).mean())


def texture_sigma_px(image: Image, pixel: tuple[float, float], radius_px: float) -> float:
    """Cramer-Rao bound of the disparity of the whole patch from its gradient along the row [px].

    Source:  sigma_d^2 = 2 sigma_n^2 / sum g_x^2.
    """
    half = int(np.ceil(min(radius_px, 60.0)))
    u, v = round(pixel[0]), round(pixel[1])
    window = image[max(v - half, 0) : v + half + 1, max(u - half, 0) : u + half + 1].astype(np.float64)
    noise = noise_grey(window)
    gradient = 0.5 * (window[:, 2:] - window[:, :-2])
    signal = max(float(np.sum(gradient**2)) - 0.5 * noise**2 * gradient.size, 1e-9)  # its own noise taken off
    return float(np.sqrt(2.0 * max(noise, 0.3) ** 2 / signal))


def sample_places(
    shape: tuple[int, ...], pixel: tuple[float, float], radius_px: float, avoid: Sequence[tuple[float, float, float]]
) -> tuple[Array, int]:
    """Grid (n, 2) [px] over the disc but for the discs (u, v, radius) to avoid, inside the image; n before the image's
    border cut it."""
    steps = np.linspace(-1.0, 1.0, PATCH_GRID_SIDE_SAMPLES) * radius_px
    du, dv = (grid.ravel() for grid in np.meshgrid(steps, steps))
    disc = np.hypot(du, dv) <= radius_px * 1.001
    places = np.column_stack([du[disc], dv[disc]]) + np.array(pixel)
    for u, v, r in avoid:
        places = places[np.hypot(places[:, 0] - u, places[:, 1] - v) > r + PATCH_HALF_PX]
    border = PATCH_HALF_PX + 2
    inside = (places >= border).all(axis=1) & (places < [shape[1] - border, shape[0] - border]).all(axis=1)
    return places[inside], len(places)
