"""What plain OpenCV makes of the same corners: left eye, IPPE's first solution, with and without refinement."""

import cv2
import numpy as np
from cv2.typing import MatLike

from machine.description import StereoCamera
from machine.markers import marker_corners
from machine.rotations import Array


def ippe_left(camera: StereoCamera, side_m: float, left_px: Array) -> tuple[Array, Array]:
    """Poses (4, 4) of one marker: IPPE's first, and the same after `solvePnPRefineLM`; NaN where there is none."""
    K = np.array([[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]])
    lens = np.array(camera.distortion)
    corners, pixels = marker_corners(side_m), np.ascontiguousarray(left_px).reshape(-1, 1, 2)
    count, rvecs, tvecs, _ = cv2.solvePnPGeneric(corners, pixels, K, lens, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    if not count:
        return np.full((4, 4), np.nan), np.full((4, 4), np.nan)
    plain = _pose(rvecs[0], tvecs[0])
    rvec, tvec = cv2.solvePnPRefineLM(corners, pixels, K, lens, rvecs[0].copy(), tvecs[0].copy())
    return plain, _pose(rvec, tvec)


def _pose(rvec: MatLike, tvec: MatLike) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(rvec)[0], np.asarray(tvec, dtype=float).reshape(3)
    return T
