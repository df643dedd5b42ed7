"""Printed boards: markers with their white quiet zone and the dark tool shank, ray cast exactly in their region."""

from dataclasses import dataclass
from fractions import Fraction
from math import gcd

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine import targets
from machine.boards import board_marker_ids, dark_squares
from machine.camera import project
from machine.poses import inverse_pose, pose
from machine.rotations import Array, rotation_about
from sim_plc.camera.eye import EyeRays, can_project_all
from sim_plc.camera.texture import Grey
from sim_plc.camera.wall import pose_at_row

INK_GREY, PAPER_GREY, BACK_GREY, STEEL_GREY = 28, 212, 70, 34
SUPERSAMPLE = 4  # rays per pixel and axis where a pixel holds an edge
_ROI_MARGIN_PX = 3
_RATIO_DENOMINATOR_MAX = 20  # of a marker's side to its square's; finer ones are rounded, the squares stay exact
_SHANK_WIDTH_M = 0.036
_SHANK_LENGTH_M = 0.30
_SHANK_TILT_RAD = np.deg2rad(-65.0)  # runs down and back from the plate's lower edge, towards the wrist


@dataclass(frozen=True, slots=True)
class Board:
    """A flat rectangle of equal grey cells: x right, y up, z out of the print; cell (0, 0) at the top left."""

    cell_greys: Grey
    cell_x_m: float
    cell_y_m: float
    T_object_board: Array  # object: ooi or tcp

    @property
    def outline(self) -> Array:
        """The four corners (4, 3) [m] on the board."""
        half_x = 0.5 * self.cell_greys.shape[1] * self.cell_x_m
        half_y = 0.5 * self.cell_greys.shape[0] * self.cell_y_m
        return np.array([[-half_x, half_y, 0], [half_x, half_y, 0], [half_x, -half_y, 0], [-half_x, -half_y, 0]])


def marker_board(dictionary: str, marker: targets.Marker, T_object_on: Array) -> Board:
    """A printed marker with a quiet zone one module wide. `T_object_on`: what the marker sits on, in the object."""
    printed = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    modules = printed.markerSize + 2
    bits = cv2.aruco.generateImageMarker(printed, marker.marker_id, modules)
    cells = np.full((modules + 2, modules + 2), PAPER_GREY, np.uint8)
    cells[1:-1, 1:-1] = np.where(bits > 127, PAPER_GREY, INK_GREY)
    module_m = marker.side_m / modules
    return Board(cells, module_m, module_m, T_object_on @ marker.T_on_marker)


def chess_board(dictionary: str, board: targets.Board, T_object_on: Array) -> Board:
    """A printed ChArUco board with half a square of paper around it. `T_object_on`: what it sits on, in the object.

    The cells are so fine that the squares, and the modules of their markers, consist of whole cells.
    """
    printed = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    modules = printed.markerSize + 2
    per_square, per_module = _cells_of(board.marker_m / board.square_m, modules)
    dark = dark_squares(board)
    squares = np.where(dark, INK_GREY, PAPER_GREY).astype(np.uint8)
    inside = np.kron(squares, np.ones((per_square, per_square), np.uint8))
    gap = (per_square - per_module * modules) // 2
    for marker_id, row, column in zip(board_marker_ids(board), *np.nonzero(~dark), strict=True):
        bits = cv2.aruco.generateImageMarker(printed, marker_id, modules)
        grey = np.where(np.asarray(bits) > 127, PAPER_GREY, INK_GREY).astype(np.uint8)
        top, left = row * per_square + gap, column * per_square + gap
        drawn = np.kron(grey, np.ones((per_module, per_module), np.uint8))
        inside[top : top + len(drawn), left : left + len(drawn)] = drawn
    cells = np.pad(inside, per_square // 2, constant_values=PAPER_GREY)
    cell_m = board.square_m / per_square
    return Board(cells, cell_m, cell_m, T_object_on @ board.T_on_board)


def _cells_of(ratio: float, modules: int) -> tuple[int, int]:
    """Cells per square and per module, for a marker that is `ratio` of its square."""
    share = Fraction(ratio).limit_denominator(_RATIO_DENOMINATOR_MAX)
    per_square, per_marker = share.denominator, share.numerator
    times = modules // gcd(modules, per_marker)
    per_square, per_marker = per_square * times, per_marker * times
    if (per_square - per_marker) % 2:
        per_square, per_marker = 2 * per_square, 2 * per_marker
    return per_square, per_marker // modules


def shank_board(plate: Board) -> Board:
    """The dark bar that carries a tool plate, below it in the picture."""
    half_plate = 0.5 * plate.cell_greys.shape[0] * plate.cell_y_m
    hinge = pose(rotation_about("x", _SHANK_TILT_RAD), np.array([0.0, -half_plate, -0.001]))
    middle = pose(np.eye(3), np.array([0.0, -0.5 * _SHANK_LENGTH_M, 0.0]))
    T_object_shank = plate.T_object_board @ hinge @ middle
    cells = np.full((1, 1), STEEL_GREY, np.uint8)
    return Board(cells, _SHANK_WIDTH_M, _SHANK_LENGTH_M, T_object_shank)


@njit(cache=True, nogil=True)
def _cell_code(x: float, y: float, half_x: float, half_y: float, inv_x: float, inv_y: float, cols: int) -> int:
    """Index of the cell under a board point; -1 to -4 beyond the four sides."""
    if x < -half_x:
        return -1
    if x >= half_x:
        return -2
    if y > half_y:
        return -3
    if y <= -half_y:
        return -4
    return int((half_y - y) * inv_y) * cols + int((x + half_x) * inv_x)


@njit(cache=True, nogil=True)
def _code_of_ray(T: Array, rx: float, ry: float, size: Array, cols: int) -> int:
    """Cell code of one ray; -5 when it runs away from the board. T (3, 4): camera in board axes."""
    dz = T[2, 0] * rx + T[2, 1] * ry + T[2, 2]
    if dz * T[2, 3] >= 0.0:
        return -5
    t = -T[2, 3] / dz
    x = T[0, 3] + t * (T[0, 0] * rx + T[0, 1] * ry + T[0, 2])
    y = T[1, 3] + t * (T[1, 0] * rx + T[1, 1] * ry + T[1, 2])
    return _cell_code(x, y, size[0], size[1], size[2], size[3], cols)


@njit(cache=True, nogil=True)
def _paint_edge(
    T: Array, corners: NDArray[np.float32], v: int, u: int, size: Array, cells: Grey, back: int, n: int, under: float
) -> float:
    """Mean grey of n x n rays in one pixel, over what is already there.

    A straight grid would place an edge along the picture's rows or columns by quarters of a pixel only.
    """
    total, hits = 0.0, 0
    cols = cells.shape[1]
    for a in range(n):
        for b in range(n):
            fx, fy = (b + (a + 0.5) / n) / n, (a + (b + 0.5) / n) / n  # a sheared grid: n * n columns and rows
            w00, w01, w10, w11 = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
            rx = w00 * corners[v, u, 0] + w01 * corners[v, u + 1, 0]
            rx += w10 * corners[v + 1, u, 0] + w11 * corners[v + 1, u + 1, 0]
            ry = w00 * corners[v, u, 1] + w01 * corners[v, u + 1, 1]
            ry += w10 * corners[v + 1, u, 1] + w11 * corners[v + 1, u + 1, 1]
            code = _code_of_ray(T, rx, ry, size, cols)
            if code >= 0:
                hits += 1
                total += back if back >= 0 else cells[code // cols, code % cols]
    return float((total + (n * n - hits) * under) / (n * n))


@njit(cache=True, nogil=True)
def _paint_board(
    out: Grey,
    corners: NDArray[np.float32],
    keys: Array,
    cells: Grey,
    size: Array,
    back: int,
    roi: tuple[int, int, int, int],
    n: int,
) -> None:
    """Paint one board into its region. Pixels inside one cell take one grey; the others are supersampled.

    `keys`: T_board_cam at the shutter's key rows. `size`: half sides [m], cells per metre (x, y).
    """
    u0, v0, u1, v1 = roi
    height = out.shape[0]
    cols = cells.shape[1]
    T = np.empty((3, 4))
    for v in range(v0, v1):
        pose_at_row(keys, v, height, T)
        top_left = _code_of_ray(T, corners[v, u0, 0], corners[v, u0, 1], size, cols)
        low_left = _code_of_ray(T, corners[v + 1, u0, 0], corners[v + 1, u0, 1], size, cols)
        for u in range(u0, u1):
            top = _code_of_ray(T, corners[v, u + 1, 0], corners[v, u + 1, 1], size, cols)
            low = _code_of_ray(T, corners[v + 1, u + 1, 0], corners[v + 1, u + 1, 1], size, cols)
            if top == low and top == top_left and top == low_left:
                if top >= 0:
                    out[v, u] = back if back >= 0 else cells[top // cols, top % cols]
            else:
                grey = _paint_edge(T, corners, v, u, size, cells, back, n, out[v, u])
                out[v, u] = np.uint8(grey + 0.5)
            top_left, low_left = top, low


def board_region(eye: EyeRays, board: Board, Ts_board_cam: Array) -> tuple[int, int, int, int] | None:
    """Pixels (u0, v0, u1, v1) that a board may touch during one exposure; None when it is out of view or behind."""
    width, height = eye.camera.width_px, eye.camera.height_px
    spots = []
    for T_board_cam in (Ts_board_cam[0], Ts_board_cam[-1]):
        T_cam_board = inverse_pose(T_board_cam)
        points = board.outline @ T_cam_board[:3, :3].T + T_cam_board[:3, 3]
        if np.all(points[:, 2] <= 0.02):
            return None
        if not can_project_all(points):
            return 0, 0, width, height
        spots.append(project(eye.camera, points))
    pixels = np.concatenate(spots)
    low = np.floor(pixels.min(axis=0)).astype(int) - _ROI_MARGIN_PX
    high = np.ceil(pixels.max(axis=0)).astype(int) + _ROI_MARGIN_PX + 1
    u0, v0 = max(low[0], 0), max(low[1], 0)
    u1, v1 = min(high[0], width), min(high[1], height)
    return (int(u0), int(v0), int(u1), int(v1)) if u0 < u1 and v0 < v1 else None


def paint_board(out: Grey, eye: EyeRays, board: Board, Ts_object_cam: Array, supersample: int = SUPERSAMPLE) -> None:
    """Paint a board over a picture; `Ts_object_cam` (n, 4, 4) at the shutter's key rows. Its back is plain grey."""
    Ts_board_cam = np.ascontiguousarray(inverse_pose(board.T_object_board) @ Ts_object_cam)
    roi = board_region(eye, board, Ts_board_cam)
    if roi is None:
        return
    half_x, half_y = board.outline[1, 0], board.outline[1, 1]
    size = np.array([half_x, half_y, 1.0 / board.cell_x_m, 1.0 / board.cell_y_m])
    back = -1 if Ts_board_cam[0, 2, 3] > 0.0 else BACK_GREY
    _paint_board(out, eye.pixel_corner_rays, Ts_board_cam, board.cell_greys, size, back, roi, supersample)
