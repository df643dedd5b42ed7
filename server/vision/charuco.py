"""Chess corners of a ChArUco board: its markers say where to look, the edges of its squares say where they are."""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from machine.boards import board_marker_ids, board_markers, dark_first, inner_corners
from machine.camera import project, undistort_to_rays
from machine.description import Board, StereoCamera
from machine.markers import marker_corners
from machine.poses import inverse_pose, transform_points
from server.vision.charuco_saddle import fit_saddles
from server.vision.contracts import Array, Image
from server.vision.pose_problem import PointSighting

PLANE_OUTLIER_MIN_PX = 3.0  # a point that lies further from the common plane is not believed
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
        J = _homography_jacobian(self.H, plane)
        covariances = J @ self.covariance @ J.transpose(0, 2, 1)
        return np.sqrt(np.maximum(np.linalg.eigvalsh(covariances)[:, -1], 0.0))


def fit_plane(plane: Array, pixels: Array, sigmas_px: Array, camera: StereoCamera) -> BoardPlane | None:
    """Homography by weighted Gauss-Newton from a robust start; None where the points do not determine one.

    Model:   minimum of sum |h(plane) - undistorted pixel|^2 / sigma^2 over the points within `PLANE_OUTLIER_MIN_PX` (or
    three
             sigma) of a first robust fit.
    Args:    plane (n, 2) [squares], the board's middle at 0. pixels (n, 2) [raw px]. sigmas_px (n,).
    """
    seen = undistort_to_rays(camera, pixels) * camera.fx_px
    if len(plane) < POINTS_MIN or not np.isfinite(seen).all():
        return None
    start, _ = cv2.findHomography(plane, seen, cv2.RANSAC if len(plane) > POINTS_MIN else 0, PLANE_OUTLIER_MIN_PX)
    if start is None or not np.isfinite(start).all() or abs(start[2, 2]) < 1e-9:
        return None
    H = np.asarray(start, dtype=np.float64) / start[2, 2]
    near = np.linalg.norm(_apply_homography(H, plane) - seen, axis=1) <= np.maximum(
        PLANE_OUTLIER_MIN_PX, 3.0 * sigmas_px
    )
    if near.sum() < POINTS_MIN:
        return None
    return _gauss_newton(H, plane[near], seen[near], sigmas_px[near], camera)


def _gauss_newton(H: Array, plane: Array, seen: Array, sigmas_px: Array, camera: StereoCamera) -> BoardPlane | None:
    information = np.eye(8)
    for _ in range(GAUSS_NEWTON_STEPS):
        J = _homography_jacobian(H, plane) / sigmas_px[:, None, None]
        residual = (_apply_homography(H, plane) - seen) / sigmas_px[:, None]
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


def _apply_homography(H: Array, plane: Array) -> Array:
    p = np.column_stack([plane, np.ones(len(plane))]) @ H.T
    return p[:, :2] / p[:, 2:]


def _homography_jacobian(H: Array, plane: Array) -> Array:
    """d(mapped) / d(h11, h12, h13, h21, h22, h23, h31, h32), shape (n, 2, 8)."""
    p = np.column_stack([plane, np.ones(len(plane))])
    inverse = 1.0 / (p @ H[2])
    u, v = (p @ H[0]) * inverse, (p @ H[1]) * inverse
    J = np.zeros((len(plane), 2, 8))
    J[:, 0, 0:3] = J[:, 1, 3:6] = p * inverse[:, None]
    J[:, 0, 6:8] = -u[:, None] * plane * inverse[:, None]
    J[:, 1, 6:8] = -v[:, None] * plane * inverse[:, None]
    return J


FIT_RESIDUAL_MAX_FRAC = 0.10  # rms of the fit over its contrast; clean corners stay below 0.05
CONTRAST_MIN_GREY = 16.0
SQUARE_SIDE_MIN_PX = 5.0  # of a square
# Of a decoded marker's corner before refinement; found chess corners count as CORNER_SIGMA_PX
MARKER_CORNER_SIGMA_PX = 0.8
CORNER_SIGMA_PX = 0.2
PREDICTION_SIGMA_MAX_FRAC = 0.10  # of a square: a corner is looked for only where its place is known to this sigma ...
CORNER_SHIFT_MAX_FRAC = 0.35  # ... and is it only if it lies this near: the next one alike is 1.4 squares away
OFF_PLANE_MIN_PX = 0.5  # a corner may lie this far from the plane of the others, or five times their spread
OFF_PLANE_MEDIAN_FACTOR = 5.0
OFF_PLANE_CORNERS_MIN = 8  # fewer cannot outvote one
CORNERS_MIN = 4  # fewer give no plane, and one by itself may be anything
MARKER_OFFSET_MAX_FRAC = 0.35  # of a square: a marker this far from its place belongs to a board described otherwise
SEARCH_PASSES_MAX = 8  # the corners found show where their neighbours are


def board_corners(image: Image, board: Board, found: Mapping[int, Array], camera: StereoCamera) -> Array:
    """Inner chess corners of one board in one eye.

    Model:   homography from the markers found, then also from the corners found; where its own covariance says that a
             place is known, two edges are fitted (`charuco_saddle`). A corner is dropped where the fit is rough, where
             black and white are swapped, or where it lies off the plane of the others.
    Args:    image: raw grey (h, w). found: corners (4, 2) [raw px] of decoded markers by id, also those whose sides
             are not clean. camera: this eye.
    Returns: (n, 2) [raw px] in the order of `machine.boards.inner_corners`; NaN where not seen.
    """
    plane = inner_corners(board)[:, :2] / board.square_m
    seen = np.full(plane.shape, np.nan)
    markers = _marker_points(board, found)
    where = _agreed_plane(markers, camera)
    for _ in range(SEARCH_PASSES_MAX):
        if where is None or np.isfinite(seen).all():
            break
        fitted = np.where(np.isnan(seen), _fit_board_corners(image, board, where, plane, np.isnan(seen[:, 0])), seen)
        if np.isnan(fitted).sum() == np.isnan(seen).sum():
            break
        seen = fitted
        where = _plane_of(markers, plane, seen, camera)
    seen = _on_plane(seen, plane, camera)
    return seen if np.isfinite(seen[:, 0]).sum() >= CORNERS_MIN else np.full(plane.shape, np.nan)


def board_sighting(
    board: Board,
    images: tuple[Image, Image],
    found: tuple[Mapping[int, Array], Mapping[int, Array]],
    camera: StereoCamera,
) -> PointSighting | None:
    """One charuco board in both eyes (left, right), in the axes of the object it sits on; None where no eye sees it."""
    left, right = (board_corners(image, board, ids, camera) for image, ids in zip(images, found, strict=True))
    both = tuple(None if np.isnan(px).all() else px for px in (left, right))
    if all(px is None for px in both):
        return None
    points = transform_points(board.T_on_board, inner_corners(board))
    return PointSighting(f"board {board.first_id}", board.first_id, points, *both)


def why_no_corner(board: Board, found: Mapping[int, Array]) -> str:
    """What to do about a board of which markers are seen, but no chess corner; empty where no marker is seen."""
    n = len(set(board_marker_ids(board)) & found.keys())
    if n == 0:
        return ""
    return (
        f"board {board.first_id}: {n} of its markers are seen but no chess corner is clean; check light and focus, and "
        "its squares, sizes and legacy_pattern in the machine file"
    )


def _marker_points(board: Board, found: Mapping[int, Array]) -> tuple[Array, Array]:
    """Corners of the markers found: on the board (n, 2) [squares], in the image (n, 2) [raw px]."""
    T_board_on = inverse_pose(board.T_on_board)
    plane, pixels = [np.empty((0, 2))], [np.empty((0, 2))]
    for marker in board_markers(board):
        if marker.marker_id in found:
            corners = transform_points(T_board_on @ marker.T_on_marker, marker_corners(marker.side_m))
            plane.append(corners[:, :2] / board.square_m)
            pixels.append(np.asarray(found[marker.marker_id], dtype=float).reshape(4, 2))
    return np.concatenate(plane), np.concatenate(pixels)


def _agreed_plane(markers: tuple[Array, Array], camera: StereoCamera) -> BoardPlane | None:
    """The plane by the markers; None unless every one of them lies where the board's description has it.

    A wrong legacy_pattern moves most markers by one column, and only the first of every other row elsewhere: to outvote
    those would give a pose that is wrong by a square.
    """
    plane, pixels = markers
    where = fit_plane(plane, pixels, np.full(len(plane), MARKER_CORNER_SIGMA_PX), camera)
    if where is None:
        return None
    off = np.linalg.norm(where.pixels(plane) - pixels, axis=1).reshape(-1, 4).max(axis=1)
    square = where.pixels(plane + np.array([1.0, 0.0])) - where.pixels(plane)
    limit = np.maximum(
        PLANE_OUTLIER_MIN_PX, MARKER_OFFSET_MAX_FRAC * np.linalg.norm(square, axis=1).reshape(-1, 4).min(axis=1)
    )
    return where if np.all(off <= limit) else None


def _plane_of(markers: tuple[Array, Array], plane: Array, seen_px: Array, camera: StereoCamera) -> BoardPlane | None:
    """The plane by the markers and by the corners found so far."""
    seen = np.isfinite(seen_px).all(axis=1)
    points = np.concatenate([markers[0], plane[seen]])
    pixels = np.concatenate([markers[1], seen_px[seen]])
    sigmas = np.repeat([MARKER_CORNER_SIGMA_PX, CORNER_SIGMA_PX], [len(markers[0]), int(seen.sum())])
    return fit_plane(points, pixels, sigmas, camera)


def _fit_board_corners(image: Image, board: Board, where: BoardPlane, plane: Array, wanted: Array) -> Array:
    """Corners (n, 2) [px] that pass the gates of the single corner; NaN for the others."""
    x, y = np.array([0.5, 0.0]), np.array([0.0, 0.5])
    start = where.pixels(plane)
    right = where.pixels(plane + x) - where.pixels(plane - x)
    down = where.pixels(plane - y) - where.pixels(plane + y)
    side = np.minimum(np.linalg.norm(right, axis=1), np.linalg.norm(down, axis=1))
    known = (side >= SQUARE_SIDE_MIN_PX) & (where.sigmas_px(plane) < PREDICTION_SIGMA_MAX_FRAC * side)
    start[~(wanted & known)] = np.nan
    gap_frac = 0.5 * (1.0 - board.marker_m / board.square_m)
    found = fit_saddles(image, start, np.stack([right, down], axis=2), dark_first(board), gap_frac)
    good = (found[:, 2] < FIT_RESIDUAL_MAX_FRAC) & (found[:, 3] > CONTRAST_MIN_GREY)
    good &= np.linalg.norm(found[:, :2] - start, axis=1) < CORNER_SHIFT_MAX_FRAC * side
    return np.where(good[:, None], found[:, :2], np.nan)


def _on_plane(seen_px: Array, plane: Array, camera: StereoCamera) -> Array:
    """Drop corners that lie off the plane of the others."""
    seen = np.isfinite(seen_px).all(axis=1)
    if seen.sum() < OFF_PLANE_CORNERS_MIN:
        return seen_px
    where = fit_plane(plane[seen], seen_px[seen], np.full(int(seen.sum()), CORNER_SIGMA_PX), camera)
    if where is None:
        return seen_px
    off = np.linalg.norm(where.pixels(plane) - seen_px, axis=1)
    limit = max(OFF_PLANE_MIN_PX, OFF_PLANE_MEDIAN_FACTOR * float(np.nanmedian(off)))
    return np.where((off <= limit)[:, None], seen_px, np.nan)
