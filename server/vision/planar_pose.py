"""Pose of one flat target in one eye: both planar solutions, never one alone."""

import math

import cv2
import numpy as np
from numba import njit

from machine.poses import pose
from machine.rotations import nearest_rotation
from server.vision.contracts import Array
from server.vision.quadrilateral import of_unit_square
from server.vision.small_algebra import multiply, solve_positive

FLATNESS_MAX_FRAC = 1e-3  # third extent over the first: flatter points are one plane
POINTS_MIN = 4


def planar_poses(rays: Array, side_m: float) -> tuple[Array, ...]:
    """Both poses T_eye_marker that the four corners of a square allow, the better fitting one first; else empty.

    Model:   homography of a square split into its two rigid decompositions (infinitesimal plane-based pose).
    Args:    rays: undistorted corners (4, 2) as x/z, y/z, OpenCV order. side_m: printed side [m].
    Returns: up to two (4, 4) poses in front of the eye.
    Source:  Collins and Bartoli 2014 (IPPE), sections 3.3 and 4; checked against OpenCV's in the tests.
    """
    count, found, _ = square_solutions(np.ascontiguousarray(rays, dtype=np.float64), side_m)
    return tuple(found[:count])


def point_poses(rays: Array, points_object: Array) -> tuple[Array, ...]:
    """Poses T_eye_object that known points in one eye allow: both planar ones, or one where they span space.

    Args:    rays: undistorted points (n, 2) as x/z, y/z. points_object: (n, 3) [m]. n >= 4, not all on one line.
    Returns: up to two (4, 4) poses in front of the eye; empty when there is none.
    Source:  Collins and Bartoli 2014 (IPPE); Terzakis and Lourakis 2020 (SQPnP); both as in OpenCV.
    """
    if len(points_object) < POINTS_MIN:
        return ()
    extents = np.linalg.svd(points_object - points_object.mean(axis=0), compute_uv=False)
    if extents[1] < FLATNESS_MAX_FRAC * extents[0]:
        return ()
    flat = extents[2] < FLATNESS_MAX_FRAC * extents[0]
    method = cv2.SOLVEPNP_IPPE if flat else cv2.SOLVEPNP_SQPNP
    try:
        count, rvecs, tvecs, _ = cv2.solvePnPGeneric(
            np.ascontiguousarray(points_object), rays.reshape(-1, 1, 2), np.eye(3), None, flags=method
        )
    except cv2.error:  # points on a line and the like: no pose, and that is an answer
        return ()
    found = []
    for rvec, tvec in zip(rvecs[:count], tvecs[:count], strict=True):
        rotation = np.asarray(cv2.Rodrigues(rvec)[0], dtype=float)
        position = np.asarray(tvec, dtype=float).reshape(3)
        if np.isfinite(rotation).all() and np.isfinite(position).all() and position[2] > 0.0:
            found.append(pose(nearest_rotation(rotation), position))
    return tuple(found)


@njit(cache=True, nogil=True)
def _homography_of_square(rays: Array, half: float) -> tuple[bool, Array]:
    """H (3, 3), H[2, 2] = 1, from the marker's plane [m] to rays; corners (-h,h) (h,h) (h,-h) (-h,-h)."""
    H = np.empty((3, 3))
    good, place = of_unit_square(rays, 1e-14)  # t downwards
    if not good:
        return False, H
    a, b, x0, d, e, y0, g, h = place
    k = 0.5 / half  # s = 0.5 + k X, t = 0.5 - k Y
    last = 1.0 + 0.5 * (g + h)
    if abs(last) < 1e-9:
        return False, H
    H[0, 0], H[0, 1], H[0, 2] = a * k / last, -b * k / last, (x0 + 0.5 * (a + b)) / last
    H[1, 0], H[1, 1], H[1, 2] = d * k / last, -e * k / last, (y0 + 0.5 * (d + e)) / last
    H[2, 0], H[2, 1], H[2, 2] = g * k / last, -h * k / last, 1.0
    return True, H


@njit(cache=True, nogil=True)
def _ippe_rotations(H: Array) -> tuple[bool, Array]:
    """The two rotations (2, 3, 3) whose first-order image at the marker's middle is that of H."""
    both = np.empty((2, 3, 3))
    p, q = H[0, 2], H[1, 2]
    j00, j01 = H[0, 0] - H[2, 0] * p, H[0, 1] - H[2, 1] * p
    j10, j11 = H[1, 0] - H[2, 0] * q, H[1, 1] - H[2, 1] * q
    # Rv turns the optical axis onto the line of sight (p, q, 1)
    t, s = math.hypot(p, q), math.sqrt(1.0 + p * p + q * q)
    cosine, sine = 1.0 / s, t / s
    kx, ky = (p / t, q / t) if t > 1e-12 else (1.0, 0.0)
    Rv = np.empty((3, 3))
    Rv[0, 0], Rv[0, 1], Rv[0, 2] = 1.0 + (cosine - 1.0) * kx * kx, (cosine - 1.0) * kx * ky, sine * kx
    Rv[1, 0], Rv[1, 1], Rv[1, 2] = Rv[0, 1], 1.0 + (cosine - 1.0) * ky * ky, sine * ky
    Rv[2, 0], Rv[2, 1], Rv[2, 2] = -sine * kx, -sine * ky, cosine
    b00, b01 = Rv[0, 0] - p * Rv[2, 0], Rv[0, 1] - p * Rv[2, 1]
    b10, b11 = Rv[1, 0] - q * Rv[2, 0], Rv[1, 1] - q * Rv[2, 1]
    det = b00 * b11 - b01 * b10
    if abs(det) < 1e-14:
        return False, both
    a00, a01 = (b11 * j00 - b01 * j10) / det, (b11 * j01 - b01 * j11) / det
    a10, a11 = (b00 * j10 - b10 * j00) / det, (b00 * j11 - b10 * j01) / det
    m00, m01, m11 = a00 * a00 + a01 * a01, a00 * a10 + a01 * a11, a10 * a10 + a11 * a11
    gamma = math.sqrt(0.5 * (m00 + m11 + math.sqrt((m00 - m11) ** 2 + 4.0 * m01 * m01)))  # largest singular value
    if not gamma > 1e-12:
        return False, both
    r00, r01, r10, r11 = a00 / gamma, a01 / gamma, a10 / gamma, a11 / gamma
    c0 = math.sqrt(max(1.0 - r00 * r00 - r10 * r10, 0.0))
    c1 = math.sqrt(max(1.0 - r01 * r01 - r11 * r11, 0.0))
    if r00 * r01 + r10 * r11 > 0.0:  # the columns are orthogonal
        c1 = -c1
    inner = np.empty((3, 3))
    for k in range(2):
        sign = 1.0 if k == 0 else -1.0
        inner[0, 0], inner[0, 1], inner[1, 0], inner[1, 1] = r00, r01, r10, r11
        inner[2, 0], inner[2, 1] = sign * c0, sign * c1
        inner[0, 2] = r10 * inner[2, 1] - inner[2, 0] * r11
        inner[1, 2] = inner[2, 0] * r01 - r00 * inner[2, 1]
        inner[2, 2] = r00 * r11 - r10 * r01
        both[k] = multiply(Rv, inner)
    return True, both


@njit(cache=True, nogil=True)
def _least_squares_position(rotation: Array, rays: Array, half: float) -> Array:
    """Least-squares position of a square of known rotation: x - u z = 0 and y - v z = 0 at every corner."""
    matrix, right = np.zeros((3, 3)), np.zeros(3)
    for i in range(4):
        sx = -half if i in (0, 3) else half
        sy = half if i in (0, 1) else -half
        x = rotation[0, 0] * sx + rotation[0, 1] * sy
        y = rotation[1, 0] * sx + rotation[1, 1] * sy
        z = rotation[2, 0] * sx + rotation[2, 1] * sy
        u, v = rays[i, 0], rays[i, 1]
        du, dv = u * z - x, v * z - y
        matrix[0, 0] += 1.0
        matrix[1, 1] += 1.0
        matrix[0, 2] -= u
        matrix[1, 2] -= v
        matrix[2, 2] += u * u + v * v
        right[0] += du
        right[1] += dv
        right[2] -= u * du + v * dv
    matrix[2, 0], matrix[2, 1] = matrix[0, 2], matrix[1, 2]
    return solve_positive(matrix, right)


@njit(cache=True, nogil=True)
def _squared_reprojection_error(rotation: Array, position: Array, rays: Array, half: float) -> float:
    total = 0.0
    for i in range(4):
        sx = -half if i in (0, 3) else half
        sy = half if i in (0, 1) else -half
        z = rotation[2, 0] * sx + rotation[2, 1] * sy + position[2]
        if not z > 0.0:
            return np.inf
        total += ((rotation[0, 0] * sx + rotation[0, 1] * sy + position[0]) / z - rays[i, 0]) ** 2
        total += ((rotation[1, 0] * sx + rotation[1, 1] * sy + position[1]) / z - rays[i, 1]) ** 2
    return total


@njit(cache=True, nogil=True)
def square_solutions(rays: Array, side_m: float) -> tuple[int, Array, Array]:
    """Compiled `planar_poses`: how many, poses (2, 4, 4), sums of squared ray errors (2,)."""
    found, misfits = np.zeros((2, 4, 4)), np.full(2, np.inf)
    half = 0.5 * side_m
    good, H = _homography_of_square(rays, half)
    if not good:
        return 0, found, misfits
    good, rotations = _ippe_rotations(H)
    if not good:
        return 0, found, misfits
    count = 0
    for k in range(2):
        position = _least_squares_position(rotations[k], rays, half)
        misfit = _squared_reprojection_error(rotations[k], position, rays, half) if position[2] > 0.0 else np.inf
        if not misfit < np.inf:
            continue
        place = count
        if count == 1 and misfit < misfits[0]:
            found[1], misfits[1], place = found[0], misfits[0], 0
        found[place, :3, :3], found[place, :3, 3], found[place, 3, 3] = rotations[k], position, 1.0
        misfits[place] = misfit
        count += 1
    return count, found, misfits
