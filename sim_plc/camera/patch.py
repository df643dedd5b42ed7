"""Image patches of structure fixed to the camera, painted once and laid over every image."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.rotations import Array
from sim_plc.camera.boards import Board, paint_board
from sim_plc.camera.eye import EyeRays
from sim_plc.camera.texture import Grey


@dataclass(frozen=True, slots=True)
class FixedPatch:
    """Boards as one eye always sees them: picture = ink + see_through * what lies behind."""

    roi: tuple[int, int, int, int]  # u0, v0, u1, v1
    ink: NDArray[np.float32]
    see_through: NDArray[np.float32]


def fixed_patch(rays: EyeRays, boards: Sequence[Board], T_tcp_cam: Array) -> FixedPatch | None:
    """The boards, far to near, over black and over white give ink and cover; None when the eye does not see them."""
    shape = (rays.camera.height_px, rays.camera.width_px)
    black, white = np.zeros(shape, np.uint8), np.full(shape, 255, np.uint8)
    keys = np.repeat(T_tcp_cam[None], 2, axis=0)
    for board in boards:
        paint_board(black, rays, board, keys)
        paint_board(white, rays, board, keys)
    see_through = (white.astype(np.float32) - black) / np.float32(255.0)
    v, u = np.nonzero(see_through < 1.0)
    if v.size == 0:
        return None
    roi = int(u.min()), int(v.min()), int(u.max()) + 1, int(v.max()) + 1
    window = np.s_[roi[1] : roi[3], roi[0] : roi[2]]
    return FixedPatch(roi, black[window].astype(np.float32), see_through[window].copy())


def paint_patch(image: Grey, patch: FixedPatch) -> None:
    """Lay it over a picture, in place."""
    u0, v0, u1, v1 = patch.roi
    _lay_over(image[v0:v1, u0:u1], patch.ink, patch.see_through)


@njit(cache=True, nogil=True)
def _lay_over(window: Grey, ink: NDArray[np.float32], see_through: NDArray[np.float32]) -> None:
    for v in range(window.shape[0]):
        for u in range(window.shape[1]):
            if see_through[v, u] < np.float32(1.0):
                grey = ink[v, u] + see_through[v, u] * np.float32(window[v, u])
                window[v, u] = np.uint8(grey + np.float32(0.5))
