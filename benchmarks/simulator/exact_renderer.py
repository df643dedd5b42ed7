"""The slow, exact picture: every pixel supersampled, every ray against wall and boards by depth. For tests only."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from machine.poses import inverse_pose
from machine.rotations import Array
from sim_plc.camera.boards import Board
from sim_plc.camera.eye import rays_at
from sim_plc.camera.own_structure import EyeView
from sim_plc.camera.renderer import StereoRenderer
from sim_plc.camera.texture import Grey
from sim_plc.camera.wall import height_at, pose_at_row

_RELIEF_STEPS = 60
_RELIEF_DONE_M = 1e-9


@dataclass(frozen=True, slots=True)
class Window:
    """A part of the picture [px]: columns u0 to u1, rows v0 to v1, ends excluded."""

    u0: int
    v0: int
    u1: int
    v1: int


@njit(cache=True, nogil=True)
def _texture_grey(image: Grey, texel_x: float, texel_y: float, x: float, y: float) -> float:
    rows, cols = image.shape[0] - 1, image.shape[1] - 1
    tx, ty = x / texel_x - 0.5, -y / texel_y - 0.5
    ix, iy = int(np.floor(tx)), int(np.floor(ty))
    fx, fy = tx - ix, ty - iy
    ix, iy = ix % cols, iy % rows
    top = image[iy, ix] * (1.0 - fx) + image[iy, ix + 1] * fx
    low = image[iy + 1, ix] * (1.0 - fx) + image[iy + 1, ix + 1] * fx
    return float(top * (1.0 - fy) + low * fy)


@njit(cache=True, nogil=True)
def _nearest_board(T_boards: Array, sides: Array, cells: tuple[Grey, ...], rx: float, ry: float) -> tuple[float, float]:
    """Depth and grey of the nearest printed face on one ray; infinite depth when there is none."""
    depth, grey = np.inf, 0.0
    for b in range(len(cells)):
        T = T_boards[b]
        dz = T[2, 0] * rx + T[2, 1] * ry + T[2, 2]
        t = -T[2, 3] / dz
        if t <= 0.0 or t >= depth or dz >= 0.0:
            continue
        x = T[0, 3] + t * (T[0, 0] * rx + T[0, 1] * ry + T[0, 2])
        y = T[1, 3] + t * (T[1, 0] * rx + T[1, 1] * ry + T[1, 2])
        n_y, n_x = cells[b].shape
        col = int(np.floor((x / sides[b, 0] + 0.5) * n_x))
        row = int(np.floor((0.5 - y / sides[b, 1]) * n_y))
        if 0 <= col < n_x and 0 <= row < n_y:
            depth, grey = t, float(cells[b][row, col])
    return depth, grey


@njit(cache=True, nogil=True)
def _cast(
    rays: Array,
    n: int,
    v0: int,
    height_px: int,
    keys: Array,
    board_keys: Array,
    sides: Array,
    cells: tuple[Grey, ...],
    heights: Array,
    mean_z: float,
    image: Grey,
    texel_x: float,
    texel_y: float,
) -> Array:
    rows, cols = rays.shape[0] // n, rays.shape[1] // n
    out = np.zeros((rows, cols))
    T = np.empty((3, 4))
    T_boards = np.empty((len(cells), 3, 4))
    for v in range(rows):
        pose_at_row(keys, v0 + v, height_px, T)
        for b in range(len(cells)):
            pose_at_row(board_keys[b], v0 + v, height_px, T_boards[b])
        for i in range(n):
            for k in range(cols * n):
                rx, ry = rays[v * n + i, k, 0], rays[v * n + i, k, 1]
                dx = T[0, 0] * rx + T[0, 1] * ry + T[0, 2]
                dy = T[1, 0] * rx + T[1, 1] * ry + T[1, 2]
                dz = T[2, 0] * rx + T[2, 1] * ry + T[2, 2]
                t = (mean_z - T[2, 3]) / dz
                for _ in range(_RELIEF_STEPS):
                    before = t
                    t = (mean_z + height_at(heights, T[0, 3] + t * dx, T[1, 3] + t * dy) - T[2, 3]) / dz
                    if abs(t - before) < _RELIEF_DONE_M:
                        break
                depth, grey = _nearest_board(T_boards, sides, cells, rx, ry)
                if t < depth:
                    grey = _texture_grey(image, texel_x, texel_y, T[0, 3] + t * dx, T[1, 3] + t * dy)
                out[v, k // n] += grey / (n * n)
    return out


def _board_keys(board: Board, Ts_object_cam: Array) -> Array:
    return inverse_pose(board.T_object_board) @ Ts_object_cam


def reference_window(
    renderer: StereoRenderer, eye: EyeView, Ts_base_tcp: Array, window: Window, supersample: int = 4
) -> Array:
    """Part of one eye's sharp picture before point spread and noise, own structure without hoses: (rows, cols) grey.

    Args:    renderer: whose scene. eye: one of its eyes. Ts_base_tcp: tool poses at the shutter's key rows (n, 4, 4).
             window: which part. supersample: rays per pixel and axis; every ray is undistorted by itself.
    """
    camera = eye.rays.camera
    shift = (np.arange(supersample) + 0.5) / supersample - 0.5
    u_px = (np.arange(window.u0, window.u1)[:, None] + shift).ravel()
    v_px = (np.arange(window.v0, window.v1)[:, None] + shift).ravel()
    keys = renderer.Ts_ooi_cam(eye, Ts_base_tcp)
    rigid = np.repeat(eye.T_tcp_cam[None], len(keys), axis=0)
    fixed = (*renderer.structure.boards, *renderer.tool_boards)
    boards = (*renderer.ooi_boards, *fixed)
    parents = [keys] * len(renderer.ooi_boards) + [rigid] * len(fixed)
    board_keys = np.stack([_board_keys(board, parent) for board, parent in zip(boards, parents, strict=True)])
    sides = np.array([[2.0 * board.outline[1, 0], 2.0 * board.outline[1, 1]] for board in boards])
    level, relief = renderer.levels[0], renderer.relief
    return _cast(
        rays_at(camera, u_px, v_px),
        supersample,
        window.v0,
        camera.height_px,
        keys,
        board_keys,
        sides,
        tuple(board.cell_greys for board in boards),
        relief.heights_m,
        relief.mean_z_m,
        level.grey_image,
        level.texel_x_m,
        level.texel_y_m,
    )
