"""A board's plane in one eye: homography with its covariance, which says how far a prediction may be trusted."""

from dataclasses import dataclass

import cv2
import numpy as np

from machine.camera import project, undistort_to_rays
from machine.description import StereoCamera
from server.vision.contracts import Array

STRAY_PX = 3.0  # a point that lies further from the common plane is not believed
GAUSS_NEWTON_STEPS = 3  # from the robust start, which is within a pixel
POINTS_MIN = 4
DETERMINANT_MIN = 1e-24  # of the equations scaled to a unit diagonal: points on a line leave nothing


@dataclass(frozen=True, slots=True)
class BoardPlane:
    """Homography from the board [squares] to undistorted px about the principal point, h33 = 1; covariance (8, 8)."""

    H: Array
    covariance: Array
    camera: StereoCamera

    def pixels(self, plane: Array) -> Array:
        """Raw pixels (n, 2) of points (n, 2) [squares]; NaN behind the eye."""
        seen = np.column_stack([plane, np.ones(len(plane))]) @ self.H.T
        seen[:, 0] /= self.camera.fx_px
        seen[:, 1] /= self.camera.fx_px
        return project(self.camera, seen)

    def sigmas_px(self, plane: Array) -> Array:
        """Standard deviation (n,) [px] of the predicted places, the larger axis."""
        J = _jacobian(self.H, plane)
        covariances = J @ self.covariance @ J.transpose(0, 2, 1)
        return np.sqrt(np.maximum(np.linalg.eigvalsh(covariances)[:, -1], 0.0))


def fit_plane(plane: Array, pixels: Array, sigmas_px: Array, camera: StereoCamera) -> BoardPlane | None:
    """Homography by weighted Gauss-Newton from a robust start; None where the points do not determine one.

    Model:   minimum of sum |h(plane) - undistorted pixel|^2 / sigma^2 over the points within `STRAY_PX` (or three
             sigma) of a first robust fit.
    Args:    plane (n, 2) [squares], the board's middle at 0. pixels (n, 2) [raw px]. sigmas_px (n,).
    """
    seen = undistort_to_rays(camera, pixels) * camera.fx_px
    if len(plane) < POINTS_MIN or not np.isfinite(seen).all():
        return None
    start, _ = cv2.findHomography(plane, seen, cv2.RANSAC if len(plane) > POINTS_MIN else 0, STRAY_PX)
    if start is None or not np.isfinite(start).all() or abs(start[2, 2]) < 1e-9:
        return None
    H = np.asarray(start, dtype=np.float64) / start[2, 2]
    near = np.linalg.norm(_mapped(H, plane) - seen, axis=1) <= np.maximum(STRAY_PX, 3.0 * sigmas_px)
    if near.sum() < POINTS_MIN:
        return None
    return _gauss_newton(H, plane[near], seen[near], sigmas_px[near], camera)


def _gauss_newton(H: Array, plane: Array, seen: Array, sigmas_px: Array, camera: StereoCamera) -> BoardPlane | None:
    information = np.eye(8)
    for _ in range(GAUSS_NEWTON_STEPS):
        J = _jacobian(H, plane) / sigmas_px[:, None, None]
        residual = (_mapped(H, plane) - seen) / sigmas_px[:, None]
        information = np.einsum("nij,nik->jk", J, J)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        scaled = information * np.outer(scale, scale)
        if not np.isfinite(scaled).all() or np.linalg.det(scaled) < DETERMINANT_MIN:
            return None
        step = scale * np.linalg.solve(scaled, -scale * np.einsum("nij,ni->j", J, residual))
        H = H + np.append(step, 0.0).reshape(3, 3)
    if not np.isfinite(H).all() or np.any(plane @ H[2, :2] + 1.0 <= 0.0):
        return None
    return BoardPlane(H, np.asarray(np.linalg.inv(information), dtype=np.float64), camera)


def _mapped(H: Array, plane: Array) -> Array:
    p = np.column_stack([plane, np.ones(len(plane))]) @ H.T
    return p[:, :2] / p[:, 2:]


def _jacobian(H: Array, plane: Array) -> Array:
    """d(mapped) / d(h11, h12, h13, h21, h22, h23, h31, h32), shape (n, 2, 8)."""
    p = np.column_stack([plane, np.ones(len(plane))])
    inverse = 1.0 / (p @ H[2])
    u, v = (p @ H[0]) * inverse, (p @ H[1]) * inverse
    J = np.zeros((len(plane), 2, 8))
    J[:, 0, 0:3] = J[:, 1, 3:6] = p * inverse[:, None]
    J[:, 0, 6:8] = -u[:, None] * plane * inverse[:, None]
    J[:, 1, 6:8] = -v[:, None] * plane * inverse[:, None]
    return J
