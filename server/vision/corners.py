"""Corners of a detected marker to a fraction of a pixel: coarse corner search, then fitted sides."""

import cv2
import numpy as np

from machine.camera import project, undistort_to_rays
from machine.description import StereoCamera
from server.vision.contracts import Array, Image
from server.vision.edge_fit import SideFit, fit_corners, side_length_min


def side_sags(camera: StereoCamera | None, corners_px: Array) -> Array:
    """How the lens bows each side of a square outward (4, 2) [px]: at its middle, and how lopsided; zeros without one.

    Model:   bow(t) = 4 t (1-t) (s + k (2t-1)), through the lens's true bow at a quarter and three quarters of the side.
    """
    if camera is None or not any(camera.distortion):
        return np.zeros((4, 2))
    rays = undistort_to_rays(camera, corners_px)
    ahead = np.roll(rays, -1, axis=0)
    on_sides = np.concatenate([0.75 * rays + 0.25 * ahead, 0.25 * rays + 0.75 * ahead])
    bowed = project(camera, np.column_stack([on_sides, np.ones(8)])).reshape(2, 4, 2) - corners_px
    along = np.roll(corners_px, -1, axis=0) - corners_px
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
    first, second = np.sum(bowed * outward, axis=2)  # 4 t (1-t) is 3/4 at both, 2t-1 is -+1/2
    return np.column_stack([(first + second) / 1.5, (second - first) / 0.75])


def corner_search(image: Image, corners_px: Array, cells: int) -> Array:
    """OpenCV's gradient corner search with a window of at most 0.6 cell; the start where it runs away."""
    cell = side_length_min(corners_px) / cells
    half = int(np.clip(0.6 * cell, 1, 7))
    start = np.ascontiguousarray(corners_px, dtype=np.float32).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.005)
    found = cv2.cornerSubPix(image, start.copy(), (half, half), (-1, -1), criteria).reshape(-1, 2)
    far = np.linalg.norm(found - corners_px, axis=1) > half + 1.0
    return np.where(far[:, None] | ~np.isfinite(found), corners_px, found).astype(np.float64)


def refine_corners(
    image: Image, corners_px: Array, cells: int, camera: StereoCamera | None = None
) -> tuple[SideFit, Array]:
    """Refined corners (4, 2) [px] of one marker, OpenCV order; from the corner search alone where sides are not clean.

    Model:   stage 1 corner search to about 0.3 px, stage 2 sides fitted with an error-function edge and intersected.
    Args:    image: grey (h, w). corners_px: detector's corners (4, 2). cells: cells along a side with its border.
             camera: for the bow the lens gives the sides; None where there is no lens to correct.
    """
    height, width = image.shape
    start = np.clip(np.asarray(corners_px, dtype=np.float64), 0.0, [width - 1.0, height - 1.0])
    coarse = corner_search(image, start, cells)
    sags = side_sags(camera, coarse)
    fit, corners = fit_corners(image, coarse, cells, sags)
    if fit is SideFit.COVERED:  # the search may have run to an inner corner; the contour did not
        again, from_contour = fit_corners(image, start, cells, sags)
        if again is SideFit.CLEAN:
            return again, from_contour
    return fit, corners
